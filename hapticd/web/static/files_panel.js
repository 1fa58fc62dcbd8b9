// The panel of files: shipped scenes and materials, YAML files of the user, and the scene as a file.
// hapticd/web/yaml_methods.py checks and writes files. The text of an opened file is kept here: changes are saved into it,
// so that its comments stay.
import { button, fileChooser, make } from "./dom.js";
import { check, options } from "./scope/elements.js";
import { fileName, save } from "./scope/export.js";

const MAX_FILE_BYTES = 1_900_000; // largest file: a message to hapticd web has at most 2 MiB
const HANDLE_INSIDE_CODE = -32011; // an object of the file would hold the handle deep inside
const INSISTING_MS = 10_000; // within this time the same file is opened with force
const plural = (count, word) => `${count} ${word}${count === 1 ? "" : "s"}`;

export function mount(app, panel) {
  new FilesPanel(app, panel).begin(); // shown before the answers have come
}

class FilesPanel {
  #app;
  #opened = null; // {name, text, others}: the file into which changes are saved
  #shipped = null;
  #insisting = null; // {file, until_ms}: the file that is opened with force if it is opened once more until then

  constructor(app, panel) {
    this.#app = app;
    this.#build(panel);
    app.link.addEventListener("open", () => this.#shipped === null && this.begin());
  }

  begin() {
    return this.#during(async () => {
      this.#shipped = await this.#app.link.call("web.yaml_shipped");
      this.#say("");
      this.#list();
    });
  }

  #list() {
    for (const [folder, select] of [
      ["scenes", this.scenes],
      ["materials", this.materials],
    ]) {
      options(
        select,
        this.#shipped[folder].map(({ name }) => [name, name]),
        this.#shipped[folder][0]?.name,
      );
      this.#describe(folder);
    }
  }

  // ---- Elements ---------------------------------------------------------------------------------------------------

  #build(panel) {
    this.scenes = make("select", { id: "shipped-scene", class: "select", on: { change: () => this.#describe("scenes") } });
    this.materials = make("select", {
      id: "shipped-materials",
      class: "select",
      on: { change: () => this.#describe("materials") },
    });
    this.about = { scenes: make("p", { class: "note" }), materials: make("p", { class: "note" }) };
    const chooser = fileChooser("yaml-file", "Open a YAML file", ".yaml,.yml", (file) => this.#chosen(file), {
      "aria-describedby": "files-message",
    });
    this.message = make("p", { id: "files-message", class: "note", role: "status" });
    this.faults = make("div", { id: "files-faults", role: "alert", class: "files-faults" });
    this.parts = {
      scene: check("Scene", true, () => {}, { id: "save-scene" }),
      materials: check("Materials that differ from the shipped ones", true, () => {}, { id: "save-materials" }),
    };
    this.name = make("input", { id: "yaml-name", type: "text", maxlength: "100", spellcheck: "false" });
    this.name.value = "scene.yaml";
    this.into = make("p", { class: "note" });
    this.forget = button("Start a new file", "small", () => this.#forget(), { hidden: true });
    panel.append(
      this.#card("Shipped", [
        this.#shippedRow("scenes", "Scene", this.scenes),
        this.about.scenes,
        this.#shippedRow("materials", "Materials", this.materials),
        this.about.materials,
      ]),
      this.#card("Open", [
        make("p", { class: "note" }, "A YAML file with a scene, materials or both. It replaces the scene at once."),
        make("div", { class: "row" }, ...chooser),
      ]),
      this.message,
      this.faults,
      this.#card("Save", [
        make("div", { class: "stack" }, ...Object.values(this.parts)),
        make("div", { class: "field" }, make("label", { for: "yaml-name" }, "Name of the file"), this.name),
        this.into,
        make("div", { class: "row" }, button("Save as YAML", "primary", () => this.#save(), { id: "yaml-save" }), this.forget),
      ]),
    );
    this.#showInto();
  }

  #card(title, children) {
    return make("section", { class: "card stack" }, make("h3", {}, title), ...children);
  }

  #shippedRow(folder, label, select) {
    const about = { "aria-label": `Open the shipped ${folder}` };
    const open = button("Open", "", () => this.#openShipped(folder, select.value), about);
    return make("div", { class: "row files-row" }, make("label", { for: select.id }, label), select, open);
  }

  #describe(folder) {
    const chosen = (folder === "scenes" ? this.scenes : this.materials).value;
    this.about[folder].textContent = this.#shipped[folder].find(({ name }) => name === chosen)?.shows ?? "";
  }

  #showInto() {
    this.into.textContent =
      this.#opened === null
        ? "A new file."
        : `Changes go into ${this.#opened.name}: its comments, its order and what you did not change stay.`;
    this.forget.hidden = this.#opened === null;
  }

  #forget() {
    this.#opened = null;
    this.#showInto();
    this.name.focus();
  }

  // ---- Results and problems ---------------------------------------------------------------------------------------

  #say(text) {
    this.faults.replaceChildren();
    this.message.textContent = text;
  }

  #fail(error) {
    this.message.textContent = "";
    const list = Array.isArray(error.data) ? error.data : [];
    const lines = list.map(({ line, where, problem }) => {
      const place = [line === null ? null : `line ${line}`, where || null].filter(Boolean).join(", ");
      return make("li", {}, place ? `${place}: ${problem}` : problem);
    });
    this.faults.replaceChildren(
      make("p", { class: "error-line" }, error.message),
      ...(lines.length > 0 ? [make("ul", { class: "error-line" }, ...lines)] : []),
    );
  }

  // Shows the problem of an action that fails.
  async #during(work) {
    try {
      await work();
    } catch (error) {
      this.#fail(error);
    }
  }

  // ---- Open and save ----------------------------------------------------------------------------------------------

  #openShipped(folder, name) {
    return this.#during(async () => {
      const found = await this.#open("web.yaml_open_shipped", { folder, name });
      this.#took(found, found.text);
    });
  }

  #chosen(file) {
    return this.#during(async () => {
      if (file.size > MAX_FILE_BYTES) {
        throw new Error(
          `${file.name} has ${(file.size / 1e6).toFixed(1)} MB; at most ${MAX_FILE_BYTES / 1e6} MB are accepted`,
        );
      }
      const bytes = await file.arrayBuffer();
      let text;
      try {
        text = new TextDecoder("utf-8", { fatal: true, ignoreBOM: true }).decode(bytes);
      } catch {
        throw new Error(`${file.name} is not UTF-8 text`);
      }
      this.#took(await this.#open("web.yaml_open", { name: file.name, text }), text);
    });
  }

  // A file that would hold the handle deep inside an object is refused. If the same file is opened at once again, it is
  // applied all the same.
  async #open(method, params) {
    const file = JSON.stringify([method, params]);
    const force = this.#insisting?.file === file && performance.now() < this.#insisting.until_ms;
    this.#insisting = null;
    try {
      return await this.#app.link.call(method, { ...params, force });
    } catch (error) {
      if (error.code === HANDLE_INSIDE_CODE) {
        this.#insisting = { file, until_ms: performance.now() + INSISTING_MS };
        error.message += "; to apply it all the same, open it once more";
      }
      throw error;
    }
  }

  #took(found, text) {
    this.#opened = { name: found.name, text, others: found.others };
    this.name.value = found.name;
    this.parts.scene.querySelector("input").checked = found.scene;
    this.parts.materials.querySelector("input").checked = found.materials.length > 0 || found.scene;
    const held = [
      found.scene ? `a scene of ${plural(found.objects, "object")}` : null,
      found.materials.length > 0 ? plural(found.materials.length, "material") : null,
    ].filter(Boolean);
    const rest = found.left_out.length > 0 ? ` Its ${found.left_out.join(" and ")} take a restart of the daemon.` : "";
    const warned = found.warnings.map(({ where, problem }) => ` ${where}: ${problem}.`).join("");
    this.#say(`${found.name} was opened: ${held.join(" and ")}.${rest}${warned}`);
    this.#showInto();
  }

  #save() {
    return this.#during(async () => {
      const parts = Object.keys(this.parts).filter((part) => this.parts[part].querySelector("input").checked);
      if (parts.length === 0) {
        throw new Error("Choose what is to be saved: the scene, the materials or both");
      }
      const name = this.#fileName();
      const opened = this.#opened;
      const found = await this.#app.link.call("web.yaml_save", { parts, ...(opened === null ? {} : { opened }) });
      save(new Blob([found.text], { type: "application/yaml" }), name);
      if (opened !== null) {
        this.#opened = { ...opened, name, text: found.text };
        this.#showInto();
      }
      const lost = found.kept ? "" : " Its comments could not be kept.";
      this.#say(`${name} was saved.${lost}`);
    });
  }

  #fileName() {
    const name = this.name.value.trim().replace(/[/\\]/g, "-") || fileName(new Date(), "yaml");
    return /\.ya?ml$/i.test(name) ? name : `${name}.yaml`;
  }
}
