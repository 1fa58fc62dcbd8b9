// Which stretch of time is shown. While it runs, it follows the newest sample or stands around the last trigger; held,
// it stays where it is, and may be panned and zoomed. `zero` is the time that the axis calls 0.
export const WIDTHS_S = [0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 60];
const LEAST_S = 0.0005;
const MOST_S = 60;

export class ViewWindow {
  widthS = 5;
  before = 0.2; // the part of the width that lies before the trigger
  held = false;
  trigger = null; // time of the trigger that is shown; null: the newest sample is
  #newest = 0;
  #left = 0;
  #zero = 0;

  // The newest sample is of this time.
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

  // Shows what was recorded from `left` on, with its time zero.
  holdAt(left, zero) {
    this.#left = left;
    this.#zero = zero;
    this.held = true;
  }

  // Makes the window `factor` times as wide. Held, the time at `share` of the width stays where it is.
  zoom(factor, share = 0.5) {
    this.setWidth(this.widthS * factor, share);
  }

  setWidth(widthS, share = 0.5) {
    const width = Math.min(MOST_S, Math.max(LEAST_S, widthS));
    if (this.held) {
      this.#left += (this.widthS - width) * share;
    }
    this.widthS = width;
  }

  // The next wider or narrower of the usual widths.
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

  // Moves by a part of the width, which holds the picture. Some of it stays between `oldest` and `newest`.
  pan(share, oldest, newest) {
    this.hold();
    const left = this.#left + share * this.widthS;
    this.#left = Math.min(newest - 0.1 * this.widthS, Math.max(oldest - 0.9 * this.widthS, left));
  }
}
