// Least and largest value of any stretch of a ring of samples, in a few reads: a pyramid of blocks of 8, 64, 512, ...
// samples, each with its minimum and maximum, which grows with the ring. Nothing is left out: the extremes of a stretch
// are those of its samples, so a single one that stands out is always seen. A value that is no number is passed over.
const BLOCK = 8;
const SPAN = BLOCK ** 8; // rows; a whole number of blocks of every level

export class Pyramid {
  #column;
  #capacity;
  #levels = []; // level k has blocks of 8^(k + 1) rows: {low, high, slots, done}; `done` blocks are made
  #base = NaN; // none yet
  #offsets = []; // where the base lies in the ring of samples, and in that of each level
  low = 0; // of the last stretch that was asked for
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

  // Rows from `first` on to `rows` are in the ring: makes the blocks that became whole.
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
    const slots = lows.length;
    let low = Infinity;
    let high = -Infinity;
    let at = (block * BLOCK) % slots;
    for (let part = 0; part < BLOCK; part++) {
      if (lows[at] < low) {
        low = lows[at];
      }
      if (highs[at] > high) {
        high = highs[at];
      }
      at = at + 1 === slots ? 0 : at + 1;
    }
    const level = this.#levels[k];
    level.low[block % level.slots] = low;
    level.high[block % level.slots] = high;
  }

  // `low` and `high` of rows from..to - 1, which must be in the ring and extended to. None: Infinity and -Infinity.
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
      const whole = k === last ? end : Math.max(next, end & -BLOCK);
      this.#include(k, whole, end);
      begin = next / BLOCK;
      end = whole / BLOCK;
    }
  }

  // Rows are counted from a base, so that they stay small integers however long a page is open.
  #rebase(row) {
    this.#base = Math.floor(row / SPAN) * SPAN;
    this.#offsets[0] = this.#base % this.#capacity;
    this.#levels.forEach((level, k) => (this.#offsets[k + 1] = (this.#base / BLOCK ** (k + 1)) % level.slots));
  }

  // Widens low and high by the blocks begin..end - 1 of level k, counted from the base; level -1 are the samples.
  #include(k, begin, end) {
    if (begin >= end) {
      return;
    }
    const lows = k < 0 ? this.#column : this.#levels[k].low;
    const highs = k < 0 ? this.#column : this.#levels[k].high;
    const slots = lows.length;
    let { low, high } = this;
    let at = (this.#offsets[k + 1] + begin) % slots;
    for (let block = begin; block < end; block++) {
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
