// Drawing of membranes: straight, deflected by the probe, or punctured, with a hole.
import { ends, frameOf, global, local } from "./geometry.js";
import { tint } from "./textures.js";

const HOLE_PX = 14;

// Returns the shape of a membrane, in m: its ends, and between them the point to which the probe deflects it. `position`:
// the probe's position if it touches the membrane, else null.
export function skinLine(membrane, position) {
  const frame = frameOf(membrane);
  const [from, to] = ends(frame);
  if (position === null) {
    return [from, to];
  }
  const [s, h] = local(frame, position);
  const half = frame.half[0];
  return [from, global(frame, [Math.min(half, Math.max(-half, s)), h]), to];
}

// Positions along the membranes where they were punctured, kept until they are healed.
export class Punctures {
  #holes = new Map();

  // `position`: the probe's position then, on the side to which it passed through.
  puncture(id, membrane, position) {
    const frame = frameOf(membrane);
    const [s, h] = local(frame, position);
    this.#holes.set(id, { at: Math.min(frame.half[0], Math.max(-frame.half[0], s)), side: h >= 0 ? 1 : -1 });
  }

  heal(ids = null) {
    for (const id of ids ?? [...this.#holes.keys()]) {
      this.#holes.delete(id);
    }
  }

  // Removes the holes of objects that were removed or are not membranes any more.
  keepOnly(objects) {
    for (const id of this.#holes.keys()) {
      if (objects[id]?.kind !== "membrane") {
        this.#holes.delete(id);
      }
    }
  }

  // Returns {at, side}: position along the membrane, and the side to which its edges hang; null if it is intact.
  hole(id) {
    return this.#holes.get(id) ?? null;
  }

  get ids() {
    return [...this.#holes.keys()];
  }
}

function drawTorn(ctx, transform, membrane, { at, side }, colours) {
  const frame = frameOf(membrane);
  const half = HOLE_PX / 2 / transform.pxPerM;
  const flap = 6 / transform.pxPerM;
  const hang = flap * side;
  const [from, to] = ends(frame);
  ctx.setLineDash([]);
  ctx.beginPath();
  // Two flaps hang at the edges of the hole.
  ctx.moveTo(...transform.toPx(from));
  ctx.lineTo(...transform.toPx(global(frame, [at - half, 0])));
  ctx.lineTo(...transform.toPx(global(frame, [at - half + flap / 2, hang])));
  ctx.moveTo(...transform.toPx(to));
  ctx.lineTo(...transform.toPx(global(frame, [at + half, 0])));
  ctx.lineTo(...transform.toPx(global(frame, [at + half - flap / 2, hang])));
  ctx.strokeStyle = colours.rupture;
  ctx.lineWidth = 2;
  ctx.stroke();
}

// `touch`: the probe's position if it touches this membrane, else null. `hole`: the place of its hole, else null.
export function drawMembrane(ctx, transform, membrane, touch, hole, colours) {
  if (hole !== null) {
    drawTorn(ctx, transform, membrane, hole, colours);
    return;
  }
  const line = skinLine(membrane, touch).map((point) => transform.toPx(point));
  ctx.beginPath();
  for (const point of line) {
    ctx.lineTo(...point);
  }
  ctx.lineJoin = "round";
  ctx.strokeStyle = tint(membrane.material, 0.45);
  ctx.lineWidth = 6;
  ctx.stroke();
  ctx.strokeStyle = colours.surface;
  ctx.lineWidth = 1.75;
  ctx.stroke();
  ctx.fillStyle = colours.surface;
  for (const [x, y] of [line[0], line.at(-1)]) {
    ctx.beginPath();
    ctx.arc(x, y, 3, 0, 2 * Math.PI);
    ctx.fill();
  }
}
