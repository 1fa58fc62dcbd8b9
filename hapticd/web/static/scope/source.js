// The data of the oscilloscope: a store of samples (samples.js, or a recording), with search of rows by time and by tick, the
// gaps, and a pyramid for every drawn channel.
import { CHANNEL } from "./channels.js";
import { Pyramid } from "./pyramid.js";

const GAP_PERIODS = 1.5; // a longer step, in periods, is a gap
const SETTLED_STEPS = 8; // number of successive equal steps that set a new period

export class Source {
  #tracks = new Map(); // by channel id: {column, pyramid, derived}
  #lost;
  #gapsDone = 0;
  #equalSteps = 0;
  #lastStep = 0;
  periodS = NaN;
  generation = 0; // incremented when all rows were replaced: another store, or one that was emptied
  segment = 0; // row from which on ticks rise: a restarted daemon begins with tick 0

  constructor(store) {
    this.store = store;
    this.begin();
  }

  // Starts again after the store's rows were replaced.
  begin() {
    this.time = this.store.columns.time_s;
    this.#tracks.clear();
    this.gaps = new Uint8Array(this.store.capacity); // 1: there is a gap before this row
    this.#lost = new Uint8Array(this.store.capacity); // 1: samples in that gap were missed or lost
    this.lostPyramid = new Pyramid(this.#lost);
    this.#gapsDone = this.#equalSteps = this.#lastStep = this.segment = 0;
    this.periodS = NaN;
    this.generation++;
  }

  get rows() {
    return this.#gapsDone;
  }

  get first() {
    return Math.min(Math.max(this.store.first, 0), this.#gapsDone);
  }

  get capacity() {
    return this.store.capacity;
  }

  // Time of the newest row, s; NaN: there is none.
  get newest() {
    return this.rows === 0 ? NaN : this.time[(this.rows - 1) % this.capacity];
  }

  get oldest() {
    return this.rows === 0 ? NaN : this.time[this.first % this.capacity];
  }

  // Adds the new rows. Must be called once a frame, before anything is read.
  update() {
    if (this.time !== this.store.columns.time_s || this.store.rows < this.#gapsDone) {
      this.begin();
    }
    if (this.store.capacity > 0) {
      this.#findGaps();
      for (const track of this.#tracks.values()) {
        this.#extend(track);
      }
    }
  }

  #findGaps() {
    const { first, rows, capacity, ticks } = this.store;
    for (let row = Math.max(this.#gapsDone, first); row < rows; row++) {
      const at = row % capacity;
      let gap = 0;
      if (row > first) {
        const before = (row - 1) % capacity;
        gap = this.#isGap(this.time[at] - this.time[before]) ? 1 : 0;
        if (ticks[at] <= ticks[before]) {
          this.segment = row;
          gap = 1;
        }
      }
      this.gaps[at] = gap;
      this.#lost[at] = gap === 1 && !this.store.leftOutBefore(row) ? 1 : 0;
    }
    this.#gapsDone = rows;
    this.lostPyramid.extend(first, rows);
  }

  // Returns whether samples were missed by the servo or lost before this row. Samples before the first row, and those left
  // out on purpose, do not count.
  lostBefore(row) {
    return row > this.first && row < this.rows && this.#lost[row % this.capacity] === 1;
  }

  // Returns whether samples were missed or lost before any of the rows from..to - 1.
  lostWithin(from, to) {
    this.lostPyramid.range(Math.max(from, this.first + 1), to);
    return this.lostPyramid.high > 0;
  }

  #isGap(step) {
    if (!(step > 0)) {
      return true;
    }
    this.#equalSteps = Math.abs(step - this.#lastStep) < 0.01 * step ? this.#equalSteps + 1 : 0;
    this.#lastStep = step;
    if (!(step >= 0.75 * this.periodS) || this.#equalSteps >= SETTLED_STEPS) {
      this.periodS = step;
    }
    return step > GAP_PERIODS * this.periodS;
  }

  // Returns ring and pyramid of a channel, which are updated from the first call on.
  track(id) {
    let track = this.#tracks.get(id);
    if (track === undefined && this.capacity > 0) {
      const names = CHANNEL[id].columns;
      const derived = names.length === 2 ? names.map((name) => this.store.columns[name]) : null;
      const column = derived ? new Float64Array(this.capacity) : this.store.columns[names[0]];
      track = { column, pyramid: new Pyramid(column), derived, done: 0 };
      this.#tracks.set(id, track);
      this.#extend(track);
    }
    return track;
  }

  // Releases the pyramids of channels that are not drawn any more.
  keepOnly(ids) {
    for (const id of this.#tracks.keys()) {
      if (!ids.has(id)) {
        this.#tracks.delete(id);
      }
    }
  }

  #extend(track) {
    const { capacity } = this;
    const { first } = this.store;
    if (track.derived) {
      const [x, y] = track.derived;
      for (let row = Math.max(track.done, first); row < this.rows; row++) {
        const at = row % capacity;
        track.column[at] = Math.hypot(x[at], y[at]);
      }
      track.done = this.rows;
    }
    track.pyramid.extend(first, this.rows);
  }

  // Returns the first row at `time` or later, or `rows` if there is none.
  rowAt(time) {
    return this.#search(this.time, time, this.first);
  }

  // Returns the row of a tick; -1 if it is not stored or has not come yet.
  rowOfTick(tick) {
    const row = this.#search(this.store.ticks, tick, Math.max(this.first, this.segment));
    return row < this.rows && this.store.ticks[row % this.capacity] === tick ? row : -1;
  }

  get newestTick() {
    return this.rows === 0 ? -1 : this.store.ticks[(this.rows - 1) % this.capacity];
  }

  #search(column, value, low) {
    let high = this.rows;
    while (low < high) {
      const middle = Math.floor((low + high) / 2);
      if (column[middle % this.capacity] < value) {
        low = middle + 1;
      } else {
        high = middle;
      }
    }
    return low;
  }

  // Returns the part of the rows from..to - 1 without a gap that contains the row `around`: [first row, row after it].
  stretchAround(around, from, to) {
    let [begin, end] = [around, around + 1];
    while (begin > from && this.gaps[begin % this.capacity] === 0) {
      begin--;
    }
    while (end < to && this.gaps[end % this.capacity] === 0) {
      end++;
    }
    return [begin, end];
  }

  // Returns the longest part of the rows from..to - 1 without a gap.
  longestStretch(from, to) {
    let best = [from, from];
    let begin = from;
    for (let row = from + 1; row <= to; row++) {
      if (row === to || this.gaps[row % this.capacity] === 1) {
        if (row - begin > best[1] - best[0]) {
          best = [begin, row];
        }
        begin = row;
      }
    }
    return best;
  }

  // Returns a copy of a channel's rows from..to - 1.
  copy(id, from, to, into = new Float64Array(to - from)) {
    const { column } = this.track(id);
    for (let row = from; row < to; row++) {
      into[row - from] = column[row % this.capacity];
    }
    return into;
  }
}
