// White noise for headphones, which masks the sound of the motors. Browsers play it only after a press of a button.
import { button, make } from "/static/dom.js";

const NOISE_DURATION_S = 4; // repeated
const MAX_GAIN = 0.3;

export class Noise {
  running = false;
  #context = null;
  #gain = null;
  #level = 0.3;
  #button;

  constructor(element) {
    this.#button = button("White noise", "small", () => this.toggle(), { "aria-pressed": "false", id: "noise-button" });
    const level = make("input", { type: "range", min: 0, max: 1, step: 0.01, value: this.#level, "aria-label": "Loudness of the noise" });
    level.addEventListener("input", () => this.#set(Number(level.value)));
    element.append(this.#button, level);
  }

  async toggle() {
    this.running = !this.running;
    this.#button.setAttribute("aria-pressed", String(this.running));
    this.#button.blur(); // so that Enter presses the button of the screen
    if (!this.running) {
      await this.#context.suspend();
      return;
    }
    if (this.#context === null) {
      this.#begin();
    }
    await this.#context.resume();
  }

  #begin() {
    this.#context = new AudioContext();
    const { sampleRate } = this.#context;
    const buffer = this.#context.createBuffer(1, NOISE_DURATION_S * sampleRate, sampleRate);
    const samples = buffer.getChannelData(0);
    for (let i = 0; i < samples.length; i++) {
      samples[i] = 2 * Math.random() - 1;
    }
    const source = new AudioBufferSourceNode(this.#context, { buffer, loop: true });
    this.#gain = new GainNode(this.#context, { gain: MAX_GAIN * this.#level });
    source.connect(this.#gain).connect(this.#context.destination);
    source.start();
  }

  #set(level) {
    this.#level = level;
    if (this.#gain !== null) {
      this.#gain.gain.value = MAX_GAIN * level;
    }
  }
}
