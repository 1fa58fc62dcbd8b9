// The tab of the materials: a list, all parameters of the selected material, warnings about its use in the scene, and its
// two states A and B. Changes take effect at once.
import { button, make } from "./dom.js";
import { Compare, compareCard } from "./editor/compare.js";
import { Editor } from "./editor/editor.js";
import { Form } from "./editor/form.js";
import { difference, equal, inverse } from "./editor/merge_patch.js";
import { PickList } from "./editor/pick_list.js";
import { freeName } from "./editor/placement.js";
import { RenameForm } from "./editor/rename_form.js";
import { tryCard } from "./editor/try_card.js";
import { Warnings, objectsOf, usedMaterials } from "./editor/warnings.js";
import { notice, undoButtons } from "./undo.js";

export async function mount(app, element) {
  const [schemas, shipped] = await Promise.all(["web.schema", "web.shipped_materials"].map((method) => app.link.call(method)));
  app.editorSchema = schemas;
  app.warnings = new Warnings(app);
  app.materialNames = () => sorted(app);
  app.materials = new MaterialsPanel(app, element, schemas, shipped.materials);
}

// Names of all materials: those of the scene first, both groups in alphabetical order.
function sorted(app) {
  const used = usedMaterials(app.model.scene);
  const names = Object.keys(app.model.materials);
  const group = (inScene) => names.filter((name) => used.has(name) === inScene).sort((a, b) => a.localeCompare(b));
  return [...group(true), ...group(false)];
}

// Units of the schema's keys, by key.
export function unitsOf(schemas) {
  const entries = Object.values(schemas.$defs).flatMap(({ properties }) => Object.entries(properties));
  return Object.fromEntries(entries.filter(([, { unit }]) => unit).map(([key, { unit }]) => [key, unit]));
}

class MaterialsPanel {
  name = null; // name of the material that is shown
  #app;
  #element;
  #schemas;
  #shipped;
  #form = null;
  #parts = {};

  // `schemas`: the answer of web.schema; `shipped`: materials of the library, by name.
  constructor(app, element, schemas, shipped) {
    this.#app = app;
    this.#element = element;
    this.#schemas = schemas;
    this.#shipped = shipped;
    this.#draw();
    app.model.addEventListener("materials", () => this.#follow());
    app.model.addEventListener("scene", () => this.#follow());
    app.warnings.addEventListener("changed", () => this.#follow());
    app.view.addEventListener("material", ({ detail }) => this.show(detail.name));
    this.show(sorted(app)[0]);
  }

  // Shows a material; the first one if the name is null or unknown.
  show(name) {
    const { model } = this.#app;
    this.name = name in model.materials ? name : (sorted(this.#app)[0] ?? null);
    this.#parts.rename.close();
    this.#parts.compare.show(this.name);
    this.#parts.tryCard.show(this.name);
    const editor = new Editor(this.#app, "materials", this.name);
    this.#form = new Form(editor, this.#schemas, "Material");
    this.#parts.form.replaceChildren(this.#form.element);
    this.#follow();
  }

  // Escape clears the search and shows all materials; if there is nothing to clear, it stops the forces.
  #searchKey(event) {
    if (event.key === "Escape" && event.target.value !== "") {
      event.preventDefault();
      event.target.value = "";
      this.#list();
    }
  }

  #draw() {
    const app = this.#app;
    const parts = this.#parts;
    const search = { input: () => this.#list(), keydown: (event) => this.#searchKey(event) };
    parts.search = make("input", { type: "search", placeholder: "Search", "aria-label": "Search materials", on: search });
    parts.list = new PickList("Materials", "material", (name) => this.show(name));
    parts.title = make("h2", { text: "" });
    parts.origin = make("span", { class: "pill plain" });
    parts.remove = button("Delete", "small danger", () => this.#delete());
    parts.reset = button("Reset", "small", () => this.#reset(), { title: "As it is shipped" });
    parts.renameButton = button("Rename", "small", () => this.#parts.rename.open(this.name));
    parts.stability = make("p", { class: "stability", role: "status" });
    parts.warnings = make("div", { class: "warning-list" });
    parts.problem = make("p", { class: "error-line", role: "alert" });
    parts.rename = new RenameForm((name) => this.#rename(name));
    parts.form = make("div", {});
    const compare = new Compare(app);
    app.compare = compare;
    parts.compare = compareCard(app, compare, unitsOf(this.#schemas));
    parts.tryCard = tryCard(app);
    this.#element.replaceChildren(
      make("div", { class: "toolbar" }, parts.search, make("span", { class: "spacer" }), ...undoButtons(app)),
      parts.list.element,
      make(
        "div",
        { class: "editor-head" },
        make("div", { class: "row" }, parts.title, parts.origin),
        make("div", { class: "row" }, button("Copy", "small", () => this.#copy()), parts.renameButton, parts.reset, parts.remove),
        parts.rename.element,
        parts.problem,
      ),
      parts.tryCard.element,
      parts.compare.element,
      make("section", { class: "card", "aria-label": "Parameters" }, parts.stability, parts.warnings, parts.form),
    );
  }

  #follow() {
    const { model, warnings } = this.#app;
    if (!(this.name in model.materials)) {
      this.show(null);
      return;
    }
    this.#list();
    const { parts, shipped } = { parts: this.#parts, shipped: this.#shipped[this.name] };
    parts.title.textContent = this.name;
    const changed = shipped !== undefined && !equal(model.materials[this.name], shipped);
    parts.origin.textContent = shipped === undefined ? "own" : changed ? "shipped, changed" : "shipped";
    parts.reset.hidden = shipped === undefined;
    parts.reset.disabled = !changed;
    parts.remove.hidden = parts.renameButton.hidden = shipped !== undefined;
    this.#form.follow();
    this.#showStability(warnings.stabilityOf(this.name));
    const unplaced = warnings.of("materials").filter(({ path }) => path[0] === this.name && !this.#form.fieldAt(path.slice(1)));
    const text = JSON.stringify(unplaced);
    if (parts.warnings.dataset.shown !== text) {
      parts.warnings.dataset.shown = text;
      parts.warnings.replaceChildren(...unplaced.map((each) => make("p", { class: "warning-line", text: each.text })));
    }
  }

  // Placed next to the stiffness, which it concerns.
  #showStability({ kind, text }) {
    const { stability } = this.#parts;
    const field = this.#form.fieldAt(["stiffness_n_per_m"]);
    if (field !== null && stability.parentElement !== field) {
      field.append(stability);
    }
    const word = { ok: "Stable in any hand", warn: "Not proved for every hand", plain: "" }[kind];
    const key = `${kind}${text}`;
    if (stability.dataset.shown !== key) {
      stability.dataset.shown = key;
      stability.replaceChildren(...(word ? [make("span", { class: `pill ${kind}`, text: word }), " "] : []), text);
    }
  }

  #list() {
    const { list, search } = this.#parts;
    const wanted = search.value.trim().toLowerCase();
    const used = usedMaterials(this.#app.model.scene);
    const names = sorted(this.#app).filter((name) => name.toLowerCase().includes(wanted));
    list.show(names.map((name) => [name, used.has(name) ? "in the scene" : ""]), this.name, "No material of this name.");
  }

  #attempt(label, forward, backward) {
    return this.#app.undo.attempt(this.#parts.problem, label, forward, backward);
  }

  async #copy() {
    const { model } = this.#app;
    const name = freeName(this.name, Object.keys(model.materials));
    if (await this.#attempt(`new material ${name}`, { materials: { [name]: model.materials[this.name] } }, { materials: { [name]: null } })) {
      this.show(name);
      this.#parts.rename.open(this.name);
    }
  }

  async #delete() {
    const { model, view } = this.#app;
    const name = this.name;
    const users = objectsOf(model.scene, name);
    if (users.length) {
      this.#parts.problem.textContent = `${name} cannot be deleted: it is the material of ${users.join(", ")}. Give ${users.length === 1 ? "it" : "them"} another material first.`;
      return;
    }
    if (await this.#attempt(`delete ${name}`, { materials: { [name]: null } }, { materials: { [name]: model.materials[name] } })) {
      view.dispatchEvent(notice(`${name} is deleted; undo brings it back`, "info"));
    }
  }

  async #reset() {
    const now = this.#app.model.materials[this.name];
    const forward = difference(now, this.#shipped[this.name]);
    await this.#attempt(`reset ${this.name}`, { materials: { [this.name]: forward } }, { materials: { [this.name]: inverse(now, forward) } });
  }

  // Adds the new name, changes the objects that use the old one, and removes the old one.
  async #rename(name) {
    const { model } = this.#app;
    const old = this.name;
    if (name === old || name === "") {
      this.#parts.rename.close();
      return;
    }
    if (name in model.materials) {
      this.#parts.problem.textContent = `A material ${name} already exists.`;
      return;
    }
    const [to, from] = [{}, {}];
    for (const id of objectsOf(model.scene, old)) {
      const object = model.scene.objects[id];
      to[id] = renamedIn(object, old, name);
      from[id] = inverse(object, to[id]);
    }
    const material = model.materials[old];
    const forward = { materials: { [name]: material, [old]: null }, objects: to };
    const backward = { materials: { [old]: material, [name]: null }, objects: from };
    if (await this.#attempt(`rename ${old} to ${name}`, forward, backward)) {
      this.show(name);
    }
  }
}

// Returns the patch that replaces one material of an object by another.
function renamedIn(object, old, name) {
  const patch = object.material === old ? { material: name } : {};
  if ((object.patches ?? []).some((each) => each.material === old)) {
    patch.patches = object.patches.map((each) => (each.material === old ? { ...each, material: name } : each));
  }
  return patch;
}
