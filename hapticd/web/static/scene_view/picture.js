// The picture, in two layers. Static elements (grid, solids, fields, names) are drawn into a separate canvas, again only when
// the view, the scene or the colours change. Moving elements (handle, hand, membranes, arrows, marks) are drawn over it in
// animation frames, only if something changed.
import { color } from "../theme.js";
import { drawForces, pxPerNewton } from "./arrows.js";
import { drawSelection } from "./arrange.js";
import { drawFields, nameFields } from "./fields.js";
import { corners, ends, frameOf, sectionSeen, along, SURFACES } from "./geometry.js";
import { drawGrid, drawScaleBars, drawTicks, drawWorkspace, EDGE_BOTTOM_PX, EDGE_LEFT_PX } from "./grid.js";
import { Labels } from "./labels.js";
import { drawMarks } from "./marks.js";
import { drawMembrane } from "./membranes.js";
import { isSaturated } from "./moments.js";
import { drawSolids, isSeen, nameSurfaces } from "./shapes.js";

const UNKNOWN_LIMIT_N = 10; // force for the scale of arrows if the limit is not known
const VIBRATION_MS = 150; // time in which the arrow of a vibration fades, so that a tap is visible

function palette() {
  const names = ["text", "muted", "border", "edge", "accent", "bad", "grid", "sunken", "contact", "vibration", "force",
    "hand", "groove", "rupture", "position"];
  return { ...Object.fromEntries(names.map((name) => [name, color(name)])),
    ground: color("surface"), surface: color("text"), field: color("muted") };
}

export class Picture {
  chips = []; // [id, rectangle] of the labels of fields without a place
  labels = []; // {text, rect} of the drawn names
  frames = 0; // number of drawn frames
  #still = document.createElement("canvas");
  #stillFresh = false;
  #canvas;
  #ctx;
  #view;
  #colours = palette();
  #dpr = 1;
  #frame = null;
  #vibration = { force: [0, 0], at: 0 };

  // `view`: {transform, objects, materials, workspace, limitN, moments, contacts, hand, mode, selected}
  constructor(canvas, view) {
    this.#canvas = canvas;
    this.#ctx = canvas.getContext("2d", { alpha: false });
    this.#view = view;
  }

  // Called when the size or the pixel density of the canvas changed.
  resize() {
    const { transform } = this.#view;
    this.#dpr = Math.min(3, globalThis.devicePixelRatio || 1);
    transform.resize(this.#canvas.clientWidth, this.#canvas.clientHeight);
    for (const canvas of [this.#canvas, this.#still]) {
      canvas.width = Math.round(transform.width * this.#dpr);
      canvas.height = Math.round(transform.height * this.#dpr);
    }
    this.refresh();
  }

  recolour() {
    this.#colours = palette();
    this.refresh();
  }

  // Draws the static elements again.
  refresh() {
    this.#stillFresh = false;
    this.draw();
  }

  // Draws before the browser shows the next frame: a resized canvas is empty.
  drawAtOnce() {
    this.#drawNow(performance.now());
  }

  // Draws at the next animation frame.
  draw() {
    this.#frame ??= requestAnimationFrame((now) => {
      this.#frame = null;
      this.#drawNow(now);
    });
  }

  get pxPerN() {
    const { transform, limitN } = this.#view;
    return pxPerNewton(limitN ?? UNKNOWN_LIMIT_N, transform.width, transform.height);
  }

  #drawStill() {
    const { transform, objects, materials, workspace } = this.#view;
    const ctx = this.#still.getContext("2d", { alpha: false });
    const colours = this.#colours;
    const labels = new Labels([EDGE_LEFT_PX, 2, transform.width - 2, transform.height - EDGE_BOTTOM_PX]);
    const pen = { ctx, transform, materials, colours, labels, pxPerN: this.pxPerN };
    ctx.setTransform(this.#dpr, 0, 0, this.#dpr, 0, 0);
    ctx.fillStyle = colours.ground;
    ctx.fillRect(0, 0, transform.width, transform.height);
    drawGrid(pen);
    drawFields(pen, objects);
    drawWorkspace(pen, workspace);
    drawSolids(pen, objects);
    drawTicks(pen);
    drawScaleBars(pen);
    // Names after all bodies, so that none is covered; ticks and bars keep their places free.
    this.chips = nameFields(pen, objects);
    nameSurfaces(pen, objects);
    this.labels = labels.placed;
    this.#stillFresh = true;
  }

  #drawNow(now) {
    const { transform, moments, contacts, hand, objects } = this.#view;
    if (!this.#stillFresh) {
      this.#drawStill();
    }
    const ctx = this.#ctx;
    ctx.setTransform(1, 0, 0, 1, 0, 0);
    ctx.drawImage(this.#still, 0, 0);
    ctx.setTransform(this.#dpr, 0, 0, this.#dpr, 0, 0);
    const moment = moments.newest;
    ctx.save();
    ctx.beginPath(); // keeps the labels along the edges free
    ctx.rect(EDGE_LEFT_PX, 0, transform.width - EDGE_LEFT_PX, transform.height - EDGE_BOTTOM_PX);
    ctx.clip();
    this.#drawMembranes(ctx, moment, objects);
    this.#drawPicked(ctx);
    const marks = contacts.marks.seen(now);
    drawMarks(ctx, transform, marks, this.#colours);
    let fading = false;
    if (moment !== null) {
      fading = this.#drawHandle(ctx, moment, hand, now);
    }
    ctx.restore();
    this.frames++;
    this.#view.drawn(moment);
    if (marks.length > 0 || fading) {
      this.draw();
    }
  }

  #drawMembranes(ctx, moment, objects) {
    const { transform, contacts } = this.#view;
    const touching = new Set(contacts.touching);
    for (const [id, object] of Object.entries(objects)) {
      if (object.kind === "membrane" && isSeen(object, transform.seen)) {
        const touch = moment !== null && touching.has(id) ? moment.position : null;
        drawMembrane(ctx, transform, object, touch, contacts.punctures.hole(id), this.#colours);
      }
    }
  }

  #drawPicked(ctx) {
    const { transform, mode, selected, objects } = this.#view;
    const object = objects[selected];
    if (mode === "arrange" && object !== undefined) {
      drawSelection(ctx, transform, object, (c) => outline(c, transform, object), this.#colours);
    }
  }

  // Updates the largest vibration since the last frame, which then fades; returns true while it fades.
  #shownVibration(now) {
    const found = this.#view.moments.vibration();
    const left = Math.max(0, 1 - (now - this.#vibration.at) / VIBRATION_MS);
    const held = this.#vibration.force.map((value) => value * left);
    if (Math.hypot(...found) >= Math.hypot(...held)) {
      this.#vibration = { force: found, at: now };
      return found;
    }
    return held;
  }

  #drawHandle(ctx, moment, hand, now) {
    const { transform, contacts, limitN } = this.#view;
    const colours = this.#colours;
    const handle = transform.toPx(moment.position);
    const vibration = this.#shownVibration(now);
    drawForces(ctx, handle, { contact: moment.contact, vibration, force: moment.force }, {
      limitN, pxPerN: this.pxPerN, saturated: isSaturated(moment), colours,
    });
    if (hand.target !== null && this.#view.moments.playback === null) {
      drawHand(ctx, transform.toPx(hand.target), handle, colours);
    }
    ctx.beginPath();
    ctx.arc(...handle, 6.5, 0, 2 * Math.PI);
    ctx.fillStyle = colours.position;
    ctx.fill();
    ctx.strokeStyle = colours.ground;
    ctx.lineWidth = 2;
    ctx.stroke();
    const surface = contacts.surfacePoint(moment.position);
    if (surface !== null) {
      const [x, y] = transform.toPx(surface);
      ctx.beginPath();
      ctx.arc(x, y, 3.5, 0, 2 * Math.PI);
      ctx.fillStyle = colours.ground;
      ctx.fill();
      ctx.strokeStyle = colours.accent;
      ctx.lineWidth = 2;
      ctx.stroke();
    }
    return Math.hypot(...vibration) * this.pxPerN >= 2;
  }
}

// Draws the hand, and the elastic line from it to the handle: a longer line means a larger force between them.
function drawHand(ctx, at, handle, colours) {
  ctx.strokeStyle = colours.hand;
  ctx.lineWidth = 1.5;
  ctx.beginPath();
  ctx.moveTo(...handle);
  ctx.lineTo(...at);
  ctx.stroke();
  ctx.lineWidth = 2;
  ctx.beginPath();
  ctx.arc(...at, 11, 0, 2 * Math.PI);
  for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
    ctx.moveTo(at[0] + 11 * dx, at[1] + 11 * dy);
    ctx.lineTo(at[0] + 15 * dx, at[1] + 15 * dy);
  }
  ctx.stroke();
}

// Sets the path of `ctx` to the outline of an object.
function outline(ctx, transform, object) {
  ctx.beginPath();
  const frame = frameOf(object);
  if (object.kind === "disc") {
    ctx.arc(...transform.toPx(frame.point), object.radius_m * transform.pxPerM + 3, 0, 2 * Math.PI);
  } else if (object.kind === "box") {
    corners(frame).forEach((corner) => ctx.lineTo(...transform.toPx(corner)));
    ctx.closePath();
  } else if (object.kind === "membrane") {
    ends(frame).forEach((end) => ctx.lineTo(...transform.toPx(end)));
  } else if (object.kind === "wall") {
    const seen = sectionSeen(frame.point, frame.tangent, transform.seen) ?? [0, 0];
    seen.forEach((s) => ctx.lineTo(...transform.toPx(along(frame.point, frame.tangent, s))));
    const [x, y] = transform.toPx(frame.point);
    ctx.moveTo(x + 5, y);
    ctx.arc(x, y, 5, 0, 2 * Math.PI);
  } else if (!SURFACES.has(object.kind) && object.center_m) {
    ctx.arc(...transform.toPx(object.center_m), 14, 0, 2 * Math.PI);
  }
}
