// The panel of recordings: hapticd web records into a folder; the panel lists, downloads, deletes and plays its files.
// recording_player.js plays a recording.
import { button, fileChooser, make } from "./dom.js";
import { RecordingPlayer } from "./recording_player.js";
import { check } from "./scope/elements.js";

const BYTE_UNITS = [
  [1e9, "GB"],
  [1e6, "MB"],
  [1e3, "kB"],
];
const MAX_UPLOAD_BYTES = 512 * 2 ** 20; // as in hapticd/web/uploads.py

export function bytes(count) {
  const [size, unit] = BYTE_UNITS.find(([least]) => count >= least) ?? [1, "bytes"];
  return `${size === 1 ? count : (count / size).toPrecision(3)} ${unit}`;
}

export function clock(seconds) {
  const total = Math.floor(seconds);
  const two = (value) => String(value).padStart(2, "0");
  const minutes = `${two(Math.floor(total / 60) % 60)}:${two(total % 60)}`;
  return total < 3600 ? minutes : `${Math.floor(total / 3600)}:${minutes}`;
}

export function mount(app, panel) {
  new RecordingsPanel(app, panel).begin(); // shown before the answers have come
}

class RecordingsPanel {
  #app;
  #state = { recording: false };
  #list = [];

  constructor(app, panel) {
    this.#app = app;
    this.player = new RecordingPlayer(app, (error) => this.#fail(error));
    this.#build(panel);
    app.link.addEventListener("web", ({ detail }) => {
      if (detail.recording !== undefined) {
        this.#progress(detail.recording);
      }
    });
    app.link.addEventListener("open", () => this.begin());
    app.view.addEventListener("tab", ({ detail }) => {
      if (detail.panel === panel.id) {
        this.#during(() => this.#refresh());
      }
    });
  }

  begin() {
    return this.#during(async () => {
      this.#progress(await this.#app.link.call("web.recording"));
      await this.#refresh();
    });
  }

  // ---- Elements ---------------------------------------------------------------------------------------------------

  #build(panel) {
    this.message = make("p", { class: "note", role: "status" });
    this.error = make("p", { class: "error-line", role: "alert" });
    panel.append(this.#recordCard(), this.message, this.error, this.player.element, this.#listCard());
    this.#propose();
  }

  #recordCard() {
    this.name = make("input", { id: "recording-name", type: "text", maxlength: "64", spellcheck: "false" });
    this.notes = make("textarea", { id: "recording-notes", rows: "2", maxlength: "4000" });
    this.limited = check("Stop automatically after", false, (on) => (this.seconds.disabled = !on), {
      id: "recording-limited",
    });
    const label = "Stop automatically after, s";
    const range = { type: "number", min: "1", max: "86400", step: "1", value: "60" };
    this.seconds = make("input", { id: "recording-seconds", "aria-label": label, disabled: true, ...range });
    this.start = button("Record", "primary", () => this.#start(), { id: "recording-start" });
    this.stop = button("Stop recording", "danger", () => this.#stop(), { id: "recording-stop", hidden: true });
    this.state = make("p", { id: "recording-state", class: "number recording-state" });
    return make(
      "section",
      { class: "card stack" },
      make("h3", {}, "Record"),
      make("div", { class: "field" }, make("label", { for: "recording-name" }, "Name"), this.name),
      make("label", { for: "recording-notes" }, "Notes, kept in the file"),
      this.notes,
      make(
        "div",
        { class: "row" },
        this.limited,
        make("span", { class: "entry" }, this.seconds, make("span", { class: "unit" }, "s")),
      ),
      make("div", { class: "row" }, this.start, this.stop),
      this.state,
      make("p", { class: "note" }, "A recording continues when this page is closed. Any page can stop it."),
    );
  }

  #listCard() {
    const titles = ["Name", "Made", "Size"].map((title) => make("th", { scope: "col" }, title));
    this.rows = make("tbody");
    this.table = make(
      "table",
      { class: "table recordings-table" },
      make("caption", { class: "visually-hidden" }, "Recordings"),
      make("thead", {}, make("tr", {}, ...titles)),
      this.rows,
    );
    this.empty = make("p", { class: "empty" }, "Nothing was recorded yet.");
    this.folder = make("p", { class: "note" });
    const chooser = fileChooser("recording-file", "Open a file of yours", ".npz", (file) => this.#chosen(file));
    return make(
      "section",
      { class: "card stack" },
      make("h3", {}, "Recordings"),
      this.table,
      this.empty,
      this.folder,
      make("div", { class: "row" }, ...chooser),
    );
  }

  // Returns an unused name: the day and a number.
  #propose() {
    const now = new Date();
    const day = [now.getFullYear(), now.getMonth() + 1, now.getDate()]
      .map((part) => String(part).padStart(2, "0"))
      .join("-");
    const taken = new Set(this.#list.map(({ name }) => name.replace(/\.\w+$/, "")));
    let number = 1;
    while (taken.has(`${day} ${number}`)) {
      number++;
    }
    this.name.value = `${day} ${number}`;
  }

  #fail(error) {
    this.message.textContent = "";
    this.error.textContent = error.message;
  }

  async #during(work) {
    this.error.textContent = "";
    try {
      await work();
    } catch (error) {
      this.#fail(error);
    }
  }

  // ---- Record -----------------------------------------------------------------------------------------------------

  #start() {
    return this.#during(async () => {
      this.message.textContent = "";
      this.start.disabled = true;
      try {
        const text = this.notes.value.trim();
        const state = await this.#app.link.call("web.record_start", {
          name: `${this.name.value.trim()}.npz`,
          notes: text === "" ? {} : { note: text },
          for_s: this.limited.querySelector("input").checked ? Number(this.seconds.value) : null,
        });
        this.#progress(state);
        this.stop.focus();
      } finally {
        this.start.disabled = false;
      }
    });
  }

  #stop() {
    return this.#during(async () => {
      this.#progress(await this.#app.link.call("web.record_stop"));
      this.start.focus();
    });
  }

  // `state`: as in hapticd/web/recorder.py.
  #progress(state) {
    const ended = this.#state.recording && !state.recording;
    this.#state = state;
    this.start.hidden = state.recording;
    this.stop.hidden = !state.recording;
    if (state.recording) {
      const perSecond = state.recorded_s > 0 ? state.bytes / state.recorded_s : 0;
      const room =
        perSecond > 0 && state.free_bytes !== null
          ? `; the disk has room for ${clock(state.free_bytes / perSecond)}`
          : "";
      const of = state.for_s === null ? "" : ` of ${clock(state.for_s)}`;
      const ticks = `${state.ticks.toLocaleString("en")} ticks`;
      this.state.textContent = `${state.name}: ${clock(state.recorded_s)}${of}, ${ticks}, ${bytes(state.bytes)}${room}`;
    } else {
      this.state.textContent = "";
    }
    if (ended) {
      this.#ended(state.last);
    }
  }

  #ended(last) {
    if (last?.error) {
      this.#fail({ message: last.error });
    } else if (last) {
      const lost =
        last.lost > 0 ? `; ${last.lost.toLocaleString("en")} samples were lost on the way` : "; nothing was lost";
      const early = last.ended_because === null ? "" : ` It ended early: ${last.ended_because}.`;
      const held = `${last.ticks.toLocaleString("en")} ticks in ${last.duration_s.toFixed(3)} s`;
      const warning = last.warning ? ` ${last.warning}.` : "";
      this.message.textContent = `${last.name}: ${held}${lost}.${early}${warning}`;
    }
    this.#during(() => this.#refresh()).then(() => this.#propose());
  }

  // ---- The list ---------------------------------------------------------------------------------------------------

  async #refresh() {
    const { recordings, folder, free_bytes: free } = await this.#app.link.call("web.recordings");
    this.#list = recordings;
    this.table.hidden = recordings.length === 0;
    this.empty.hidden = recordings.length > 0;
    this.folder.textContent = `Kept in ${folder}${free === null ? "" : `, which has room for ${bytes(free)}`}.`;
    this.rows.replaceChildren(...recordings.flatMap((each) => this.#rowsOf(each)));
    if (recordings.some(({ name }) => name.replace(/\.\w+$/, "") === this.name.value)) {
      this.#propose();
    }
  }

  #rowsOf({ name, size, modified_ns: modified }) {
    const made = new Date(modified / 1e6);
    const href = `/recordings/${encodeURIComponent(name)}`;
    const labelled = (word) => ({ "aria-label": `${word} ${name}` });
    const actions = make(
      "div",
      { class: "row" },
      button("Open", "small", () => this.#open({ name }), labelled("Open")),
      make("a", { class: "button small", href, download: name, ...labelled("Download") }, "Download"),
      button("Delete", "small danger", () => this.#askToDelete(name, actions), labelled("Delete")),
    );
    return [
      make(
        "tr",
        { class: "recording" },
        make("th", { scope: "row" }, name),
        make(
          "td",
          {},
          make(
            "time",
            { datetime: made.toISOString() },
            made.toLocaleString("en-GB", { dateStyle: "short", timeStyle: "short" }),
          ),
        ),
        make("td", { class: "number" }, bytes(size)),
      ),
      make("tr", { class: "recording-actions" }, make("td", { colspan: "3" }, actions)),
    ];
  }

  #askToDelete(name, actions) {
    const before = [...actions.children];
    const keep = button("Keep it", "small", () => {
      actions.replaceChildren(...before);
      before.at(-1).focus();
    });
    const sure = button("Delete for good", "small danger", () => this.#delete(name));
    actions.replaceChildren(make("span", {}, `Delete ${name}?`), sure, keep);
    keep.focus();
  }

  #delete(name) {
    return this.#during(async () => {
      await this.#app.link.call("web.recording_delete", { name });
      await this.#refresh();
      this.message.textContent = `${name} was deleted.`;
      this.name.focus();
    });
  }

  // ---- Play -------------------------------------------------------------------------------------------------------

  #open(params) {
    return this.#during(async () => {
      this.message.textContent = "The recording is being read.";
      const facts = await this.#app.playback.open(params);
      const held = `${clock(facts.duration_s)}, ${facts.rows.toLocaleString("en")} samples`;
      this.message.textContent = `${facts.name} is shown in scene and oscilloscope: ${held}.`;
      this.player.focus();
    });
  }

  #chosen(file) {
    return this.#during(async () => {
      if (file.size > MAX_UPLOAD_BYTES) {
        throw new Error(`${file.name} has ${bytes(file.size)}; at most ${bytes(MAX_UPLOAD_BYTES)} are accepted`);
      }
      this.message.textContent = `${file.name} is being sent.`;
      const answer = await fetch(`/uploads?name=${encodeURIComponent(file.name)}`, { method: "POST", body: file });
      const found = await answer.json();
      if (found.error !== undefined) {
        throw new Error(found.error);
      }
      await this.#open({ upload: found.upload, name: file.name });
    });
  }
}
