// The player of a recording: its force over time with a mark at the moment, a slider, play and speed. It shows app.playback
// (playback.js), as do the scope and the scene.
import { button, make } from "./dom.js";
import { options } from "./scope/elements.js";
import { color, onTheme } from "./theme.js";

const PLAYBACK_SPEEDS = [0.1, 0.2, 0.5, 1];
const OUTLINE_HEIGHT_PX = 72;
const EVENT_COLOURS = { contact: "--contact", puncture: "--rupture", mark: "--accent" };

export class RecordingPlayer {
  #app;
  #fail;
  #outline = null; // {first, last, min, max} or {first, last, raw}
  #range = [0, 1]; // rows that the outline shows
  #seeking = false;

  constructor(app, fail) {
    this.#app = app;
    this.#fail = fail;
    this.#build();
    for (const name of ["playback", "moment"]) {
      app.view.addEventListener(name, ({ detail }) => this.#shown(detail));
    }
    onTheme(() => this.#draw());
    new ResizeObserver(() => this.#load()).observe(this.canvas);
  }

  focus() {
    this.slider.focus();
  }

  #build() {
    this.canvas = make("canvas", {
      class: "recording-outline",
      role: "img",
      "aria-label": "Force over time",
      on: { pointerdown: (event) => this.#pointed(event), pointermove: (event) => this.#pointed(event) },
    });
    this.slider = make("input", {
      id: "recording-moment",
      type: "range",
      min: "0",
      max: "1",
      step: "1",
      "aria-label": "Moment",
      on: { keydown: (event) => this.#key(event), input: () => this.#seek(Number(this.slider.value)) },
    });
    this.time = make("output", { class: "number", for: "recording-moment" });
    this.play = button("Play", "", () => this.#toggle());
    this.speed = make("select", {
      id: "recording-speed",
      class: "select",
      on: { change: () => (this.#app.playback.speed = Number(this.speed.value)) },
    });
    options(
      this.speed,
      PLAYBACK_SPEEDS.map((speed) => [String(speed), `${speed}×`]),
      "1",
    );
    const zoom = (text, label, click) => button(text, "small", click, { "aria-label": label });
    this.about = make("dl", { class: "facts" });
    this.title = make("h3", {});
    this.element = make(
      "section",
      { class: "card stack recording-player", hidden: true },
      this.title,
      this.canvas,
      this.slider,
      make(
        "div",
        { class: "row" },
        this.play,
        make("label", { for: "recording-speed" }, "Speed"),
        this.speed,
        make("span", { class: "spacer" }),
        this.time,
      ),
      make(
        "div",
        { class: "row" },
        zoom("Closer", "Show less time around the moment", () => this.#zoom(0.25)),
        zoom("Wider", "Show more time around the moment", () => this.#zoom(4)),
        zoom("Whole", "Show the complete recording", () => this.#zoom(Infinity)),
        make("span", { class: "spacer" }),
        button("Back to now", "", () => this.#leave()),
      ),
      this.about,
    );
  }

  // ---- Events -----------------------------------------------------------------------------------------------------

  #shown({ active, playing }) {
    const { playback } = this.#app;
    if (active && this.element.hidden) {
      this.#begin(playback.facts);
    }
    this.element.hidden = !active;
    if (!active) {
      this.#outline = null;
      return;
    }
    this.play.textContent = playing ? "Pause" : "Play";
    if (this.title.textContent !== playback.facts.name) {
      this.#begin(playback.facts);
    }
    if (!this.#seeking) {
      this.slider.value = playback.row;
    }
    const text = `${playback.timeS.toFixed(4)} s`;
    this.slider.setAttribute("aria-valuetext", text);
    this.time.textContent = `${text} of ${playback.facts.duration_s.toFixed(3)} s`;
    const [first, last] = this.#range;
    if (playback.row < first || playback.row >= last) {
      this.#show(playback.row - (last - first) / 2, last - first);
    }
    this.#draw();
  }

  #begin(facts) {
    this.title.textContent = facts.name;
    this.slider.max = facts.rows - 1;
    this.#range = [0, facts.rows];
    const made =
      facts.started_ns === null ? [] : [["Recorded", new Date(facts.started_ns / 1e6).toLocaleString("en-GB")]];
    const entries = [
      ...made,
      ["Rate", `${facts.rate_hz.toLocaleString("en")} Hz`],
      ["Missed periods", facts.missed_periods.toLocaleString("en")],
      ...(facts.ended_because === null ? [] : [["Ended early", facts.ended_because]]),
      ...Object.entries(facts.notes).map(([name, text]) => [name, String(text)]),
    ];
    this.about.replaceChildren(
      ...entries.flatMap(([name, text]) => [make("dt", {}, name), make("dd", {}, text)]),
    );
    this.#load();
  }

  #toggle() {
    const { playback } = this.#app;
    if (playback.playing) {
      playback.pause();
    } else if (playback.row >= playback.facts.rows - 1) {
      this.#seek(0).then(() => playback.play());
    } else {
      playback.play();
    }
  }

  // Arrow keys go by 10 ms, with Shift by one sample; Page Up and Page Down by a second.
  #key(event) {
    const { facts, row } = this.#app.playback;
    const step = { ArrowLeft: -0.01, ArrowDown: -0.01, ArrowRight: 0.01, ArrowUp: 0.01, PageDown: -1, PageUp: 1 }[
      event.key
    ];
    if (step === undefined) {
      return;
    }
    event.preventDefault();
    this.#seek(row + (event.shiftKey ? Math.sign(step) : Math.round(step * facts.rate_hz)));
  }

  async #seek(row) {
    const { rows } = this.#app.playback.facts;
    this.slider.value = Math.max(0, Math.min(rows - 1, Math.round(row))); // at once, before the samples come
    this.#seeking = true;
    try {
      await this.#app.playback.seek(row);
    } catch (error) {
      this.#fail(error);
    } finally {
      this.#seeking = false;
    }
  }

  #leave() {
    this.#app.playback.close().catch((error) => this.#fail(error));
  }

  #pointed(event) {
    if (event.type === "pointerdown") {
      this.canvas.setPointerCapture(event.pointerId);
    }
    if (event.buttons & 1) {
      const { left, width } = this.canvas.getBoundingClientRect();
      const [first, last] = this.#range;
      this.#seek(first + ((event.clientX - left) / width) * (last - first));
    }
  }

  // ---- The outline ------------------------------------------------------------------------------------------------

  #zoom(factor) {
    const [first, last] = this.#range;
    const width = (last - first) * factor;
    this.#show(this.#app.playback.row - width / 2, width);
  }

  // Returns the range of `count` rows from `first` on, limited to the rows of the recording.
  #show(first, width) {
    const { rows } = this.#app.playback.facts;
    const wide = Math.max(Math.min(16, rows), Math.min(rows, Math.round(width)));
    const from = Math.max(0, Math.min(rows - wide, Math.round(first)));
    if (from !== this.#range[0] || from + wide !== this.#range[1]) {
      this.#range = [from, from + wide];
      this.#load();
    }
  }

  async #load() {
    const { playback, link } = this.#app;
    const pixels = Math.min(4096, Math.round(this.canvas.clientWidth * devicePixelRatio));
    if (!playback.active || pixels === 0) {
      return;
    }
    const [first, last] = this.#range;
    try {
      const found = await link.call("web.playback_outline", { column: "force_n", first, last, pixels });
      if (playback.active && first === this.#range[0] && last === this.#range[1]) {
        const floats = (data) => new Float32Array(data.slice().buffer);
        this.#outline = found.raw ? { raw: floats(found.raw) } : { min: floats(found.min), max: floats(found.max) };
        this.#draw();
      }
    } catch (error) {
      this.#fail(error);
    }
  }

  #draw() {
    const { playback } = this.#app;
    const width = Math.round(this.canvas.clientWidth * devicePixelRatio);
    if (!playback.active || this.#outline === null || width === 0) {
      return;
    }
    const height = Math.round(OUTLINE_HEIGHT_PX * devicePixelRatio);
    if (this.canvas.width !== width || this.canvas.height !== height) {
      Object.assign(this.canvas, { width, height });
    }
    const context = this.canvas.getContext("2d");
    context.clearRect(0, 0, width, height);
    const high = this.#outline.raw ?? this.#outline.max;
    const low = this.#outline.raw ?? this.#outline.min;
    const largestN = high.reduce((found, value) => (value > found ? value : found), 0.1);
    const y = (value) => height - 2 - (value / largestN) * (height - 16 * devicePixelRatio);
    context.beginPath();
    for (let i = 0; i < high.length; i++) {
      const x = ((i + 0.5) / high.length) * width;
      if (Number.isFinite(high[i]) && Number.isFinite(low[i])) {
        context.lineTo(x, y(high[i]));
        context.lineTo(x, y(low[i]));
      }
    }
    context.strokeStyle = color("force");
    context.lineWidth = devicePixelRatio;
    context.stroke();
    this.#drawMarks(context, width, height);
    context.fillStyle = color("muted");
    context.font = `${11 * devicePixelRatio}px sans-serif`;
    context.fillText(`force, up to ${largestN.toPrecision(2)} N`, 2 * devicePixelRatio, 11 * devicePixelRatio);
  }

  #drawMarks(context, width, height) {
    const [first, last] = this.#range;
    const x = (row) => ((row - first) / (last - first)) * width;
    for (const event of this.#app.playback.facts.events) {
      const found = EVENT_COLOURS[event.event];
      if (found !== undefined && event.row >= first && event.row < last) {
        context.fillStyle = color(found.slice(2));
        context.fillRect(x(event.row), height - 8 * devicePixelRatio, 2 * devicePixelRatio, 8 * devicePixelRatio);
      }
    }
    context.fillStyle = color("accent");
    context.fillRect(x(this.#app.playback.row) - devicePixelRatio, 0, 2 * devicePixelRatio, height);
  }
}
