// From the plane of the simulation to the canvas: metres, x to the right and y up, to CSS pixels, x to the right and y
// down. Pure functions.

const MIN_PX_PER_M = 200; // 5 m on a page 1000 pixels wide
const MAX_PX_PER_M = 4e6; // a pixel is a quarter of a micrometre

// Returns the largest of 1, 2, 5 times a power of ten that is at most `value`.
export function roundedDown(value) {
  const power = 10 ** Math.floor(Math.log10(value) + 1e-9);
  const lead = value / power;
  return (lead >= 5 - 1e-9 ? 5 : lead >= 2 - 1e-9 ? 2 : 1) * power;
}

// Returns the smallest of 1, 2, 5 times a power of ten that is at least `value`.
export function roundedUp(value) {
  const power = 10 ** Math.floor(Math.log10(value) + 1e-9);
  const lead = value / power;
  return (lead <= 1 + 1e-9 ? 1 : lead <= 2 + 1e-9 ? 2 : lead <= 5 + 1e-9 ? 5 : 10) * power;
}

export class Transform {
  width = 1; // size of the canvas, CSS pixels
  height = 1;
  pxPerM = 4000;
  centre = [0, 0]; // point in the middle of the canvas, m

  resize(width, height) {
    this.width = Math.max(1, width);
    this.height = Math.max(1, height);
  }

  toPx(point) {
    return [
      this.width / 2 + (point[0] - this.centre[0]) * this.pxPerM,
      this.height / 2 - (point[1] - this.centre[1]) * this.pxPerM,
    ];
  }

  toM(px) {
    return [
      this.centre[0] + (px[0] - this.width / 2) / this.pxPerM,
      this.centre[1] - (px[1] - this.height / 2) / this.pxPerM,
    ];
  }

  // The visible part of the plane: [left, bottom, right, top] in m.
  get seen() {
    const [left, top] = this.toM([0, 0]);
    const [right, bottom] = this.toM([this.width, this.height]);
    return [left, bottom, right, top];
  }

  // Zooms by `factor` around the pixel `px`.
  zoom(factor, px) {
    const held = this.toM(px);
    this.pxPerM = Math.min(MAX_PX_PER_M, Math.max(MIN_PX_PER_M, this.pxPerM * factor));
    const moved = this.toM(px);
    this.centre = [this.centre[0] + held[0] - moved[0], this.centre[1] + held[1] - moved[1]];
  }

  // Moves the picture by a number of pixels.
  pan(dx, dy) {
    this.centre = [this.centre[0] - dx / this.pxPerM, this.centre[1] + dy / this.pxPerM];
  }

  // Fits [left, bottom, right, top], in m, into the canvas without its margins (pixels).
  fit([left, bottom, right, top], margin = { left: 0, top: 0, right: 0, bottom: 0 }) {
    const width = Math.max(1, this.width - margin.left - margin.right);
    const height = Math.max(1, this.height - margin.top - margin.bottom);
    const fitting = Math.min(width / (right - left), height / (top - bottom));
    this.pxPerM = Math.min(MAX_PX_PER_M, Math.max(MIN_PX_PER_M, fitting));
    const middle = [margin.left + width / 2, margin.top + height / 2];
    this.centre = [
      (left + right) / 2 - (middle[0] - this.width / 2) / this.pxPerM,
      (bottom + top) / 2 + (middle[1] - this.height / 2) / this.pxPerM,
    ];
  }

  // Returns the distance of grid lines in m for a smallest distance in pixels.
  gridStep(minPx) {
    return roundedUp(minPx / this.pxPerM);
  }

  // Returns the length of a scale bar in m for a largest length in pixels.
  barLength(maxPx) {
    return roundedDown(maxPx / this.pxPerM);
  }
}

// Returns a length as text: "5 mm", "0.2 mm", "20 µm".
export function lengthText(metres) {
  const mm = metres * 1000;
  if (mm !== 0 && Math.abs(mm) < 0.0999) {
    return `${+(mm * 1000).toPrecision(3)} µm`;
  }
  return `${+mm.toPrecision(4)} mm`;
}
