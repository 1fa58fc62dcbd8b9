// The picture for the participant: surfaces, to scale, and stylus. All surfaces look alike, so that none shows its material.
import { color, onTheme } from "/static/theme.js";
import { Transform } from "/static/scene_view/transform.js";

const MIN_EXTENT_M = 0.12; // smallest extent of the surfaces
const MARGIN_FACTOR = 1.5; // visible range over the extent of the surfaces
const MAX_HALF_LENGTH_M = 0.06; // half length for which an unlimited surface counts
const BODY_DEPTH_PX = 34; // drawn depth of a surface's body
const [STYLUS_WIDTH_PX, STYLUS_TIP_PX, STYLUS_LENGTH_PX] = [12, 16, 110];
const STYLUS_TILT_RAD = 0.42;

// Returns the visible range [left, bottom, right, top] in m, which contains all surfaces and space for the hand.
export function extent(surfaces) {
  const ends = surfaces.flatMap(({ point_m: [x, y], normal: [nx, ny], half_m }) => {
    const half = Math.min(half_m, MAX_HALF_LENGTH_M);
    return [[x + half * ny, y - half * nx], [x - half * ny, y + half * nx]];
  });
  const xs = ends.map(([x]) => x);
  const ys = ends.map(([, y]) => y);
  const [left, right] = [Math.min(...xs), Math.max(...xs)];
  const [bottom, top] = [Math.min(...ys), Math.max(...ys)];
  const half = (MARGIN_FACTOR * Math.max(MIN_EXTENT_M, right - left, top - bottom)) / 2;
  const [cx, cy] = [(left + right) / 2, (bottom + top) / 2];
  return [cx - half, cy - half / 2, cx + half, cy + half / 2];
}

export class Picture {
  transform = new Transform();
  stylus = null; // [x, y] in m
  #canvas;
  #surfaces = [];
  #felt = false;
  #wanted = false;

  constructor(canvas) {
    this.#canvas = canvas;
    new ResizeObserver(() => this.#resized()).observe(canvas);
    onTheme(() => this.#draw());
  }

  show(surfaces, felt) {
    this.#surfaces = surfaces;
    this.#felt = felt;
    this.#resized();
  }

  moved(stylus) {
    this.stylus = stylus;
    if (!this.#wanted) {
      this.#wanted = true;
      requestAnimationFrame(() => this.#draw());
    }
  }

  #resized() {
    const box = this.#canvas.getBoundingClientRect();
    if (box.width === 0) {
      return;
    }
    const scale = devicePixelRatio;
    [this.#canvas.width, this.#canvas.height] = [Math.round(box.width * scale), Math.round(box.height * scale)];
    this.transform.resize(box.width, box.height);
    if (this.#surfaces.length > 0) {
      this.transform.fit(extent(this.#surfaces));
    }
    this.#draw();
  }

  #draw() {
    this.#wanted = false;
    const context = this.#canvas.getContext("2d");
    context.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    context.clearRect(0, 0, this.transform.width, this.transform.height);
    context.globalAlpha = this.#felt ? 1 : 0.45;
    for (const surface of this.#surfaces) {
      this.#drawSurface(context, surface);
    }
    if (this.stylus !== null) {
      this.#drawStylus(context);
    }
    context.globalAlpha = 1;
  }

  #drawSurface(context, { point_m: [x, y], normal: [nx, ny], half_m }) {
    const half = Math.min(half_m, 10);
    const [ax, ay] = this.transform.toPx([x + half * ny, y - half * nx]);
    const [bx, by] = this.transform.toPx([x - half * ny, y + half * nx]);
    const [dx, dy] = [-nx * BODY_DEPTH_PX, ny * BODY_DEPTH_PX]; // into the body, in pixels
    context.fillStyle = color("sunken");
    context.beginPath();
    context.moveTo(ax, ay);
    context.lineTo(bx, by);
    context.lineTo(bx + dx, by + dy);
    context.lineTo(ax + dx, ay + dy);
    context.fill();
    context.strokeStyle = color("text");
    context.lineWidth = 3;
    context.beginPath();
    context.moveTo(ax, ay);
    context.lineTo(bx, by);
    context.stroke();
  }

  // Draws a pen whose tip is at the position of the stylus.
  #drawStylus(context) {
    const [x, y] = this.transform.toPx(this.stylus);
    context.save();
    context.translate(x, y);
    context.rotate(STYLUS_TILT_RAD);
    context.fillStyle = color("accent");
    context.beginPath();
    context.moveTo(0, 0);
    context.lineTo(-STYLUS_WIDTH_PX / 2, -STYLUS_TIP_PX);
    context.lineTo(-STYLUS_WIDTH_PX / 2, -STYLUS_LENGTH_PX);
    context.lineTo(STYLUS_WIDTH_PX / 2, -STYLUS_LENGTH_PX);
    context.lineTo(STYLUS_WIDTH_PX / 2, -STYLUS_TIP_PX);
    context.fill();
    context.restore();
  }
}
