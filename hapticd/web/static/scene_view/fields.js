// Drawing of fields: the centre of a spring with rings of equal force, the shading of a drag, the arrows of a constant force.
import { EVERYWHERE, lengthOf } from "./geometry.js";
import { drawArrow } from "./arrows.js";
import { roundedUp } from "./transform.js";

const RING_PX = 46; // smallest distance of rings of equal force
const LATTICE_PX = 110;

function drawSpring(pen, id, spring) {
  const { ctx, transform, colours, labels } = pen;
  const [x, y] = transform.toPx(spring.center_m);
  ctx.strokeStyle = colours.field;
  ctx.lineWidth = 1;
  const stepN = spring.stiffness_n_per_m > 0 ? roundedUp((spring.stiffness_n_per_m * RING_PX) / transform.pxPerM) : 0;
  if (stepN > 0) {
    const stepPx = (stepN / spring.stiffness_n_per_m) * transform.pxPerM;
    ctx.setLineDash([2, 5]);
    for (let i = 1; i <= 4; i++) {
      ctx.beginPath();
      ctx.arc(x, y, i * stepPx, 0, 2 * Math.PI);
      ctx.stroke();
      const text = `${+(i * stepN).toPrecision(3)} N`;
      const places = [-Math.PI / 4, Math.PI / 4, (-3 * Math.PI) / 4, (3 * Math.PI) / 4].map((angle) => [
        x + i * stepPx * Math.cos(angle), y + i * stepPx * Math.sin(angle),
      ]);
      labels.write(ctx, text, places, { size: 11, colour: colours.muted, plate: colours.ground });
    }
    ctx.setLineDash([]);
  }
  ctx.strokeStyle = colours.text;
  ctx.lineWidth = 1.5;
  ctx.beginPath();
  for (const [dx, dy] of [[-1, 0], [0, -1]]) {
    ctx.moveTo(x + 7 * dx, y + 7 * dy);
    ctx.lineTo(x - 7 * dx, y - 7 * dy);
  }
  ctx.moveTo(x + 4, y);
  ctx.arc(x, y, 4, 0, 2 * Math.PI);
  ctx.stroke();
  const text = `${id} · ${+spring.stiffness_n_per_m.toPrecision(4)} N/m`;
  labels.write(ctx, text, [[x, y - 18], [x, y + 18]], { weight: 600, colour: colours.text, plate: colours.ground });
}

// Draws dots over the complete plane, denser for more damping.
function shadeViscous(pen, viscous) {
  const { ctx, transform, colours } = pen;
  const apart = Math.max(9, 26 - 5 * Math.log2(1 + viscous.damping_n_s_per_m));
  const [x0, y0] = transform.toPx([0, 0]);
  ctx.fillStyle = colours.field;
  ctx.globalAlpha = 0.5;
  let odd = false;
  for (let y = ((y0 % apart) + apart) % apart; y < transform.height; y += apart) {
    odd = !odd;
    for (let x = (((x0 % apart) + apart) % apart) - (odd ? apart / 2 : 0); x < transform.width; x += apart) {
      ctx.fillRect(x, y, 1.5, 1.5);
    }
  }
  ctx.globalAlpha = 1;
}

function drawConstant(pen, constant) {
  const { ctx, transform, colours } = pen;
  const size = lengthOf(constant.force_n);
  if (size === 0) {
    return;
  }
  const length = Math.min(LATTICE_PX * 0.55, Math.max(12, size * pen.pxPerN));
  const [dx, dy] = [(constant.force_n[0] / size) * length, (-constant.force_n[1] / size) * length];
  ctx.globalAlpha = 0.5;
  for (let y = LATTICE_PX / 2; y < transform.height; y += LATTICE_PX) {
    for (let x = LATTICE_PX / 2; x < transform.width; x += LATTICE_PX) {
      drawArrow(ctx, [x - dx / 2, y - dy / 2], [x + dx / 2, y + dy / 2], colours.field, 1.5);
    }
  }
  ctx.globalAlpha = 1;
}

// Returns the description of a field without a place.
function wordsOf(id, field) {
  if (field.kind === "viscous") {
    return `${id} · ${+field.damping_n_s_per_m.toPrecision(4)} N·s/m everywhere`;
  }
  return `${id} · ${+lengthOf(field.force_n).toPrecision(3)} N everywhere`;
}

export function drawFields(pen, objects) {
  const everywhere = Object.entries(objects).filter(([, object]) => EVERYWHERE.has(object.kind));
  for (const [, field] of everywhere) {
    (field.kind === "viscous" ? shadeViscous : drawConstant)(pen, field);
  }
}

// Draws names: those of fields with a place at it, those of others below each other at the upper right. Returns the
// rectangles of the latter, where they can be selected: [id, rect].
export function nameFields(pen, objects) {
  const { ctx, transform, colours, labels } = pen;
  const found = [];
  let y = 20;
  for (const [id, field] of Object.entries(objects)) {
    if (EVERYWHERE.has(field.kind) && found.length < 6) {
      const text = wordsOf(id, field);
      ctx.font = "600 12px system-ui, sans-serif";
      const x = transform.width - 14 - ctx.measureText(text).width / 2;
      const rect = labels.write(ctx, text, [[x, y]], { weight: 600, colour: colours.text, plate: colours.ground });
      if (rect !== null) {
        found.push([id, rect]);
      }
      y += 22;
    } else if (field.kind === "spring") {
      drawSpring(pen, id, field);
    }
  }
  return found;
}
