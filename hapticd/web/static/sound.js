// The panel of the sound: vibration_force_n to both ears, noise that masks the motors' sound, and how late it is.
//
//   app.sound.start(), stop()   a browser lets sound begin only after a press of a button or a key
//   app.sound.latency()         its parts in ms, and their sum: from the time of a sample to the sound of it
//   app.sound.report            what sound_worklet.js told last: fill, gaps, peak, ...
//   app.sound.output            the AudioNode that is heard, while it runs
import { SoundPanel } from "./sound_panel.js";

const WORKLET = new URL("./sound_worklet.js", import.meta.url);
const KEPT = "hapticd.sound";
const COMPARISONS = 10;
const AVERAGED = 0.1; // of an arrival in the mean

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
  #arrivalMs = null; // from the time of the newest sample of a batch until it is here, on average

  constructor(app) {
    super();
    this.#app = app;
    try {
      Object.assign(this.settings, JSON.parse(localStorage.getItem(KEPT) ?? "{}"));
    } catch {
      localStorage.removeItem(KEPT); // not ours
    }
    app.samples.addEventListener("added", () => this.running && this.#send());
    app.samples.addEventListener("lost", ({ detail }) => (this.#lost += detail.count));
    app.samples.addEventListener("restart", () => this.running && this.#restart());
    app.model.addEventListener("status", () => this.running && app.model.rateHz !== this.#rate && this.#restart());
  }

  // Called by a press of a button or a key. Raises what the browser says where it has no sound.
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
      output.port.onmessage = ({ data }) => this.#told(data.report);
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
    localStorage.setItem(KEPT, JSON.stringify(this.settings));
    this.output?.port.postMessage(settings);
    this.dispatchEvent(new Event("changed"));
  }

  // From the time of a sample to its sound, in ms; null while nothing is played. `way`: to this page, of the newest
  // sample of a batch; `buffer`: what is played before it; `pitch`: the grains; `output`: the browser and the device.
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

  #told(report) {
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

  // What came since the last call.
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
      this.#arrivalMs = this.#arrivalMs === null ? arrivalMs : this.#arrivalMs + AVERAGED * (arrivalMs - this.#arrivalMs);
    }
    this.output.port.postMessage({ pairs, missing }, [pairs.buffer]);
  }

  // The distance between the daemon's clock and this page's, known to half of the shortest way there and back.
  async #compareClocks() {
    let shortest = Infinity;
    this.#offsetMs = null;
    let offsetMs = null;
    for (let i = 0; i < COMPARISONS; i++) {
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
