// Samples between samples: a signal of one rate read at any place, through a windowed sinc (Kaiser, 32 samples long).
// What lies above `cutoff`, in parts of half the signal's rate, is left out, so that a signal that is read fast does not
// fold down.
const TAPS = 32;
const PHASES = 128;
const BETA = 8;

export const REACH = TAPS / 2; // so many samples after a place are needed for it

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
      table[phase * TAPS + tap] /= sum; // what does not change comes out as it is
    }
  }
  return table;
}

export class Interpolator {
  #table;

  constructor(cutoff) {
    this.#table = kernel(Math.min(1, cutoff));
  }

  // The value of a ring at a place, which is counted in samples since the beginning. `mask`: its length minus one.
  at(ring, mask, place) {
    const whole = Math.floor(place);
    const phase = (place - whole) * PHASES;
    const low = Math.floor(phase);
    const part = phase - low;
    const table = this.#table;
    const from = low * TAPS;
    let [below, above] = [0, 0];
    for (let tap = 0, index = whole - REACH + 1; tap < TAPS; tap++, index++) {
      const value = ring[index & mask];
      below += table[from + tap] * value;
      above += table[from + TAPS + tap] * value;
    }
    return below + part * (above - below);
  }
}
