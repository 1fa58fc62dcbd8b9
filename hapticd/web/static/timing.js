// Frame rate and latencies of the page, measured on request: `hapticd.timing.start()`, then `await report()`.
//
//   frames           frames a second, and the time between two of them
//   sample_to_pixel  time from a sample (`time_ns`) to the end of the first frame that shows it. A module that draws
//                    samples calls `drew(row)` with the newest row that it drew; if none did, `source` is "frames" and the
//                    newest row that had come before the frame is used.
//   pointer_to_force time from a movement of the pressed pointer over the scene to the first sample whose force differs by
//                    0.02 N
//
// Times of samples are CLOCK_MONOTONIC of the daemon's machine. Their offset to this page's clock is measured with an error
// of at most half the shortest round trip, which the report has as `clock_error_ms`.
const MAX_FRAMES = 20_000;
const FORCE_CHANGE_N = 0.02;
const MAX_LATENCY_MS = 500;

export function quantile(values, share) {
  const sorted = [...values].sort((a, b) => a - b);
  return sorted.length === 0 ? null : sorted[Math.min(sorted.length - 1, Math.ceil(share * sorted.length) - 1)];
}

function summary(values) {
  return { count: values.length, p50: quantile(values, 0.5), p95: quantile(values, 0.95), max: quantile(values, 1) };
}

class Kept {
  values = [];
  add(value) {
    if (this.values.length < MAX_FRAMES) {
      this.values.push(value);
    }
  }
}

export class Timing {
  running = false;
  #app;
  #begun = 0;
  #frames = 0;
  #last = null; // time of the previous frame
  #seenRow = 0; // rows before this one were shown
  #drawnRow = null; // newest row that a module drew since the last frame
  #toldRows = false;
  #pointer = null; // a movement that waits for its force
  #frameMs = new Kept();
  #sampleMs = new Kept();
  #pointerMs = new Kept();
  #unanswered = 0;
  #offsetMs = null; // CLOCK_MONOTONIC minus performance.now()
  #errorMs = null;

  constructor(app) {
    this.#app = app;
    app.samples.addEventListener("added", () => this.running && this.#added());
    const scene = document.getElementById("scene-view"); // without a scene there is no pointer to measure
    scene?.addEventListener("pointermove", (event) => this.running && this.#moved(event), { capture: true, passive: true });
  }

  // Notes the newest row that a module drew.
  drew(row) {
    this.#drawnRow = row;
    this.#toldRows = true;
  }

  async start() {
    await this.compareClocks();
    Object.assign(this, { running: true });
    this.#begun = performance.now();
    [this.#frames, this.#last, this.#drawnRow, this.#pointer, this.#unanswered] = [0, null, null, null, 0];
    [this.#frameMs, this.#sampleMs, this.#pointerMs] = [new Kept(), new Kept(), new Kept()];
    this.#toldRows = false;
    this.#seenRow = this.#app.samples.rows;
    requestAnimationFrame((now) => this.#frame(now));
  }

  // Ends measuring, and returns the results since start().
  report() {
    const seconds = (performance.now() - this.#begun) / 1e3;
    this.running = false;
    return {
      seconds,
      frames_per_s: this.#frames / seconds,
      frame_ms: summary(this.#frameMs.values),
      sample_to_pixel_ms: { ...summary(this.#sampleMs.values), source: this.#toldRows ? "drawn" : "frames" },
      pointer_to_force_ms: { ...summary(this.#pointerMs.values), unanswered: this.#unanswered },
      clock_error_ms: this.#errorMs,
      samples_lost: this.#app.samples.lost,
    };
  }

  // Measures the offset of the two clocks; start() does so, too.
  async compareClocks() {
    this.#errorMs = Infinity;
    for (let i = 0; i < 20; i++) {
      const before = performance.now();
      const { clock } = await this.#app.link.call("get_status");
      const after = performance.now();
      if ((after - before) / 2 < this.#errorMs) {
        this.#errorMs = (after - before) / 2;
        this.#offsetMs = clock.monotonic_ns / 1e6 - (before + after) / 2;
      }
    }
  }

  // Returns the time at which a row was rendered, as performance.now() of this page, in ms.
  timeOf(row) {
    const { samples } = this.#app;
    const ns = Number(samples.originNs) / 1e6 + samples.columns.time_s[row % samples.capacity] * 1e3;
    return ns - this.#offsetMs;
  }

  #frame(now) {
    if (!this.running) {
      return;
    }
    if (this.#last !== null) {
      this.#frames++;
      this.#frameMs.add(now - this.#last);
    }
    this.#last = now;
    const here = this.#app.samples.rows - 1;
    this.#drawnRow = null;
    // A task queued here runs after all modules have drawn and the frame is complete.
    const { port1, port2 } = new MessageChannel();
    port1.onmessage = () => {
      this.#shown(this.#toldRows ? this.#drawnRow : here, performance.now());
      port1.close();
    };
    port2.postMessage(null);
    requestAnimationFrame((next) => this.#frame(next));
  }

  // Notes that the current frame shows the rows up to this one (null: none).
  #shown(row, shown) {
    const from = Math.max(this.#seenRow, this.#app.samples.first);
    if (row === null || row < from) {
      return;
    }
    this.#seenRow = row + 1;
    const step = Math.max(1, Math.floor((row - from) / 8));
    for (let each = from; each <= row; each += step) {
      this.#sampleMs.add(shown - this.timeOf(each));
    }
  }

  #forceAt(row) {
    const { columns, capacity } = this.#app.samples;
    return [columns.force_x_n[row % capacity], columns.force_y_n[row % capacity]];
  }

  #moved(event) {
    const { samples } = this.#app;
    if (event.buttons !== 0 && this.#pointer === null && samples.rows > 0) {
      this.#pointer = { at: event.timeStamp, row: samples.rows, force: null };
    }
  }

  #added() {
    const { samples } = this.#app;
    const waiting = this.#pointer;
    if (waiting === null) {
      return;
    }
    for (let row = Math.max(waiting.row, samples.first); row < samples.rows; row++) {
      const time = this.timeOf(row);
      const force = this.#forceAt(row);
      if (time < waiting.at) {
        waiting.force = force;
      } else {
        waiting.force ??= force;
        if (Math.hypot(force[0] - waiting.force[0], force[1] - waiting.force[1]) >= FORCE_CHANGE_N) {
          this.#pointerMs.add(time - waiting.at);
          this.#pointer = null;
          return;
        }
        if (time - waiting.at > MAX_LATENCY_MS) {
          this.#unanswered++;
          this.#pointer = null;
          return;
        }
      }
    }
    waiting.row = samples.rows;
  }
}
