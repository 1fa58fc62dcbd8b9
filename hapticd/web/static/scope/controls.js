// The oscilloscope's controls: trigger, width of the window, traces, views and files. They call `actions` of scope.js;
// `show` sets them to the current state.
import { button, make } from "../dom.js";
import { CHANNELS, CHANNEL } from "./channels.js";
import { check, duration, figure, options } from "./elements.js";
import { SOURCES } from "./trigger.js";
import { WIDTHS_S } from "./view_window.js";

const TRIGGER_MODES = [
  ["auto", "Auto"],
  ["normal", "Normal"],
  ["single", "Single"],
];
const PRETRIGGER_FRACTIONS = [0.1, 0.2, 0.5, 0.8, 0.9];
const VIEW_NAMES = [
  ["traces", "Traces"],
  ["spectrum", "Spectrum"],
  ["lateness", "Lateness"],
];

export class Controls {
  #actions;
  #parts = {};

  constructor(actions) {
    this.#actions = actions;
    this.bar = make(
      "div",
      { class: "toolbar scope-bar", role: "group", "aria-label": "Controls of the oscilloscope" },
      ...this.#bar(),
    );
  }

  #button(name, label, run, { class: kind = "", ...more } = {}) {
    this.#parts[name] = button(label, `small ${kind}`, run, more);
    return this.#parts[name];
  }

  #select(name, label, entries, chosen, run, title = null) {
    const id = `scope-${name}`;
    const select = options(
      make("select", { class: "select", id, on: { change: (event) => run(event.target.value) } }),
      entries,
      chosen,
    );
    this.#parts[name] = select;
    return make("span", { class: "scope-choice", title }, make("label", { for: id }, label), select);
  }

  #bar() {
    const act = this.#actions;
    const views = VIEW_NAMES.map(([id, label]) =>
      this.#button(`view-${id}`, label, () => act.choose(id), { "aria-pressed": "false" }),
    );
    return [
      make("div", { class: "segmented toolbar", role: "group", "aria-label": "View" }, ...views),
      this.#button("hold", "Hold", () => act.toggleHold(), {
        title: "Holds the picture, or runs again (H)",
        class: "scope-hold",
      }),
      this.#button("traces", "Traces…", () => act.toggleTraces(), {
        "aria-expanded": "false",
        "aria-controls": "scope-traces",
      }),
      this.#button("tap", "Catch a tap", () => act.catchTap(), {
        title: "Shows the next contact: 0.1 s wide, one picture for each",
      }),
      make(
        "span",
        { class: "toolbar segmented", role: "group", "aria-label": "Width of the window" },
        this.#button("narrower", "−", () => act.step(-1), { "aria-label": "Narrower window", title: "Narrower (+)" }),
        this.#width(),
        this.#button("wider", "+", () => act.step(1), { "aria-label": "Wider window", title: "Wider (−)" }),
      ),
      this.#button("more", "More", () => this.#toggleMore(), {
        class: "scope-more-button",
        "aria-label": "More controls of the oscilloscope",
        "aria-expanded": "false",
        "aria-controls": "scope-more",
      }),
      this.#more(),
    ];
  }

  // Controls that are used less often: next to the others if there is space, else in a box that the button More opens.
  #more() {
    const act = this.#actions;
    this.more = make(
      "div",
      { id: "scope-more", class: "scope-more", role: "group", "aria-label": "Trigger, cursors and files" },
      this.#select(
        "source",
        "Trigger",
        SOURCES.map(({ id, label }) => [id, label]),
        "off",
        (id) => act.setSource(id),
      ),
      this.#select(
        "mode",
        "Mode",
        TRIGGER_MODES,
        "auto",
        (id) => act.setMode(id),
        "Auto: the newest samples while nothing triggers. Normal: waits for the next one. Single: takes one and holds.",
      ),
      this.#select(
        "before",
        "Trigger at",
        PRETRIGGER_FRACTIONS.map((share) => [String(share), `${100 * share} %`]),
        "0.2",
        (share) => act.setBefore(Number(share)),
        "How far from the left edge the trigger stands",
      ),
      this.#button("cursors", "Cursors", () => act.toggleCursors(), { "aria-pressed": "false" }),
      make("span", { class: "spacer" }),
      this.#button("png", "PNG", () => act.savePng(), {
        "aria-label": "Save the picture as PNG",
        title: "Saves the picture",
      }),
      this.#button("csv", "CSV", () => act.saveCsv(), {
        "aria-label": "Save the samples as CSV",
        title: "Saves every sample of the window",
      }),
      this.#button("large", "Enlarge", () => act.toggleLarge(), { "aria-pressed": "false" }),
      this.#level(),
    );
    this.more.addEventListener("keydown", (event) => {
      if (event.key === "Escape" && this.more.classList.contains("open")) {
        this.#openMore(false);
        this.#parts.more.focus();
      }
    });
    this.more.addEventListener("focusout", ({ relatedTarget: to }) => {
      if (to !== null && to !== this.#parts.more && !this.more.contains(to)) {
        this.#openMore(false); // another control is used
      }
    });
    return this.more;
  }

  #toggleMore() {
    const open = !this.more.classList.contains("open");
    this.#openMore(open);
    (open ? this.#parts.source : this.#parts.more).focus();
  }

  #openMore(open) {
    this.more.classList.toggle("open", open);
    this.#parts.more.setAttribute("aria-expanded", String(open));
  }

  #width() {
    const entries = WIDTHS_S.map((width) => [String(width), duration(width)]);
    this.#parts.width = options(
      make("select", {
        class: "select scope-width",
        "aria-label": "Width of the window",
        on: { change: (event) => this.#actions.setWidth(Number(event.target.value)) },
      }),
      entries,
      "5",
    );
    return this.#parts.width;
  }

  #level() {
    const act = this.#actions;
    const number = (name, label, step) => {
      const id = `scope-level-${name}`;
      const input = make("input", { type: "number", id, step, on: { change: () => act.setLevel(this.#levelSet()) } });
      this.#parts[name] = input;
      this.#parts[`${name}-unit`] = make("span", { class: "unit" });
      return make(
        "span",
        { class: "scope-choice" },
        make("label", { for: id }, label),
        input,
        this.#parts[`${name}-unit`],
      );
    };
    const changed = () => act.setLevel(this.#levelSet());
    this.level = make(
      "div",
      { class: "toolbar scope-level", role: "group", "aria-label": "Level that triggers", hidden: true },
      this.#select(
        "channel",
        "Channel",
        CHANNELS.map(({ id, label }) => [id, label]),
        "force_y",
        changed,
      ),
      this.#select(
        "slope",
        "Edge",
        [
          ["rising", "Rising"],
          ["falling", "Falling"],
        ],
        "rising",
        changed,
      ),
      number("value", "Level", "any"),
      number("hysteresis", "Hysteresis", "any"),
    );
    return this.level;
  }

  // Returns the values of the fields, which are in the axis' unit, in SI units.
  #levelSet() {
    const channel = this.#parts.channel.value;
    const { factor } = CHANNEL[channel];
    return {
      channel,
      rising: this.#parts.slope.value === "rising",
      level: Number(this.#parts.value.value) / factor,
      hysteresis: Math.abs(Number(this.#parts.hysteresis.value)) / factor,
    };
  }

  // `state`: {view, held, source, mode, before, widthS, cursors, large, tracesOpen, trigger}.
  show(state) {
    const parts = this.#parts;
    for (const [id] of VIEW_NAMES) {
      parts[`view-${id}`].setAttribute("aria-pressed", String(state.view === id));
    }
    parts.hold.textContent = state.held ? "Run" : "Hold";
    parts.hold.classList.toggle("primary", state.held);
    parts.source.value = state.source;
    parts.mode.value = state.mode;
    parts.before.value = String(state.before);
    parts.mode.disabled = parts.before.disabled = state.source === "off";
    this.level.hidden = state.source !== "level";
    this.#showWidth(state.widthS);
    parts.cursors.setAttribute("aria-pressed", String(state.cursors));
    parts.large.setAttribute("aria-pressed", String(state.large));
    parts.traces.setAttribute("aria-expanded", String(state.tracesOpen));
    const { factor, unit } = CHANNEL[state.trigger.channel];
    parts.channel.value = state.trigger.channel;
    parts.slope.value = state.trigger.rising ? "rising" : "falling";
    parts.value.value = String(Number((state.trigger.level * factor).toPrecision(6)));
    parts.hysteresis.value = String(Number((state.trigger.hysteresis * factor).toPrecision(6)));
    parts["value-unit"].textContent = parts["hysteresis-unit"].textContent = unit;
  }

  #showWidth(widthS) {
    const { width } = this.#parts;
    const usual = WIDTHS_S.find((each) => Math.abs(each / widthS - 1) < 1e-6);
    const own = width.querySelector("[data-own]");
    if (usual === undefined) {
      const label = duration(widthS);
      const entry = own ?? make("option", { "data-own": true, value: "own" });
      if (entry.textContent !== label) {
        entry.textContent = label;
      }
      if (own === null) {
        width.append(entry);
      }
      width.value = "own";
    } else {
      own?.remove();
      width.value = String(usual);
    }
  }
}

// The panel for the choice of traces and of the vertical scales.
export class TracesPanel {
  #scaleFields = {};

  constructor(quantities, scales, actions) {
    this.actions = actions;
    const rows = quantities.map(({ id, label }) => {
      const boxes = ["x", "y", "magnitude"].map((part) => {
        const channel = `${id}_${part}`;
        const name = part === "magnitude" ? "Magnitude" : part;
        const box = check(name, false, (on) => actions.toggleTrace(channel, on), {
          "data-trace": channel,
          "aria-label": CHANNEL[channel].label,
        });
        box.insertBefore(make("span", { class: `scope-swatch trace-${channel}` }), box.lastChild);
        return box;
      });
      return make(
        "div",
        { class: "scope-trace-row", role: "group", "aria-label": label },
        make("span", {}, label),
        ...boxes,
      );
    });
    const fields = Object.entries(scales).map(([id, { label, unit }]) => this.#scale(id, label, unit));
    const close = button("Close", "small", () => actions.toggleTraces());
    this.root = make(
      "div",
      {
        id: "scope-traces",
        class: "scope-traces card",
        role: "group",
        "aria-label": "Traces and vertical scales",
        hidden: true,
      },
      make("div", {}, make("h3", {}, "Traces"), ...rows),
      make("div", {}, make("h3", {}, "Vertical scales"), ...fields, close),
    );
    this.root.addEventListener("keydown", (event) => {
      if (event.key === "Escape") {
        event.preventDefault(); // otherwise the key would stop the forces
        actions.toggleTraces();
      }
    });
  }

  #scale(id, label, unit) {
    const changed = () => this.#changed(id);
    const number = (which) =>
      make("input", { type: "number", step: "any", "aria-label": `${label} ${which}, ${unit}`, on: { change: changed } });
    const [low, high] = [number("from"), number("to")];
    const automatic = check("Automatic", true, changed, { "aria-label": `${label}: automatic scale` });
    const error = make("p", { class: "error-line", role: "alert" });
    this.#scaleFields[id] = { low, high, automatic: automatic.firstChild, error };
    return make(
      "div",
      { class: "scope-trace-row", role: "group", "aria-label": `${label} scale` },
      make("span", {}, `${label}, ${unit}`),
      automatic,
      make("span", { class: "entry" }, low, "to", high),
      error,
    );
  }

  #changed(id) {
    const { low, high, automatic, error } = this.#scaleFields[id];
    low.disabled = high.disabled = automatic.checked;
    const [from, to] = [Number(low.value), Number(high.value)];
    const good = automatic.checked || (low.value !== "" && high.value !== "" && from < to);
    error.textContent = good ? "" : "The first number must be less than the second.";
    if (good) {
      this.actions.setScale(id, automatic.checked ? null : [from, to]);
    }
  }

  // Sets the fields to the drawn traces and scales.
  show(ids, scales) {
    for (const box of this.root.querySelectorAll("[data-trace]")) {
      box.checked = ids.includes(box.dataset.trace);
    }
    for (const [id, { low, high, automatic }] of Object.entries(this.#scaleFields)) {
      automatic.checked = scales[id].automatic;
      low.disabled = high.disabled = scales[id].automatic;
      if (scales[id].automatic) {
        low.value = figure(scales[id].low, 4).replace("−", "-");
        high.value = figure(scales[id].high, 4).replace("−", "-");
      }
    }
  }
}
