// Marks of contacts, grooves and ruptures at their positions, which fade over a second.

export const FADE_MS = 1000;
const MAX_MARKS = 200;

export class Marks {
  #marks = [];

  // `point` in m; `at` in ms, the clock of performance.now().
  add(kind, point, at) {
    this.#marks.push({ kind, point, at });
    if (this.#marks.length > MAX_MARKS) {
      this.#marks.shift();
    }
  }

  // Returns the visible marks, with `age` from 0 to 1.
  seen(now) {
    this.#marks = this.#marks.filter((mark) => now - mark.at < FADE_MS);
    return this.#marks.map((mark) => ({ ...mark, age: Math.max(0, (now - mark.at) / FADE_MS) }));
  }

  clear() {
    this.#marks = [];
  }
}

const still = matchMedia("(prefers-reduced-motion: reduce)");

function star(ctx, x, y, radius) {
  for (let i = 0; i < 8; i++) {
    const angle = (i * Math.PI) / 4;
    ctx.moveTo(x + 0.35 * radius * Math.cos(angle), y + 0.35 * radius * Math.sin(angle));
    ctx.lineTo(x + radius * Math.cos(angle), y + radius * Math.sin(angle));
  }
}

export function drawMarks(ctx, transform, marks, colours) {
  for (const { kind, point, age } of marks) {
    const [x, y] = transform.toPx(point);
    const grown = still.matches ? 0.3 : age;
    ctx.globalAlpha = 1 - age;
    ctx.beginPath();
    if (kind === "contact") {
      ctx.strokeStyle = colours.contact;
      ctx.lineWidth = 2.5;
      ctx.arc(x, y, 6 + 14 * grown, 0, 2 * Math.PI);
    } else if (kind === "groove") {
      ctx.strokeStyle = colours.groove;
      ctx.lineWidth = 2;
      ctx.moveTo(x, y - 12 - 6 * grown);
      ctx.lineTo(x, y - 4 - 6 * grown);
      ctx.moveTo(x + 3, y);
      ctx.arc(x, y, 3, 0, 2 * Math.PI);
    } else {
      ctx.strokeStyle = colours.rupture;
      ctx.lineWidth = 2.5;
      star(ctx, x, y, 10 + 16 * grown);
    }
    ctx.stroke();
  }
  ctx.globalAlpha = 1;
}
