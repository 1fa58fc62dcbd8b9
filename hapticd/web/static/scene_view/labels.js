// Names on the canvas, which never overlap: a label is drawn at the first of its places that is free and inside the canvas,
// or not at all.

const overlaps = (a, b) => a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3];

export class Labels {
  #taken = [];
  placed = []; // {text, rect} of the drawn labels
  #bounds;

  // `bounds`: [left, top, right, bottom] in pixels.
  constructor(bounds) {
    this.#bounds = bounds;
  }

  // Keeps a rectangle free of labels.
  keepFree(rect) {
    this.#taken.push(rect);
  }

  // Draws `text` centred at the first free one of `places`; returns its rectangle, or null.
  write(ctx, text, places, { size = 12, weight = 400, colour, plate = null } = {}) {
    ctx.font = `${weight} ${size}px system-ui, sans-serif`;
    const width = ctx.measureText(text).width + 8;
    const height = size + 6;
    for (const [x, y] of places) {
      const rect = [x - width / 2, y - height / 2, x + width / 2, y + height / 2];
      const [left, top, right, bottom] = this.#bounds;
      const inside = rect[0] >= left && rect[1] >= top && rect[2] <= right && rect[3] <= bottom;
      if (!inside || this.#taken.some((other) => overlaps(rect, other))) {
        continue;
      }
      if (plate !== null) {
        ctx.fillStyle = plate;
        ctx.globalAlpha = 0.8;
        ctx.beginPath();
        ctx.roundRect(rect[0], rect[1], width, height, 3);
        ctx.fill();
        ctx.globalAlpha = 1;
      }
      ctx.fillStyle = colour;
      ctx.textAlign = "center";
      ctx.textBaseline = "middle";
      ctx.fillText(text, x, y + 0.5);
      this.#taken.push(rect);
      this.placed.push({ text, rect });
      return rect;
    }
    return null;
  }
}
