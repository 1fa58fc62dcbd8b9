// The oscilloscope: traces of the samples, trigger, cursors, fit of a tap, spectrum, lateness, files. Each module in scope/
// implements one of these; this one connects them, and draws when something changed.
//
// For tests and other modules, `app.scope` has: `acquisition`, `view`, `source`, `cursors`, `tap` (the last measured
// tap, or null), `channels` (ids of drawn channels), `actions` (of the controls) and `timing` (milliseconds a frame).
import { make } from "./dom.js";
import { CHANNELS, QUANTITIES, SCALES } from "./scope/channels.js";
import { Controls, TracesPanel } from "./scope/controls.js";
import { Cursors, Legend } from "./scope/cursors.js";
import { duration, options } from "./scope/elements.js";
import { HistogramView } from "./scope/histogram.js";
import { pointerGestures, shortcuts } from "./scope/navigation.js";
import { Plot } from "./scope/plot.js";
import { saveCsv, savePng } from "./scope/saving.js";
import { Source } from "./scope/source.js";
import { SpectrumView } from "./scope/spectrum_view.js";
import { measureTap } from "./scope/tap_measurement.js";
import { FrameTiming } from "./scope/timing.js";
import { Acquisition, Trigger } from "./scope/trigger.js";
import { ViewWindow } from "./scope/view_window.js";
import { onTheme } from "./theme.js";

const INITIAL_CHANNELS = ["position_y", "contact_y", "vibration_y"];
const KEPT_EVENTS = 256;
const MIN_PLAYBACK_S = 10; // shortest time of a recording that is fetched before the moment
const TEXT_INTERVAL_MS = 100; // figures that change faster cannot be read

class Scope {
  channels = [...INITIAL_CHANNELS];
  view = new ViewWindow();
  trigger = new Trigger();
  acquisition = new Acquisition(this.trigger, this.view);
  timing = new FrameTiming();
  tap = null;
  shown = "traces";
  #spectrumOf = "vibration_y";
  #events = []; // the newest events, which the fit of a tap uses to find later strikes
  #wanted = false; // a frame is requested
  #dirty = true; // something changed that is not a new sample
  #tapPending = false;
  #textAt = -Infinity;

  constructor(app, host) {
    this.app = app;
    this.live = app.samples;
    this.source = new Source(app.samples);
    this.actions = this.#actions();
    this.#build(host);
    this.#listen();
  }

  // ---- Elements ---------------------------------------------------------------------------------------------------

  #build(host) {
    this.host = host;
    this.controls = new Controls(this.actions);
    this.panel = new TracesPanel(QUANTITIES, SCALES, this.actions);
    this.stage = make("div", {
      class: "scope-stage",
      tabindex: "0",
      role: "group",
      "aria-label": "Traces. Arrow keys pan, plus and minus zoom, H holds and runs, Home shows the newest samples.",
    });
    this.plotHost = make("div", { class: "scope-plot" });
    this.stage.append(this.plotHost);
    this.spectrumHost = make("div", { class: "scope-plot" });
    this.latenessHost = make("div", {
      class: "scope-plot",
      role: "img",
      "aria-label": "Histogram of the servo's lateness",
    });
    this.spectrumChoice = options(
      make("select", {
        class: "select",
        id: "scope-spectrum",
        on: { change: (event) => this.actions.setSpectrum(event.target.value) },
      }),
      CHANNELS.map(({ id, label }) => [id, label]),
      this.#spectrumOf,
    );
    const choice = make(
      "span",
      { class: "scope-choice" },
      make("label", { for: "scope-spectrum" }, "Spectrum of"),
      this.spectrumChoice,
    );
    this.spectrumPane = make("div", { class: "scope-pane", hidden: true }, choice, this.spectrumHost);
    this.latenessPane = make("div", { class: "scope-pane", hidden: true }, this.latenessHost);
    this.body = make("div", { class: "view-body scope-body" }, this.stage, this.spectrumPane, this.latenessPane);
    this.legendHost = make("div", {
      class: "scope-legend-host",
      tabindex: "0",
      role: "group",
      "aria-label": "Traces and cursors",
    });
    this.state = make("p", { class: "scope-state", role: "status" });
    this.message = make("p", { class: "scope-message" });
    this.foot = make("div", { class: "view-foot scope-foot" }, this.state, this.message);
    host.replaceChildren(
      this.controls.bar,
      this.body,
      this.legendHost,
      this.foot,
      this.panel.root,
    );
    this.plot = new Plot(this.plotHost);
    this.cursors = new Cursors(this.stage, this.view, this.plot);
    this.legend = new Legend(this.legendHost);
    this.spectrum = new SpectrumView(this.spectrumHost, (text) => this.#say("spectrum", text));
    this.histogram = new HistogramView(this.latenessHost, (text) => this.#say("lateness", text));
    this.#configure();
  }

  #configure() {
    this.plot.configure(this.channels);
    this.legend.configure(this.channels, this.cursors.shown);
    if (this.shown === "spectrum") {
      this.spectrum.configure();
    } else if (this.shown === "lateness") {
      this.histogram.configure(this.#lateness);
    }
    this.source.keepOnly(new Set([...this.channels, this.trigger.channel, this.#spectrumOf]));
    this.#changed();
  }

  // Requests a frame although no sample came.
  #changed() {
    this.#dirty = true;
    this.controls.show({
      view: this.shown,
      held: this.view.held,
      source: this.trigger.source,
      mode: this.acquisition.mode,
      before: this.view.before,
      widthS: this.view.widthS,
      cursors: this.cursors.shown,
      large: this.host.classList.contains("scope-large"),
      tracesOpen: !this.panel.root.hidden,
      trigger: this.trigger,
    });
    this.#ask();
  }

  // ---- Actions of the controls ------------------------------------------------------------------------------------

  #actions() {
    return {
      choose: (id) => this.#choose(id),
      toggleHold: () => (this.view.held ? this.#run() : this.#hold()),
      run: () => this.#run(),
      catchTap: () => this.#catchTap(),
      setSource: (id) => this.#restart(() => (this.trigger.source = id)),
      setMode: (id) => this.#restart(() => (this.acquisition.mode = id)),
      setBefore: (share) => this.#then(() => (this.view.before = share)),
      setLevel: (level) => this.#restart(() => Object.assign(this.trigger, level)),
      setWidth: (widthS, share) => this.#then(() => this.view.setWidth(widthS, share)),
      step: (direction, share) => this.#then(() => this.view.step(direction, share)),
      zoom: (factor, share) => this.#then(() => this.view.zoom(factor, share)),
      pan: (share) => this.#then(() => this.#pan(share)),
      toggleTraces: () => this.#toggleTraces(),
      toggleTrace: (id, on) => this.#toggleTrace(id, on),
      setScale: (id, range) => this.#then(() => this.#setScale(id, range)),
      toggleCursors: () => this.#toggleCursors(),
      toggleLarge: () => this.#then(() => this.host.classList.toggle("scope-large")),
      setSpectrum: (id) => this.#then(() => this.#setSpectrum(id)),
      savePng: () => savePng(this),
      saveCsv: () => saveCsv(this),
    };
  }

  #then(change) {
    change();
    this.spectrum?.restart();
    this.#changed();
  }

  #hold() {
    this.acquisition.hold();
    this.#then(() => {});
  }

  #run() {
    this.#restart(() => {});
  }

  #restart(change) {
    change();
    const live = this.source.store === this.live;
    this.acquisition.restart(this.source, live ? this.source.rows : this.source.first);
    for (const event of live ? [] : this.#events) {
      this.trigger.add(event);
    }
    this.tap = null;
    this.#tapPending = false;
    this.source.keepOnly(new Set([...this.channels, this.trigger.channel, this.#spectrumOf]));
    this.#then(() => {});
  }

  #catchTap() {
    this.#choose("traces");
    this.view.before = 0.2;
    for (const id of ["contact_y", "vibration_y"]) {
      if (!this.channels.includes(id)) {
        this.#toggleTrace(id, true);
      }
    }
    this.#restart(() => {
      this.trigger.source = "contact";
      this.acquisition.mode = "normal";
      this.view.run();
      this.view.setWidth(0.1);
    });
  }

  #pan(share) {
    if (this.source.rows === 0) {
      return;
    }
    this.view.pan(share, this.source.oldest, this.source.newest);
    this.acquisition.state = "held";
  }

  #toggleTraces() {
    const opened = this.panel.root.hidden;
    this.panel.show(this.channels, this.plot.scales);
    this.panel.root.hidden = !opened;
    this.#changed();
    (opened
      ? this.panel.root.querySelector("input")
      : this.controls.bar.querySelector("[aria-controls=scope-traces]")
    ).focus();
  }

  #toggleTrace(id, on) {
    const chosen = new Set(this.channels);
    chosen[on ? "add" : "delete"](id);
    this.channels = CHANNELS.map((channel) => channel.id).filter((each) => chosen.has(each));
    this.#configure();
  }

  #setScale(id, range) {
    if (range === null) {
      this.plot.scales[id].automatic = true;
    } else {
      this.plot.scales[id].set(...range);
    }
  }

  #toggleCursors() {
    this.cursors.show(!this.cursors.shown);
    this.legend.configure(this.channels, this.cursors.shown);
    this.#then(() => {});
  }

  #setSpectrum(id) {
    this.#spectrumOf = id;
    this.spectrumChoice.value = id;
  }

  #choose(id) {
    this.shown = id;
    this.stage.hidden = id !== "traces";
    this.spectrumPane.hidden = id !== "spectrum";
    this.latenessPane.hidden = id !== "lateness";
    this.legendHost.hidden = id !== "traces";
    this.message.textContent = "";
    this.spectrum.restart();
    this.#configure();
  }

  // ---- Telemetry --------------------------------------------------------------------------------------------------

  #listen() {
    const { app } = this;
    this.#attend(app.samples);
    app.link.addEventListener("event", ({ detail }) => this.#event(detail));
    app.model.addEventListener("status", () => {
      if (this.shown === "lateness") {
        this.histogram.draw(this.#lateness);
      }
    });
    app.view.addEventListener("playback", () => this.#play(app.playback.active ? app.playback.store : this.live));
    this.cursors.addEventListener("move", () => this.#then(() => {}));
    onTheme(() => this.#configure());
    new ResizeObserver(() => this.#configure()).observe(this.body);
    pointerGestures(this.stage, this.plot, this.view, this.actions);
    shortcuts(this.stage, this.actions);
  }

  get #lateness() {
    return this.app.model.status.histograms?.lateness_ns ?? null;
  }

  #event(event) {
    if (this.source.store !== this.live) {
      return; // current events are not those of the recording
    }
    this.#events.push(event);
    if (this.#events.length > KEPT_EVENTS) {
      this.#events.shift();
    }
    this.trigger.add(event);
  }

  #attend(store) {
    store.addEventListener("added", () => store === this.source.store && this.#ask());
    store.addEventListener("restart", () => store === this.source.store && this.#begin());
  }

  // All rows were replaced: the daemon was restarted, or a recording was opened, closed or moved to another time.
  #begin() {
    this.source.begin();
    this.#events = this.source.store === this.live ? [] : [...this.app.playback.facts.events];
    this.#restart(() => {});
  }

  // Shows the samples of a store: the current ones, or those of a recording (playback.js).
  #play(store) {
    if (store !== this.source.store) {
      this.source = new Source(store);
      if (store !== this.live) {
        this.#attend(store);
      }
      this.#begin();
    }
    if (store !== this.live) {
      this.app.playback.spanS = Math.max(MIN_PLAYBACK_S, this.view.widthS);
    }
    this.#changed();
  }

  // Returns the conditions under which a tap was rendered.
  get #world() {
    const { model, playback } = this.app;
    if (this.source.store !== this.live) {
      return { scene: playback.scene, materials: playback.materials, device: null, undisplayable: [] };
    }
    const { scene, materials, config, status } = model;
    return { scene, materials, device: config.device, undisplayable: status.undisplayable };
  }

  // ---- Frames -----------------------------------------------------------------------------------------------------

  #ask() {
    if (!this.#wanted) {
      this.#wanted = true;
      requestAnimationFrame(() => this.#frame());
    }
  }

  #frame() {
    this.#wanted = false;
    const begun = performance.now();
    const { source, view, acquisition } = this;
    source.update();
    if (source.rows === 0) {
      this.state.textContent = "No samples came yet.";
      return;
    }
    const state = acquisition.state;
    if (acquisition.update(source)) {
      this.#dirty = true; // the picture changed
      this.tap = null;
      this.#tapPending = acquisition.shown.event?.event === "contact";
    }
    if (state !== acquisition.state && acquisition.state === "held") {
      this.#changed(); // a single picture was taken
    }
    if (this.#tapPending) {
      this.tap = measureTap(source, acquisition.shown, this.#world, this.#events);
      this.#tapPending = this.tap === null;
      this.#dirty = true;
    }
    const moves = acquisition.state === "rolling" || acquisition.state === "waiting" || acquisition.state === "filling";
    const moved = moves || this.#dirty || state !== acquisition.state;
    this.#dirty = false;
    if (this.shown === "traces" && moved) {
      this.#draw(moves);
    } else if (this.shown === "spectrum") {
      this.#stepSpectrum(moved);
    }
    if (moved && begun - this.#textAt > TEXT_INTERVAL_MS) {
      this.#texts(begun);
    } else if (moved && !moves) {
      setTimeout(() => this.#texts(performance.now()), TEXT_INTERVAL_MS);
    }
    if (moved) {
      this.timing.add(performance.now() - begun);
    }
  }

  #draw(moves) {
    const { trigger } = this;
    const level = trigger.source === "level" ? { channel: trigger.channel, value: trigger.level } : null;
    const curves = (this.tap?.curves ?? []).filter(({ channel }) => this.channels.includes(channel));
    this.plot.draw(this.source, this.view, curves, level, !moves);
    this.cursors.place(this.source);
    if (this.source.store === this.live) {
      this.app.timing.drew(this.source.rows - 1);
    }
  }

  #stepSpectrum(moved) {
    const [left, right] = this.stretch;
    if (this.spectrum.step(this.source, this.#spectrumOf, left, right, this.view.trigger, moved)) {
      this.#ask();
    }
  }

  // The range of spectrum and files: between the cursors, or the window.
  get stretch() {
    return this.cursors.shown ? this.cursors.stretch : [this.view.left, this.view.right];
  }

  #texts(now) {
    this.#textAt = now;
    const text = this.#stateText();
    if (this.state.textContent !== text) {
      this.state.textContent = text;
    }
    if (this.shown === "traces") {
      this.legend.update(this.cursors, this.source);
      this.#say("traces", this.tap?.sentence ?? "");
    }
  }

  #say(view, text) {
    if (this.shown === view && this.message.textContent !== text) {
      this.message.textContent = text;
    }
  }

  #stateText() {
    const { state, shown, mode } = this.acquisition;
    const what = { puncture: "rupture", level: "pass of the level" }[this.trigger.source] ?? this.trigger.source;
    const where = shown?.event?.object ? `: ${shown.event.object}` : "";
    const caught = shown === null ? "" : ` Caught a ${what}${where}.`;
    const says = {
      rolling: ` Runs: the newest ${duration(this.view.widthS)}.`,
      waiting: ` Waits for a ${what}.`,
      held: ` Held.${caught}`,
    }[state];
    const next = mode === "single" ? "" : ` The next ${what} replaces the picture.`;
    return `${this.source.store === this.live ? "" : "Recording."}${says ?? caught + next}`.trim();
  }
}

export function mount(app, element) {
  app.scope = new Scope(app, element);
}
