// Interpolation between samples by a windowed sinc (Kaiser, 32 samples long). Frequencies above `cutoff`, a fraction of half
// the signal's rate, are removed, so that a signal that is read faster does not alias.
const TAPS = 32;
const PHASES = 128;
const BETA = 8;

export const REACH = TAPS / 2; // number of samples that are needed after a place

// The modified Bessel function of order zero.
function bessel(x) {
  let [sum, term] = [1, 1];
  for (let k = 1; k < 40; k++) {
    term *= (x / (2 * k)) ** 2;
    sum += term;
  }
  return sum;
}

function kernel(cutoff) {
  const table = new Float32Array((PHASES + 1) * TAPS);
  for (let phase = 0; phase <= PHASES; phase++) {
    let sum = 0;
    for (let tap = 0; tap < TAPS; tap++) {
      const t = tap - (REACH - 1) - phase / PHASES;
      const inside = Math.max(0, 1 - (t / REACH) ** 2);
      const sinc = t === 0 ? 1 : Math.sin(Math.PI * cutoff * t) / (Math.PI * cutoff * t);
      const value = sinc * bessel(BETA * Math.sqrt(inside));
      table[phase * TAPS + tap] = value;
      sum += value;
    }
    for (let tap = 0; tap < TAPS; tap++) {
      table[phase * TAPS + tap] /= sum; // a constant signal stays unchanged
    }
  }
  return table;
}

export class Interpolator {
  #table;

  constructor(cutoff) {
    this.#table = kernel(Math.min(1, cutoff));
  }

  // Returns the value of a ring at a place, counted in samples since the beginning. `mask`: the ring's length minus one.
  at(ring, mask, place) {
    const floor = Math.floor(place);
    const phase = (place - floor) * PHASES;
    const low = Math.floor(phase);
    const part = phase - low;
    const table = this.#table;
    const from = low * TAPS;
    let [below, above] = [0, 0];
    for (let tap = 0, index = floor - REACH + 1; tap < TAPS; tap++, index++) {
      const value = ring[index & mask];
      below += table[from + tap] * value;
      above += table[from + TAPS + tap] * value;
    }
    return below + part * (above - below);
  }
}
