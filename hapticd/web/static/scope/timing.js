// Durations of the last frames, for benchmarks.
const STORED_FRAMES = 1024;

export class FrameTiming {
  frames = 0;
  #ms = new Float64Array(STORED_FRAMES);

  add(ms) {
    this.#ms[this.frames++ % STORED_FRAMES] = ms;
  }

  // Returns {frames, meanMs, p95Ms, maxMs} of the frames since frame `from`.
  since(from) {
    const ms = [];
    for (let k = Math.max(from, this.frames - STORED_FRAMES); k < this.frames; k++) {
      ms.push(this.#ms[k % STORED_FRAMES]);
    }
    ms.sort((a, b) => a - b);
    const mean = ms.reduce((sum, value) => sum + value, 0) / ms.length;
    return { frames: this.frames - from, meanMs: mean, p95Ms: ms[Math.floor(0.95 * ms.length)], maxMs: ms.at(-1) };
  }
}
