// The background: grid, axes in millimetres, the workspace, and the scale bars of length and force.
import { lengthText, roundedDown } from "./transform.js";

export const EDGE_LEFT_PX = 46; // space for the labels of y
export const EDGE_BOTTOM_PX = 20; // space for the labels of x

// The multiples of `step` within [from, to].
export function multiples(step, from, to) {
  const found = [];
  for (let k = Math.ceil(from / step - 1e-9); k * step <= to + step * 1e-9; k++) {
    found.push(k === 0 ? 0 : k * step);
  }
  return found;
}

function lines(pen, step, colour) {
  const { ctx, transform } = pen;
  const [left, bottom, right, top] = transform.seen;
  ctx.beginPath();
  for (const x of multiples(step, left, right)) {
    const px = Math.round(transform.toPx([x, 0])[0]) + 0.5;
    ctx.moveTo(px, 0);
    ctx.lineTo(px, transform.height);
  }
  for (const y of multiples(step, bottom, top)) {
    const px = Math.round(transform.toPx([0, y])[1]) + 0.5;
    ctx.moveTo(0, px);
    ctx.lineTo(transform.width, px);
  }
  ctx.strokeStyle = colour;
  ctx.lineWidth = 1;
  ctx.stroke();
}

export function drawGrid(pen) {
  const { ctx, transform, colours } = pen;
  const major = transform.gridStep(64);
  const lead = Math.round(major / 10 ** Math.floor(Math.log10(major) + 1e-9));
  ctx.globalAlpha = 0.55;
  lines(pen, major / (lead === 2 ? 4 : 5), colours.grid);
  ctx.globalAlpha = 1;
  lines(pen, major, colours.grid);
  // The axes of the plane.
  const [x0, y0] = transform.toPx([0, 0]).map((value) => Math.round(value) + 0.5);
  ctx.beginPath();
  ctx.moveTo(x0, 0);
  ctx.lineTo(x0, transform.height);
  ctx.moveTo(0, y0);
  ctx.lineTo(transform.width, y0);
  ctx.strokeStyle = colours.border;
  ctx.lineWidth = 1;
  ctx.stroke();
}

export function drawWorkspace(pen, workspace) {
  if (workspace === null) {
    return;
  }
  const { ctx, transform, colours } = pen;
  const [left, bottom, right, top] = workspace;
  const [x0, y0] = transform.toPx([left, top]);
  const [x1, y1] = transform.toPx([right, bottom]);
  // The area outside of the workspace is dimmed.
  ctx.beginPath();
  ctx.rect(0, 0, transform.width, transform.height);
  ctx.rect(x0, y0, x1 - x0, y1 - y0);
  ctx.fillStyle = colours.sunken;
  ctx.globalAlpha = 0.7;
  ctx.fill("evenodd");
  ctx.globalAlpha = 1;
  ctx.strokeStyle = colours.edge;
  ctx.lineWidth = 1;
  ctx.setLineDash([6, 4]);
  ctx.strokeRect(Math.round(x0) + 0.5, Math.round(y0) + 0.5, Math.round(x1 - x0), Math.round(y1 - y0));
  ctx.setLineDash([]);
}

// Draws the labels in millimetres along the lower and the left edge, over everything there.
export function drawTicks(pen) {
  const { ctx, transform, colours, labels } = pen;
  const { width, height } = transform;
  const [left, bottom, right, top] = transform.seen;
  const step = transform.gridStep(64);
  const text = (value) => `${+(value * 1000).toPrecision(6)}`.replace("-", "\u2212");
  ctx.fillStyle = colours.ground;
  ctx.globalAlpha = 0.85;
  ctx.fillRect(0, height - EDGE_BOTTOM_PX, width, EDGE_BOTTOM_PX);
  ctx.fillRect(0, 0, EDGE_LEFT_PX, height - EDGE_BOTTOM_PX);
  ctx.globalAlpha = 1;
  labels.keepFree([0, height - EDGE_BOTTOM_PX, width, height]);
  labels.keepFree([0, 0, EDGE_LEFT_PX, height]);
  ctx.font = "11px system-ui, sans-serif";
  ctx.fillStyle = colours.muted;
  ctx.textBaseline = "middle";
  ctx.textAlign = "center";
  for (const x of multiples(step, left, right)) {
    const px = transform.toPx([x, 0])[0];
    if (px > EDGE_LEFT_PX + 8 && px < width - 54) {
      ctx.fillText(text(x), px, height - EDGE_BOTTOM_PX / 2);
    }
  }
  ctx.textAlign = "right";
  ctx.fillText("x, mm", width - 6, height - EDGE_BOTTOM_PX / 2);
  for (const y of multiples(step, bottom, top)) {
    const px = transform.toPx([0, y])[1];
    if (px > 26 && px < height - EDGE_BOTTOM_PX - 8) {
      ctx.fillText(text(y), EDGE_LEFT_PX - 5, px);
    }
  }
  ctx.fillText("y, mm", EDGE_LEFT_PX - 5, 12);
}

function bar(pen, [x, y], length, text, colour, fromRight) {
  const { ctx, colours } = pen;
  ctx.font = "600 11px system-ui, sans-serif";
  const width = Math.max(length, ctx.measureText(text).width) + 12;
  const left = fromRight ? x - width : x;
  ctx.fillStyle = colours.ground;
  ctx.globalAlpha = 0.85;
  ctx.fillRect(left, y - 20, width, 28);
  ctx.globalAlpha = 1;
  const start = left + (width - length) / 2;
  ctx.strokeStyle = colour;
  ctx.lineWidth = 2;
  ctx.beginPath();
  ctx.moveTo(start, y - 3);
  ctx.lineTo(start, y + 3);
  ctx.moveTo(start, y);
  ctx.lineTo(start + length, y);
  ctx.moveTo(start + length, y - 3);
  ctx.lineTo(start + length, y + 3);
  ctx.stroke();
  ctx.fillStyle = colours.text;
  ctx.textAlign = "center";
  ctx.textBaseline = "alphabetic";
  ctx.fillText(text, left + width / 2, y - 7);
  pen.labels.keepFree([left, y - 20, left + width, y + 8]);
}

// Draws the scale bars of force and length at the lower corners.
export function drawScaleBars(pen) {
  const { transform, colours } = pen;
  const y = transform.height - EDGE_BOTTOM_PX - 14;
  const metres = transform.barLength(90);
  bar(pen, [EDGE_LEFT_PX + 8, y], metres * transform.pxPerM, lengthText(metres), colours.text, false);
  const newtons = roundedDown(80 / pen.pxPerN);
  bar(pen, [transform.width - 10, y], newtons * pen.pxPerN, `${+newtons.toPrecision(2)} N`, colours.force, true);
}
