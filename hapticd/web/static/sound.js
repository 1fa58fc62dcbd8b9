// The sound: vibration_force_n on both ears, noise that masks the sound of the motors, and the latency.
//
//   app.sound.start(), stop()   a browser allows sound only after a press of a button or a key
//   app.sound.latency()         latency from the time of a sample to its sound: its parts in ms, and their sum
//   app.sound.report            the last report of sound_worklet.js: fill, gaps, peak, ...
//   app.sound.output            the AudioNode of the output, while the sound runs
import { SoundPanel } from "./sound_panel.js";

const WORKLET = new URL("./sound_worklet.js", import.meta.url);
const STORAGE_KEY = "hapticd.sound";
const CLOCK_COMPARISONS = 10;
const ARRIVAL_WEIGHT = 0.1; // weight of an arrival in the moving average

export class Sound extends EventTarget {
  settings = { volume: 0.5, muted: false, pitch: 1, noise: 0 };
  report = null;
  output = null;
  running = false;
  #app;
  #context = null;
  #row = 0; // rows before this one were sent
  #lost = 0;
  #rate = 0;
  #offsetMs = null; // CLOCK_MONOTONIC minus performance.now()
  #arrivalMs = null; // mean time from the newest sample of a batch to its arrival

  constructor(app) {
    super();
    this.#app = app;
    try {
      Object.assign(this.settings, JSON.parse(localStorage.getItem(STORAGE_KEY) ?? "{}"));
    } catch {
      localStorage.removeItem(STORAGE_KEY); // not written by this page
    }
    app.samples.addEventListener("added", () => this.running && this.#send());
    app.samples.addEventListener("lost", ({ detail }) => (this.#lost += detail.count));
    app.samples.addEventListener("restart", () => this.running && this.#restart());
    app.model.addEventListener("status", () => this.running && app.model.rateHz !== this.#rate && this.#restart());
  }

  // Must be called by a press of a button or a key. Throws the browser's error if there is no sound output.
  async start() {
    if (this.running) {
      return;
    }
    const { samples, model, attention } = this.#app;
    const context = new AudioContext({ latencyHint: "interactive" });
    try {
      await context.audioWorklet.addModule(WORKLET);
      this.#rate = model.rateHz;
      const options = { numberOfInputs: 0, outputChannelCount: [2], processorOptions: { rate: this.#rate } };
      const output = new AudioWorkletNode(context, "hapticd-vibration", options);
      output.port.onmessage = ({ data }) => this.#reported(data.report);
      output.onprocessorerror = () => this.#failed();
      output.port.postMessage(this.settings);
      output.connect(context.destination);
      [this.#context, this.output] = [context, output];
    } catch (error) {
      await context.close();
      throw error;
    }
    await this.#compareClocks();
    [this.#row, this.#lost, this.#arrivalMs] = [samples.rows, 0, null];
    this.running = true;
    attention.hold("sound");
    await context.resume();
    this.dispatchEvent(new Event("changed"));
  }

  async stop() {
    if (!this.running) {
      return;
    }
    this.running = false;
    this.#app.attention.release("sound");
    const context = this.#context;
    [this.#context, this.output, this.report] = [null, null, null];
    await context.close();
    this.dispatchEvent(new Event("changed"));
  }

  set(settings) {
    Object.assign(this.settings, settings);
    localStorage.setItem(STORAGE_KEY, JSON.stringify(this.settings));
    this.output?.port.postMessage(settings);
    this.dispatchEvent(new Event("changed"));
  }

  // Returns the latency from the time of a sample to its sound, in ms; null while nothing is played. `way`: from the daemon
  // to this page; `buffer`: buffered samples; `pitch`: the grains; `output`: the browser and the device.
  latency() {
    if (this.report === null || this.report.written_fill_s === null || this.#arrivalMs === null) {
      return null;
    }
    const { baseLatency, outputLatency } = this.#context;
    const parts = {
      way: this.#arrivalMs,
      buffer: 1e3 * this.report.written_fill_s,
      pitch: 1e3 * this.report.pitch_delay_s,
      output: 1e3 * (baseLatency + (outputLatency || 0)),
    };
    return { ...parts, sum: parts.way + parts.buffer + parts.pitch + parts.output };
  }

  #reported(report) {
    if (report !== undefined && this.running) {
      this.report = report;
      this.dispatchEvent(new Event("report"));
    }
  }

  #failed() {
    this.#app.view.dispatchEvent(
      new CustomEvent("notice", { detail: { text: "The sound failed and was stopped. Start it again.", kind: "error" } }),
    );
    this.stop();
  }

  #restart() {
    this.#rate = this.#app.model.rateHz;
    this.output.port.postMessage({ rate: this.#rate });
    [this.#row, this.#lost] = [this.#app.samples.rows, 0];
    this.#compareClocks();
  }

  // Sends the samples that came since the last call.
  #send() {
    const { samples } = this.#app;
    const { vibration_x_n: x, vibration_y_n: y, time_s: time } = samples.columns;
    const from = Math.max(this.#row, samples.first);
    const missing = this.#lost + (from - this.#row);
    const pairs = new Float32Array(2 * (samples.rows - from));
    for (let row = from, i = 0; row < samples.rows; row++, i += 2) {
      const at = row % samples.capacity;
      pairs[i] = x[at];
      pairs[i + 1] = y[at];
    }
    [this.#row, this.#lost] = [samples.rows, 0];
    if (this.#offsetMs !== null) {
      const newest = Number(samples.originNs) / 1e6 + 1e3 * time[(samples.rows - 1) % samples.capacity];
      const arrivalMs = performance.now() + this.#offsetMs - newest;
      this.#arrivalMs = this.#arrivalMs === null ? arrivalMs : this.#arrivalMs + ARRIVAL_WEIGHT * (arrivalMs - this.#arrivalMs);
    }
    this.output.port.postMessage({ pairs, missing }, [pairs.buffer]);
  }

  // Measures the offset between the daemon's clock and this page's, with an error of at most half the shortest round trip.
  async #compareClocks() {
    let shortest = Infinity;
    this.#offsetMs = null;
    let offsetMs = null;
    for (let i = 0; i < CLOCK_COMPARISONS; i++) {
      const before = performance.now();
      const { clock } = await this.#app.link.call("get_status");
      const after = performance.now();
      if (after - before < shortest) {
        shortest = after - before;
        offsetMs = clock.monotonic_ns / 1e6 - (before + after) / 2;
      }
    }
    this.#offsetMs = offsetMs;
    this.#arrivalMs = null;
  }
}

export function mount(app, element) {
  app.sound = new Sound(app);
  new SoundPanel(app.sound, element);
}
