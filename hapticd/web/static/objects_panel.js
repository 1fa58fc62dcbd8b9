// The tab of the objects: a list, all parameters of the selected object, new objects, and what of the scene is displayed.
// The selected object is that of the scene view.
import { button, make } from "./dom.js";
import { Editor } from "./editor/editor.js";
import { Form } from "./editor/form.js";
import { PickList } from "./editor/pick_list.js";
import { duplicate, freeName, newObject } from "./editor/placement.js";
import { patchStrip } from "./editor/patch_strip.js";
import { RenameForm } from "./editor/rename_form.js";
import { KINDS } from "./editor/words.js";
import { notice, undoButtons } from "./undo.js";

const DEFAULT_REACH_M = 0.075; // reach of the hand if the configuration is not known

export function mount(app, element) {
  if (app.materials === undefined) {
    throw new Error("it needs the materials, which failed");
  }
  app.objects = new ObjectsPanel(app, element, app.editorSchema);
}

class ObjectsPanel {
  id = null; // id of the object that is shown
  #app;
  #awaited = null; // id of an object made here, which is selected as soon as the model has it
  #schemas;
  #form = null;
  #kind = null;
  #parts = {};
  #scene;

  constructor(app, element, schemas) {
    this.#app = app;
    this.#schemas = schemas;
    this.#draw(element);
    app.model.addEventListener("scene", () => this.#follow());
    app.model.addEventListener("materials", () => this.#follow());
    app.warnings.addEventListener("changed", () => this.#follow());
    app.view.addEventListener("select", ({ detail }) => this.#show(detail.id));
    this.#show(Object.keys(app.model.scene.objects)[0] ?? null);
  }

  // Selects an object, here and in the scene view.
  pick(id) {
    this.#app.view.dispatchEvent(new CustomEvent("select", { detail: { id } }));
  }

  #show(id) {
    const object = this.#app.model.scene.objects[id];
    this.id = object === undefined ? null : id;
    this.#awaited = null;
    this.#parts.rename.close();
    this.#parts.problem.textContent = "";
    this.#form = null;
    this.#follow();
  }

  #draw(element) {
    const app = this.#app;
    const parts = this.#parts;
    parts.list = new PickList("Objects of the scene", "object", (id) => this.pick(id));
    parts.list.element.addEventListener("keydown", (event) => {
      if (event.key === "Delete" && this.id !== null) {
        this.#delete();
      }
    });
    parts.add = make("div", { class: "row", role: "group", "aria-label": "Add an object" }, ...Object.entries(KINDS).map(([kind, text]) => button(text, "small", () => this.#add(kind), { "aria-label": `Add ${text.toLowerCase()}` })));
    parts.title = make("h2", { text: "" });
    parts.kind = make("span", { class: "pill plain" });
    parts.problem = make("p", { class: "error-line", role: "alert" });
    parts.rename = new RenameForm((id) => this.#rename(id));
    parts.form = make("div", {});
    parts.material = button("Edit its material", "small", () => this.#editMaterial());
    parts.warnings = make("div", { class: "warning-list" });
    const tools = [
      button("Duplicate", "small", () => this.#duplicate()),
      button("Rename", "small", () => this.#parts.rename.open(this.id)),
      parts.material,
      button("Delete", "small danger", () => this.#delete()),
    ];
    parts.object = make("section", { class: "card", "aria-label": "Object" }, make("div", { class: "row" }, parts.title, parts.kind), make("div", { class: "row editor-tools" }, ...tools), parts.rename.element, parts.problem, parts.warnings, parts.form);
    this.#scene = new Form(new Editor(app, "scene", null), this.#schemas, "Scene", ["objects"]);
    element.replaceChildren(
      make("div", { class: "toolbar" }, make("h2", { text: "Objects" }), make("span", { class: "spacer" }), ...undoButtons(app)),
      parts.list.element,
      make("section", { class: "card", "aria-label": "New object" }, make("h3", { text: "Add" }), parts.add),
      parts.object,
      make("section", { class: "card", "aria-label": "Scene" }, make("h3", { text: "Scene" }), this.#scene.element),
    );
  }


  #follow() {
    const { objects } = this.#app.model.scene;
    if (this.#awaited !== null && this.#awaited in objects) {
      this.pick(this.#awaited);
      return;
    }
    if (this.id !== null && !(this.id in objects)) {
      this.pick(Object.keys(objects)[0] ?? null);
      return;
    }
    this.#list();
    this.#scene.follow();
    const parts = this.#parts;
    parts.object.hidden = this.id === null;
    if (this.id === null) {
      return;
    }
    const object = objects[this.id];
    parts.title.textContent = this.id;
    parts.kind.textContent = KINDS[object.kind].toLowerCase();
    parts.material.hidden = object.material === undefined;
    if (this.#form === null || this.#kind !== object.kind) {
      this.#kind = object.kind;
      const definition = this.#schemas.objects[object.kind].$ref.split("/").pop();
      this.#form = new Form(new Editor(this.#app, "objects", this.id), this.#schemas, definition);
      parts.form.replaceChildren(this.#form.element);
    } else {
      this.#form.follow();
    }
    this.#showStrip(object);
    const unplaced = this.#app.warnings.of("objects").filter(({ path }) => path[0] === this.id && !this.#form.fieldAt(path.slice(1)));
    parts.warnings.replaceChildren(...unplaced.map(({ text }) => make("p", { class: "warning-line", text })));
  }

  // The patches of a wall as a picture, above their table.
  #showStrip(object) {
    const field = this.#form.fieldAt(["patches"]);
    if (field === null) {
      return;
    }
    const key = JSON.stringify([object.patches, object.material]);
    const old = field.querySelector(".patch-strip");
    if (old?.dataset.shown !== key) {
      const strip = patchStrip(object, this.#reach);
      strip.dataset.shown = key;
      old?.remove();
      field.querySelector(".table-holder").before(strip);
    }
  }

  get #reach() {
    return this.#app.model.config.device?.sim?.workspace_m ?? DEFAULT_REACH_M;
  }

  #list() {
    const { list } = this.#parts;
    const { objects } = this.#app.model.scene;
    const note = ({ kind, material }) => [KINDS[kind].toLowerCase(), material].filter(Boolean).join(", ");
    const entries = Object.entries(objects).map(([id, object]) => [id, note(object)]);
    list.show(entries, this.id, "The scene is empty. Add an object below.");
  }

  async #attempt(label, forward, backward) {
    const { problem, object } = this.#parts;
    const made = await this.#app.undo.attempt(problem, label, { objects: forward }, { objects: backward });
    object.hidden &&= made;
    return made;
  }

  // The answer may come before the model has the change: then #follow selects the object, unless another was selected.
  #pickNew(id) {
    if (id in this.#app.model.scene.objects) {
      this.pick(id);
    } else {
      this.#awaited = id;
    }
  }

  #place() {
    const { model } = this.#app;
    return { objects: model.scene.objects, handle: model.state?.position_m ?? [0, 0] };
  }

  async #add(kind) {
    const names = this.#app.materialNames();
    const usual = kind === "membrane" ? "cellophane" : "wood";
    const object = newObject(kind, { ...this.#place(), material: names.includes(usual) ? usual : names[0] });
    await this.#insert(freeName(kind, Object.keys(this.#app.model.scene.objects)), object, "add");
  }

  async #duplicate() {
    const { objects, handle } = this.#place();
    const copy = duplicate(objects[this.id], objects, handle);
    await this.#insert(freeName(this.id, Object.keys(objects)), copy, "duplicate");
  }

  async #insert(id, object, word) {
    if (await this.#attempt(`${word} ${id}`, { [id]: object }, { [id]: null })) {
      this.#pickNew(id);
    }
  }

  async #delete() {
    const id = this.id;
    const ids = Object.keys(this.#app.model.scene.objects);
    const next = ids[ids.indexOf(id) + 1] ?? ids[ids.indexOf(id) - 1] ?? null;
    if (await this.#attempt(`delete ${id}`, { [id]: null }, { [id]: this.#app.model.scene.objects[id] })) {
      this.pick(next);
      this.#app.view.dispatchEvent(notice(`${id} is deleted; undo brings it back`, "info"));
    }
  }

  async #rename(id) {
    const { objects } = this.#app.model.scene;
    const old = this.id;
    if (id === old || id === "") {
      this.#parts.rename.close();
      return;
    }
    if (id in objects) {
      this.#parts.problem.textContent = `An object ${id} already exists.`;
      return;
    }
    if (await this.#attempt(`rename ${old} to ${id}`, { [id]: objects[old], [old]: null }, { [old]: objects[old], [id]: null })) {
      this.#pickNew(id);
    }
  }

  #editMaterial() {
    const name = this.#app.model.scene.objects[this.id].material;
    this.#app.view.dispatchEvent(new CustomEvent("material", { detail: { name } }));
    this.#app.tabs?.show("materials-panel");
  }
}
