// How long frames took: the last of them, for benchmarks.
const KEPT = 1024;

export class FrameTiming {
  frames = 0;
  #ms = new Float64Array(KEPT);

  add(ms) {
    this.#ms[this.frames++ % KEPT] = ms;
  }

  // {frames, meanMs, p95Ms, maxMs} of the frames since frame `from`.
  since(from) {
    const ms = [];
    for (let k = Math.max(from, this.frames - KEPT); k < this.frames; k++) {
      ms.push(this.#ms[k % KEPT]);
    }
    ms.sort((a, b) => a - b);
    const mean = ms.reduce((sum, value) => sum + value, 0) / ms.length;
    return { frames: this.frames - from, meanMs: mean, p95Ms: ms[Math.floor(0.95 * ms.length)], maxMs: ms.at(-1) };
  }
}
