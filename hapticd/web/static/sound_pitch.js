// Pitch shifting by 4 or 8, to hear vibrations below the range of hearing.
//
// Grains, each a few periods long, are read `pitch` times as fast as they came and overlap by half (Hann windows), so that
// the pitch rises and the duration stays. The beginning of a grain is searched so that it continues the previous grain (the
// largest normalised correlation over the last 15 ms): a tone stays in phase and gets exactly `pitch` times its frequency. A
// tap becomes higher and keeps its duration.
//
// A grain needs earlier samples of (pitch - 1) times its length. This adds a delay: on average half of that and half of the
// search. At a pitch of 1 samples are read unchanged.
import { MASK } from "./sound_buffer.js";
import { Interpolator } from "./sound_interpolator.js";

const GRAIN_S = { 4: 0.02, 8: 0.012 };
const SEARCH_S = 0.015;
const COMPARED_PLACES = 96; // number of places at which two grains are compared
const MAX_FREQUENCY_FRACTION = 0.9; // highest frequency, as a fraction of half the output's rate

class Grain {
  constructor(begin, at) {
    this.begin = begin; // place of the first sample
    this.at = at; // number of values that were read
  }
}

export class PitchReader {
  pitch = 1;
  #outRate;
  #interpolator;
  #grains = [];
  #length = 0; // length of a grain, in values
  #until = 0; // values until the next grain begins

  constructor(outRate) {
    this.#outRate = outRate;
    this.set(1, 10000);
  }

  // `rate`: the rate of the samples.
  set(pitch, rate) {
    this.pitch = pitch;
    this.#interpolator = new Interpolator((MAX_FREQUENCY_FRACTION * this.#outRate) / (pitch * rate));
    this.#length = pitch === 1 ? 0 : 2 * Math.round((GRAIN_S[pitch] * this.#outRate) / 2);
    this.#grains = [];
    this.#until = 0;
  }

  // The delay that the pitch adds, in s.
  get delay_s() {
    return this.pitch === 1 ? 0 : ((this.pitch - 1) * GRAIN_S[this.pitch] + SEARCH_S) / 2;
  }

  // Stores the value at the buffer's place, [x, y], in `value`; `step`: samples from one value to the next.
  read(buffer, step, value) {
    if (this.pitch === 1) {
      value[0] = this.#interpolator.at(buffer.x, MASK, buffer.place);
      value[1] = this.#interpolator.at(buffer.y, MASK, buffer.place);
      return;
    }
    if (this.#until === 0) {
      this.#begin(buffer, step);
      this.#until = this.#length / 2;
    }
    this.#until--;
    value[0] = value[1] = 0;
    for (const grain of this.#grains) {
      const weight = 0.5 - 0.5 * Math.cos((2 * Math.PI * (grain.at + 0.5)) / this.#length);
      const place = grain.begin + grain.at * step * this.pitch;
      value[0] += weight * this.#interpolator.at(buffer.x, MASK, place);
      value[1] += weight * this.#interpolator.at(buffer.y, MASK, place);
      grain.at++;
    }
    if (this.#grains[0].at >= this.#length) {
      this.#grains.shift();
    }
  }

  #begin(buffer, step) {
    // Early enough that the end of the grain is not read before it has come.
    const latest = buffer.place - (this.pitch - 1) * this.#length * step;
    const before = this.#grains.at(-1);
    let begin = latest;
    if (before !== undefined) {
      const next = before.begin + before.at * step * this.pitch;
      const overlap = ((this.#length / 2) * step * this.pitch) | 0;
      begin = latest - this.#lagOf(buffer, Math.floor(next), Math.floor(latest), overlap) + (next % 1) - (latest % 1);
    }
    this.#grains.push(new Grain(begin, 0));
  }

  // Returns how many samples before `latest` the grain begins that is most similar to the samples from `next` on.
  #lagOf(buffer, next, latest, overlap) {
    const { x, y } = buffer;
    const every = Math.max(1, Math.floor(overlap / COMPARED_PLACES));
    const maxLag = Math.round(SEARCH_S * buffer.rate);
    let [best, found] = [0, 0];
    for (let lag = 0; lag <= maxLag; lag++) {
      let [product, energy] = [0, 1e-12];
      for (let i = 0; i < overlap; i += every) {
        const [a, b] = [(next + i) & MASK, (latest - lag + i) & MASK];
        product += x[a] * x[b] + y[a] * y[b];
        energy += x[b] * x[b] + y[b] * y[b];
      }
      const likeness = product / Math.sqrt(energy);
      if (likeness > best * (1 + 1e-6)) {
        [best, found] = [likeness, lag];
      }
    }
    return found;
  }
}
