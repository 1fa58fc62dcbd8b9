// The time window. While it runs, it follows the newest sample or surrounds the last trigger; while it is held, it stays and
// may be panned and zoomed. `zero` is the time at the axis' 0.
export const WIDTHS_S = [0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 60];
const MIN_WIDTH_S = 0.0005;
const MAX_WIDTH_S = 60;

export class ViewWindow {
  widthS = 5;
  before = 0.2; // fraction of the width before the trigger
  held = false;
  trigger = null; // time of the shown trigger; null: the newest sample is shown
  #newest = 0;
  #left = 0;
  #zero = 0;

  // Sets the time of the newest sample.
  follow(newest) {
    this.#newest = newest;
  }

  get left() {
    if (this.held) {
      return this.#left;
    }
    return this.trigger === null ? this.#newest - this.widthS : this.trigger - this.before * this.widthS;
  }

  get right() {
    return this.left + this.widthS;
  }

  get zero() {
    if (this.held) {
      return this.#zero;
    }
    return this.trigger ?? this.#newest;
  }

  hold() {
    if (!this.held) {
      this.#left = this.left;
      this.#zero = this.zero;
      this.held = true;
    }
  }

  run() {
    this.held = false;
  }

  // Shows a recorded window from `left` on, with its time zero.
  holdAt(left, zero) {
    this.#left = left;
    this.#zero = zero;
    this.held = true;
  }

  // Makes the window `factor` times as wide. While held, the time at the fraction `share` of the width stays in place.
  zoom(factor, share = 0.5) {
    this.setWidth(this.widthS * factor, share);
  }

  setWidth(widthS, share = 0.5) {
    const width = Math.min(MAX_WIDTH_S, Math.max(MIN_WIDTH_S, widthS));
    if (this.held) {
      this.#left += (this.widthS - width) * share;
    }
    this.widthS = width;
  }

  // Sets the next wider or narrower of the usual widths.
  step(direction, share = 0.5) {
    const next =
      direction > 0
        ? WIDTHS_S.find((width) => width > this.widthS * 1.001)
        : WIDTHS_S.findLast((width) => width < this.widthS * 0.999);
    if (next !== undefined) {
      this.setWidth(next, share);
    } else {
      this.zoom(direction > 0 ? 2 : 0.5, share);
    }
  }

  // Moves by a fraction of the width and holds the picture. A part of the window stays between `oldest` and `newest`.
  pan(share, oldest, newest) {
    this.hold();
    const left = this.#left + share * this.widthS;
    this.#left = Math.min(newest - 0.1 * this.widthS, Math.max(oldest - 0.9 * this.widthS, left));
  }
}
