// Arrows of the forces on the hand, and their common scale.

const HEAD_PX = 8;
const MIN_ARROW_PX = 3; // shorter arrows are not drawn

export function drawArrow(ctx, from, to, colour, width) {
  const dx = to[0] - from[0];
  const dy = to[1] - from[1];
  const length = Math.hypot(dx, dy);
  if (length < MIN_ARROW_PX) {
    return;
  }
  const head = Math.min(HEAD_PX + width, length * 0.6);
  const [ux, uy] = [dx / length, dy / length];
  const neck = [to[0] - ux * head * 0.8, to[1] - uy * head * 0.8];
  ctx.strokeStyle = colour;
  ctx.fillStyle = colour;
  ctx.lineWidth = width;
  ctx.beginPath();
  ctx.moveTo(...from);
  ctx.lineTo(...neck);
  ctx.stroke();
  ctx.beginPath();
  ctx.moveTo(...to);
  ctx.lineTo(to[0] - ux * head - uy * head * 0.45, to[1] - uy * head + ux * head * 0.45);
  ctx.lineTo(to[0] - ux * head + uy * head * 0.45, to[1] - uy * head - ux * head * 0.45);
  ctx.closePath();
  ctx.fill();
}

// Returns pixels per newton: the force limit is a circle of a fixed fraction of the canvas' shorter side.
export function pxPerNewton(limitN, width, height) {
  return (0.42 * Math.min(width, height)) / limitN;
}

// Returns the end of a force's arrow that begins at `from`, in pixels; y of the canvas points down.
export function tip(from, force, pxPerN) {
  return [from[0] + force[0] * pxPerN, from[1] - force[1] * pxPerN];
}

const RIM_PX = 9; // distance of arrows from the handle's centre, by which the limit's circle is larger, too
const SIDE_SHIFT_PX = 6;

// Draws a force at the handle, shifted to the side, so that three arrows of one direction can be distinguished.
function drawForce(ctx, handle, force, aside, pxPerN, colour, width) {
  const size = Math.hypot(force[0], force[1]);
  if (size * pxPerN < 2) {
    return;
  }
  const [ux, uy] = [force[0] / size, -force[1] / size];
  const from = [handle[0] + ux * RIM_PX - uy * aside, handle[1] + uy * RIM_PX + ux * aside];
  drawArrow(ctx, from, tip(from, force, pxPerN), colour, width);
}

// Draws contact force, vibration and their sum at the handle, and the force limit around it if it is known.
export function drawForces(ctx, handle, forces, { limitN, pxPerN, saturated, colours }) {
  const felt = Object.values(forces).some((force) => Math.hypot(force[0], force[1]) * pxPerN >= 2);
  if (!felt) {
    return;
  }
  if (limitN !== null) {
    ctx.beginPath();
    ctx.arc(...handle, limitN * pxPerN + RIM_PX, 0, 2 * Math.PI);
    ctx.setLineDash(saturated ? [] : [4, 4]);
    ctx.strokeStyle = saturated ? colours.bad : colours.muted;
    ctx.lineWidth = saturated ? 2 : 1;
    ctx.stroke();
    ctx.setLineDash([]);
  }
  drawForce(ctx, handle, forces.force, 0, pxPerN, colours.force, 3);
  drawForce(ctx, handle, forces.contact, -SIDE_SHIFT_PX, pxPerN, colours.contact, 2.5);
  drawForce(ctx, handle, forces.vibration, SIDE_SHIFT_PX, pxPerN, colours.vibration, 2.5);
}
