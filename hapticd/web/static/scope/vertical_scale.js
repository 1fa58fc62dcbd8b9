// How much of a quantity an axis shows: automatic, so that all that is drawn fits, or as the person set it.

const PATIENCE_MS = 1000; // a range that is too large for so long becomes smaller

// The least multiple of 1, 2 or 5 times a power of ten that is at least `size`.
export function niceStep(size) {
  const power = 10 ** Math.floor(Math.log10(size));
  const share = size / power;
  return (share <= 1 ? 1 : share <= 2 ? 2 : share <= 5 ? 5 : 10) * power;
}

export class VerticalScale {
  automatic = true;
  low = -1; // in the axis' unit
  high = 1;
  #smallerSince = null;

  constructor(least) {
    this.least = least; // a range smaller than this is not shown: below it is the rounding of the sensor
  }

  set(low, high) {
    this.automatic = false;
    this.low = low;
    this.high = high;
  }

  // Everything between low and high is to be seen. `settled`: the picture stands, and the scale fits it at once.
  fit(low, high, nowMs, settled) {
    if (!this.automatic || !(low <= high)) {
      return;
    }
    const room = Math.max(high - low, this.least);
    const middle = (low + high) / 2;
    const step = niceStep(room / 4);
    const bottom = Math.floor((Math.min(low, middle - room / 2) - 0.02 * room) / step) * step;
    const top = Math.ceil((Math.max(high, middle + room / 2) + 0.02 * room) / step) * step;
    const outside = low < this.low || high > this.high;
    const smaller = top - bottom < 0.8 * (this.high - this.low);
    if (!smaller) {
      this.#smallerSince = null;
    } else {
      this.#smallerSince ??= nowMs;
    }
    if (outside || settled || (smaller && nowMs - this.#smallerSince > PATIENCE_MS)) {
      this.low = bottom;
      this.high = top;
      this.#smallerSince = null;
    }
  }
}
