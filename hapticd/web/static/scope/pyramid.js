// Minimum and maximum of any section of a ring of samples, in a few reads: a pyramid of blocks of 8, 64, 512, ... samples,
// each with its minimum and maximum, which grows with the ring. The extremes of a section are exactly those of its samples,
// so that a single outlier is always visible. NaN is skipped.
const BLOCK = 8;
const SPAN = BLOCK ** 8; // rows; a multiple of the blocks of every level

export class Pyramid {
  #column;
  #capacity;
  #levels = []; // level k has blocks of 8^(k + 1) rows: {low, high, slots, done}; `done` blocks are complete
  #base = NaN; // not set yet
  #offsets = []; // index of the base in the ring of samples, and in that of each level
  low = 0; // minimum of the last requested section
  high = 0;

  // `column`: a ring; row r is at r % column.length.
  constructor(column) {
    this.#column = column;
    this.#capacity = column.length;
    for (let size = BLOCK; size < this.#capacity; size *= BLOCK) {
      const slots = Math.ceil(this.#capacity / size) + 1;
      this.#levels.push({ low: new column.constructor(slots), high: new column.constructor(slots), slots, done: 0 });
    }
  }

  // Computes the blocks that became complete. Rows from `first` to before `rows` are in the ring.
  extend(first, rows) {
    let size = BLOCK;
    for (let k = 0; k < this.#levels.length; k++, size *= BLOCK) {
      const level = this.#levels[k];
      const end = Math.floor(rows / size);
      for (let block = Math.max(level.done, Math.floor(first / size)); block < end; block++) {
        this.#summarize(k, block);
      }
      level.done = end;
    }
  }

  #summarize(k, block) {
    const below = k === 0 ? null : this.#levels[k - 1];
    const lows = below === null ? this.#column : below.low;
    const highs = below === null ? this.#column : below.high;
    this.low = Infinity;
    this.high = -Infinity;
    this.#extend(lows, highs, (block * BLOCK) % lows.length, BLOCK);
    const level = this.#levels[k];
    level.low[block % level.slots] = this.low;
    level.high[block % level.slots] = this.high;
  }

  // Sets `low` and `high` for rows from..to - 1, which must be in the ring and in its blocks. No rows: Infinity, -Infinity.
  range(from, to) {
    if (!(from >= this.#base && from - this.#base < SPAN)) {
      this.#rebase(from);
    }
    this.low = Infinity;
    this.high = -Infinity;
    let begin = (from - this.#base) | 0;
    let end = (to - this.#base) | 0;
    const last = this.#levels.length - 1;
    for (let k = -1; begin < end; k++) {
      const next = k === last ? end : Math.min(end, (begin + BLOCK - 1) & -BLOCK);
      this.#include(k, begin, next);
      const aligned = k === last ? end : Math.max(next, end & -BLOCK);
      this.#include(k, aligned, end);
      begin = next / BLOCK;
      end = aligned / BLOCK;
    }
  }

  // Rows are counted from a base, so that they stay small integers even if a page is open for long.
  #rebase(row) {
    this.#base = Math.floor(row / SPAN) * SPAN;
    this.#offsets[0] = this.#base % this.#capacity;
    this.#levels.forEach((level, k) => (this.#offsets[k + 1] = (this.#base / BLOCK ** (k + 1)) % level.slots));
  }

  // Extends low and high by the blocks begin..end - 1 of level k, counted from the base; level -1 are the samples.
  #include(k, begin, end) {
    if (begin >= end) {
      return;
    }
    const lows = k < 0 ? this.#column : this.#levels[k].low;
    const highs = k < 0 ? this.#column : this.#levels[k].high;
    this.#extend(lows, highs, (this.#offsets[k + 1] + begin) % lows.length, end - begin);
  }

  // Extends low and high by `count` slots of two rings, from slot `at` on.
  #extend(lows, highs, at, count) {
    const slots = lows.length;
    let { low, high } = this;
    for (let left = count; left > 0; left--) {
      if (lows[at] < low) {
        low = lows[at];
      }
      if (highs[at] > high) {
        high = highs[at];
      }
      at = at + 1 === slots ? 0 : at + 1;
    }
    this.low = low;
    this.high = high;
  }
}
