// The last samples, every one of them: a ring of columns. Rows are counted from 0 since the page began; a row's place in
// a column is `row % capacity`; those from `first` to `rows - 1` are there. Batches come as docs/protocol.md says under
// `samples`, and are read by their `dtype` (sample_layout.js), so that fields may be added, moved or left out.
//
// Rows follow each other in time, but not without gaps: `ticks` shows where samples were lost or left out on purpose.
// Where the daemon was started again, the rows of before are forgotten: their ticks and times are of another clock.
import { layoutOf } from "./sample_layout.js";

const COLUMNS = {
  // name: [field of the sample, component, factor]
  time_s: ["time_ns", 0, 1e-9], x_m: ["position_m", 0, 1], y_m: ["position_m", 1, 1],
  vx_m_per_s: ["velocity_m_per_s", 0, 1], vy_m_per_s: ["velocity_m_per_s", 1, 1],
  contact_x_n: ["contact_force_n", 0, 1], contact_y_n: ["contact_force_n", 1, 1],
  vibration_x_n: ["vibration_force_n", 0, 1], vibration_y_n: ["vibration_force_n", 1, 1],
  force_x_n: ["force_n", 0, 1], force_y_n: ["force_n", 1, 1],
  lateness_s: ["lateness_ns", 0, 1e-9], work_s: ["work_ns", 0, 1e-9], flags: ["flags", 0, 1],
};
const TYPES = { time_s: Float64Array, flags: Uint32Array };
export const MOST_ROWS = 800_000; // 54 MB; at rates above 13 kHz they are less than a minute

// Events: `added` {count}, when rows came; `lost` {count}, samples that never came; `restart`, when the rows of before
// were forgotten.
export class SampleStore extends EventTarget {
  rows = 0; // rows that came so far; the newest is rows - 1
  lost = 0; // samples that never came here; `dropped` of them the daemon lost already
  dropped = 0;
  originNs = null; // time_ns of the first sample, where time_s is 0
  rateHz = 10000;
  capacity = 0;
  columns = {};
  ticks = null;
  #start = 0; // the oldest row that counts
  #nextTick = null; // null: what comes next may be any later tick
  #lastTick = -1;
  #lastDropped = null;
  #leftOut = []; // rows that come after samples that were left out on purpose

  constructor(seconds) {
    super();
    this.seconds = seconds;
  }

  get first() {
    return Math.max(this.#start, this.rows - this.capacity, 0);
  }

  // The servo's rate: the ring grows so that it holds its seconds. It never shrinks.
  setRate(rateHz) {
    this.rateHz = rateHz;
    const wanted = Math.min(Math.ceil(this.seconds * rateHz), MOST_ROWS);
    if (wanted > this.capacity) {
      this.#grow(wanted);
    }
  }

  #grow(capacity) {
    const from = this.first;
    const moved = (type, old) => {
      const column = new type(capacity);
      for (let row = from; row < this.rows; row++) {
        column[row % capacity] = old[row % this.capacity];
      }
      return column;
    };
    const columns = {};
    for (const name of Object.keys(COLUMNS)) {
      columns[name] = moved(TYPES[name] ?? Float32Array, this.columns[name]);
    }
    this.ticks = moved(Float64Array, this.ticks);
    this.columns = columns;
    this.capacity = capacity;
    this.#start = from; // what the smaller ring had forgotten does not come back
  }

  // Samples are left out on purpose from here on: the next gap is no loss.
  expectGap() {
    this.#nextTick = null;
    this.#lastDropped = null;
  }

  // Whether samples were left out on purpose between this row and the one before it.
  leftOutBefore(row) {
    return this.#leftOut.includes(row);
  }

  // Forgets all rows: the next one that is added is `row`, and time_s counts from `originNs`, or from that row.
  clear(row = 0, originNs = null) {
    this.rows = this.#start = row;
    this.originNs = originNs;
    this.#lastTick = -1;
    this.#leftOut = [];
    this.expectGap();
    this.dispatchEvent(new Event("restart"));
  }

  add(batch) {
    if (this.capacity === 0) {
      this.setRate(this.rateHz);
    }
    const layout = layoutOf(batch.dtype);
    const records = layout.records(batch.data);
    if (records.count === 0) {
      return;
    }
    this.#follow(batch, records);
    const count = Math.min(records.count, this.capacity);
    const skipped = records.count - count; // a batch longer than the ring: its end counts
    for (const [name, [field, component, factor]] of Object.entries(COLUMNS)) {
      const column = this.columns[name];
      const origin = name === "time_s" ? this.originNs : 0n;
      records.copy(field, component, column, (this.rows + skipped) % this.capacity, skipped, factor, origin);
    }
    records.copy("tick", 0, this.ticks, (this.rows + skipped) % this.capacity, skipped, 1, 0n);
    this.rows += records.count;
    this.#lastTick = batch.first_tick + records.count - 1;
    this.#nextTick = this.#lastTick + 1;
    this.dispatchEvent(new CustomEvent("added", { detail: { count: records.count } }));
  }

  // Counts what was lost before this batch, and notices another daemon.
  #follow(batch, records) {
    const restarted = batch.first_tick <= this.#lastTick;
    if (restarted) {
      this.#start = this.rows;
      this.#lastDropped = null;
      this.dispatchEvent(new Event("restart"));
    }
    if (restarted || this.originNs === null) {
      this.originNs = records.integer("time_ns");
    }
    if (this.#nextTick === null) {
      this.#leftOut = [...this.#leftOut.filter((row) => row >= this.first), this.rows];
    }
    const missing = restarted || this.#nextTick === null ? 0 : batch.first_tick - this.#nextTick;
    if (missing > 0) {
      this.lost += missing;
      this.dropped += Math.min(missing, Math.max(0, batch.dropped - (this.#lastDropped ?? batch.dropped)));
      this.dispatchEvent(new CustomEvent("lost", { detail: { count: missing } }));
    }
    this.#lastDropped = batch.dropped;
  }
}
