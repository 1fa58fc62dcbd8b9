// The controls of the sound, and its state.
const NUMBERS = new Intl.NumberFormat("en", { maximumFractionDigits: 0 });

function made(html) {
  const template = document.createElement("template");
  template.innerHTML = html;
  return template.content;
}

const PANEL = `
<div class="card stack">
  <h3>Vibration</h3>
  <div class="row">
    <button id="sound-start" class="button primary" type="button">Start sound</button>
    <span id="sound-state" class="pill plain" role="status">Off</span>
  </div>
  <p class="note">A browser plays sound only after you press a button or a key. Use headphones: left is x + y, right is y - x.</p>
  <p id="sound-error" class="error-line" role="alert"></p>
  <div class="field">
    <label for="sound-volume">Volume</label>
    <span class="entry"><output id="sound-volume-value" class="number"></output><span class="unit">%</span></span>
    <input id="sound-volume" type="range" min="0" max="100" step="1">
  </div>
  <label class="check"><input id="sound-muted" type="checkbox"> Mute the vibration</label>
  <div class="field">
    <span id="sound-pitch-label">Pitch</span>
    <div class="toolbar segmented" role="group" aria-labelledby="sound-pitch-label">
      <button class="button small" type="button" data-pitch="1">1 &times;</button>
      <button class="button small" type="button" data-pitch="4">4 &times;</button>
      <button class="button small" type="button" data-pitch="8">8 &times;</button>
    </div>
  </div>
  <p class="note">4 &times; and 8 &times; raise what is too low to be heard, in short overlapping pieces. It is higher, and
  lasts as long as before.</p>
</div>
<div class="card stack">
  <h3>Noise</h3>
  <div class="field">
    <label for="sound-noise">White noise</label>
    <span class="entry"><output id="sound-noise-value" class="number"></output><span class="unit">%</span></span>
    <input id="sound-noise" type="range" min="0" max="100" step="1">
  </div>
  <p class="note">Masks the sound of the motors, as for the subjects of Okamura et al. (1998). 0 % is off.</p>
</div>
<div class="card stack">
  <h3>State</h3>
  <dl class="facts">
    <dt>Sample to sound</dt><dd id="sound-latency"></dd>
    <dt>Buffer</dt><dd id="sound-buffer"></dd>
    <dt>Level</dt><dd id="sound-level"></dd>
    <dt>Gaps</dt><dd id="sound-gaps"></dd>
    <dt>Clock correction</dt><dd id="sound-correction"></dd>
  </dl>
  <p id="sound-parts" class="note"></p>
</div>`;

export class SoundPanel {
  #sound;
  #of;

  constructor(sound, element) {
    this.#sound = sound;
    this.#of = (id) => element.querySelector(`#sound-${id}`);
    element.append(made(PANEL));
    const of = this.#of;
    of("start").addEventListener("click", () => this.#toggle());
    for (const name of ["volume", "noise"]) {
      of(name).addEventListener("input", () => sound.set({ [name]: Number(of(name).value) / 100 }));
    }
    of("muted").addEventListener("change", () => sound.set({ muted: of("muted").checked }));
    for (const button of element.querySelectorAll("[data-pitch]")) {
      button.addEventListener("click", () => sound.set({ pitch: Number(button.dataset.pitch) }));
    }
    sound.addEventListener("changed", () => this.#showSettings(element));
    sound.addEventListener("report", () => element.hidden || this.#showReport());
    this.#showSettings(element);
    this.#showReport();
  }

  async #toggle() {
    const start = this.#of("start");
    this.#of("error").textContent = "";
    start.disabled = true;
    try {
      await (this.#sound.running ? this.#sound.stop() : this.#sound.start());
    } catch (error) {
      this.#of("error").textContent = `No sound: ${error.message}`;
    }
    start.disabled = false;
    start.focus();
  }

  #showSettings(element) {
    const { settings, running } = this.#sound;
    const of = this.#of;
    for (const name of ["volume", "noise"]) {
      of(name).value = Math.round(100 * settings[name]);
      of(`${name}-value`).textContent = of(name).value;
    }
    of("muted").checked = settings.muted;
    for (const button of element.querySelectorAll("[data-pitch]")) {
      button.setAttribute("aria-pressed", String(Number(button.dataset.pitch) === settings.pitch));
    }
    of("start").textContent = running ? "Stop sound" : "Start sound";
    of("state").textContent = running ? "On" : "Off";
    of("state").className = `pill ${running ? "ok" : "plain"}`;
    if (!running) {
      this.#showReport();
    }
  }

  #showReport() {
    const { report } = this.#sound;
    const latency = this.#sound.latency();
    const put = (id, text) => (this.#of(id).textContent = text);
    const ms = (value) => `${NUMBERS.format(value)} ms`;
    put("latency", latency === null ? "-" : ms(latency.sum));
    put("buffer", report === null ? "-" : `${ms(1e3 * report.fill_s)} of ${ms(1e3 * report.target_s)}`);
    put("level", report === null ? "-" : report.peak > 0 ? `${(20 * Math.log10(report.peak)).toFixed(0)} dB` : "silent");
    const lost = report === null || report.lost === 0 ? "" : `, ${NUMBERS.format(report.lost)} samples lost`;
    put("gaps", report === null ? "-" : `${report.gaps + report.skips}${lost}`);
    put("correction", report === null ? "-" : `${(1e2 * report.correction).toFixed(3)} %`);
    const parts = latency ?? { way: 0, buffer: 0, pitch: 0, output: 0 };
    const text =
      `To this page ${ms(parts.way)}, in the buffer ${ms(parts.buffer)}, for the pitch ${ms(parts.pitch)}, ` +
      `in browser and device ${ms(parts.output)}.`;
    put("parts", latency === null ? "" : text);
  }
}
