// All samples of the last minute: a ring of columns. Rows are counted from 0 since the page was opened; the index of a row
// in a column is `row % capacity`; rows from `first` to `rows - 1` are stored. Batches are those of the topic `samples`
// (docs/reference/telemetry.md), and are read by their `dtype` (sample_layout.js), so that fields may be added, moved or left out.
//
// Rows are in the order of time, with gaps: `ticks` shows where samples were lost or left out on purpose. After a restart
// of the daemon all rows are removed, because their ticks and times belong to another clock.
import { layoutOf } from "./sample_layout.js";

const SAMPLE_COLUMNS = {
  // name: [field of the sample, component, factor]
  time_s: ["time_ns", 0, 1e-9], x_m: ["position_m", 0, 1], y_m: ["position_m", 1, 1],
  vx_m_per_s: ["velocity_m_per_s", 0, 1], vy_m_per_s: ["velocity_m_per_s", 1, 1],
  contact_x_n: ["contact_force_n", 0, 1], contact_y_n: ["contact_force_n", 1, 1],
  vibration_x_n: ["vibration_force_n", 0, 1], vibration_y_n: ["vibration_force_n", 1, 1],
  force_x_n: ["force_n", 0, 1], force_y_n: ["force_n", 1, 1],
  lateness_s: ["lateness_ns", 0, 1e-9], work_s: ["work_ns", 0, 1e-9], flags: ["flags", 0, 1],
};
const COLUMN_TYPES = { time_s: Float64Array, flags: Uint32Array };
export const MAX_ROWS = 800_000; // 54 MB; at rates above 13 kHz less than a minute

// Events: `added` {count}: rows were added; `lost` {count}: samples were lost; `restart`: all rows were removed.
export class SampleStore extends EventTarget {
  rows = 0; // number of rows; the newest is rows - 1
  lost = 0; // samples that did not arrive; the daemon lost `dropped` of them
  dropped = 0;
  originNs = null; // time_ns of the first sample, where time_s is 0
  rateHz = 10000;
  capacity = 0;
  columns = {};
  ticks = null;
  #start = 0; // the oldest row that may be used
  #nextTick = null; // null: the next sample may have any later tick
  #lastTick = -1;
  #lastDropped = null;
  #leftOut = []; // rows before which samples were left out on purpose

  constructor(seconds) {
    super();
    this.seconds = seconds;
  }

  get first() {
    return Math.max(this.#start, this.rows - this.capacity, 0);
  }

  // Sets the servo's rate. The ring grows so that it stores its time span; it never shrinks.
  setRate(rateHz) {
    this.rateHz = rateHz;
    const wanted = Math.min(Math.ceil(this.seconds * rateHz), MAX_ROWS);
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
    for (const name of Object.keys(SAMPLE_COLUMNS)) {
      columns[name] = moved(COLUMN_TYPES[name] ?? Float32Array, this.columns[name]);
    }
    this.ticks = moved(Float64Array, this.ticks);
    this.columns = columns;
    this.capacity = capacity;
    this.#start = from; // rows that the smaller ring had overwritten are lost
  }

  // Samples are left out on purpose from now on: the next gap is not counted as lost.
  expectGap() {
    this.#nextTick = null;
    this.#lastDropped = null;
  }

  // Returns whether samples were left out on purpose before this row.
  leftOutBefore(row) {
    return this.#leftOut.includes(row);
  }

  // Removes all rows: the next one added is `row`, and time_s counts from `originNs`, or from that row.
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
    const skipped = records.count - count; // of a batch longer than the ring only the end is kept
    for (const [name, [field, component, factor]] of Object.entries(SAMPLE_COLUMNS)) {
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

  // Counts the samples lost before this batch, and detects a restarted daemon.
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
