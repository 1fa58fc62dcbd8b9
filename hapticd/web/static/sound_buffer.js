// The jitter buffer of the sound: a ring that is written in batches by one clock and read evenly by another.
//
//   fill       buffered time in seconds; it is kept at `target_s` by reading up to 0.5 % faster or slower, which cannot be
//              heard (a PI controller on the fill, averaged over a second)
//   gap        the ring is empty: the sound fades out within 3 ms, waits until the fill is at its target, and fades in. The
//              target grows by 15 ms with each gap, up to 80 ms, and decreases by 0.5 ms a second
//   skip       the fill is more than `max_surplus_s` above the target (the page was blocked): fades out, skips samples, fades in
//   lost       samples that did not arrive: the sound fades out and in within 3 ms, to avoid clicks
//
// Samples have two components, x and y, in N. A place is an index of samples since the beginning.
import { REACH } from "./sound_interpolator.js";

const CAPACITY = 1 << 17;
export const MASK = CAPACITY - 1;
export const BASE_S = 0.045;
const MAX_TARGET_S = 0.08; // keeps the latency below 150 ms
const TARGET_STEP_S = 0.015;
const TARGET_DECREASE_S_PER_S = 0.0005;
const HALF_BATCH_S = 0.01;
const FADE_S = 0.003;
const AVERAGE_S = 1;
const PROPORTIONAL_PER_S = 0.2;
const INTEGRAL_PER_S2 = 0.01;
export const MAX_CORRECTION = 0.005;

export class SampleBuffer {
  x = new Float32Array(CAPACITY);
  y = new Float32Array(CAPACITY);
  written = 0;
  place = 0; // the place that is read next
  playing = false;
  fade = 0; // gain, 0 to 1
  correction = 0; // relative deviation of the reading rate from the nominal one
  gaps = 0;
  skips = 0;
  lost = 0;
  nonfinite = 0;
  rate;
  target_s = BASE_S;
  max_surplus_s;
  #integral = 0;
  #surplus_s = 0; // fill above the target, averaged
  #skipping = false;

  constructor(rate, max_surplus_s = 0.12) {
    this.rate = rate;
    this.max_surplus_s = max_surplus_s;
  }

  get fill_s() {
    return (this.written - this.place) / this.rate;
  }

  // Writes pairs [x, y, x, y, ...]; `missing`: number of samples lost before them.
  write(pairs, missing = 0) {
    const from = this.written;
    const count = pairs.length >> 1;
    for (let i = 0, at = from; i < count; i++, at++) {
      const [x, y] = [pairs[2 * i], pairs[2 * i + 1]];
      const sound = Number.isFinite(x) && Number.isFinite(y);
      this.nonfinite += sound ? 0 : 1;
      this.x[at & MASK] = sound ? x : 0;
      this.y[at & MASK] = sound ? y : 0;
    }
    this.written += count;
    if (missing > 0) {
      this.lost += missing;
      this.#taper(from, count);
    }
  }

  #taper(from, count) {
    const length = Math.ceil(FADE_S * this.rate);
    const before = Math.min(length, Math.floor(from - this.place));
    const weigh = (at, part) => {
      const weight = 0.5 - 0.5 * Math.cos(Math.PI * part);
      this.x[at & MASK] *= weight;
      this.y[at & MASK] *= weight;
    };
    for (let i = 0; i < before; i++) {
      weigh(from - 1 - i, i / length);
    }
    for (let i = 0; i < Math.min(length, count); i++) {
      weigh(from + i, i / length);
    }
  }

  // Drops all samples: the rate changed or the daemon was restarted.
  restart(rate) {
    this.rate = rate;
    this.place = this.written;
    this.playing = false;
    this.fade = 0;
    this.#integral = this.#surplus_s = this.correction = 0;
  }

  // Called before each `seconds` of sound: decides whether samples are played, and how fast.
  follow(seconds) {
    if (!this.playing) {
      const wanted_s = this.target_s + HALF_BATCH_S;
      if (this.fill_s < wanted_s) {
        return;
      }
      this.playing = true;
      this.place = this.written - wanted_s * this.rate;
      this.#surplus_s = 0;
    }
    this.target_s = Math.max(BASE_S, this.target_s - TARGET_DECREASE_S_PER_S * seconds);
    const surplus_s = this.fill_s - this.target_s;
    if (surplus_s > this.max_surplus_s) {
      this.#skipping = true;
    }
    this.#surplus_s += (surplus_s - this.#surplus_s) * (seconds / AVERAGE_S);
    const limited = (value) => Math.max(-MAX_CORRECTION, Math.min(MAX_CORRECTION, value));
    this.#integral = limited(this.#integral + INTEGRAL_PER_S2 * this.#surplus_s * seconds);
    this.correction = limited(PROPORTIONAL_PER_S * this.#surplus_s + this.#integral);
  }

  // Advances the fade by `seconds` after a value was read; returns false if no value can be read. `ahead`: number of samples
  // after the place that must be in the ring, too.
  step(seconds, ahead) {
    if (!this.playing) {
      return false;
    }
    const change = seconds / FADE_S;
    const room = (this.written - this.place - REACH - ahead - 1) / this.rate;
    const wanted = this.#skipping || room < FADE_S ? 0 : 1;
    this.fade = wanted === 1 ? Math.min(1, this.fade + change) : Math.max(0, this.fade - change);
    if (this.fade > 0 || wanted === 1) {
      return true;
    }
    if (this.#skipping) {
      this.#skipping = false;
      this.skips++;
      this.place = this.written - (this.target_s + HALF_BATCH_S) * this.rate;
      return true;
    }
    this.playing = false;
    this.gaps++;
    this.target_s = Math.min(MAX_TARGET_S, this.target_s + TARGET_STEP_S);
    return false;
  }
}
