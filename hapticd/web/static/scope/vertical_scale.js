// The range of a vertical axis: automatic, so that all drawn values fit, or set by the user.

const SHRINK_DELAY_MS = 1000; // time after which a range that is too large becomes smaller

// Returns the smallest of 1, 2 or 5 times a power of ten that is at least `size`.
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

  constructor(minRange) {
    this.minRange = minRange; // the smallest range: smaller ones would show the rounding of the sensor
  }

  set(low, high) {
    this.automatic = false;
    this.low = low;
    this.high = high;
  }

  // Fits the range to values between low and high. `settled`: the picture does not move, so the range changes at once.
  fit(low, high, nowMs, settled) {
    if (!this.automatic || !(low <= high)) {
      return;
    }
    const room = Math.max(high - low, this.minRange);
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
    if (outside || settled || (smaller && nowMs - this.#smallerSince > SHRINK_DELAY_MS)) {
      this.low = bottom;
      this.high = top;
      this.#smallerSince = null;
    }
  }
}
