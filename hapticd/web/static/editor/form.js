// A form for a definition of the schema: a field for each key of a value, and a button for each block that may be added.
//
// A form is built from the value. If the daemon's value changes and has the same keys, the fields follow it; if a block was
// added or removed, the form is built again.
import { CHOICES, chosen, displayed, pairOf, switchTo } from "./choices.js";
import { button, fill, make, newId } from "../dom.js";
import { directionField, enumField, materialField, numberField, pairField, switchField, vectorField } from "./fields.js";
import { isMap } from "./merge_patch.js";
import { originBlock } from "./origin.js";
import { amplitudes, frequencyTable, listField, modeTable, patches, tableField } from "./tables.js";
import { BLOCKS, MODEL, TEXTURES, TEXTURE_STARTS, labelOf } from "./words.js";

const TABLES = { amplitudes, mode_table: modeTable, frequency_table: frequencyTable };
const LISTS = { coefficients: false, samples: true };
const COMPONENTS = { size_m: ["width", "height"] };

// Returns the keys and kinds of a value, which determine the fields of its form.
function shapeOf(value) {
  if (!isMap(value)) {
    return Array.isArray(value) && value.some(isMap) && "coefficients" in value[0] ? value.map(shapeOf) : 0;
  }
  return Object.keys(value)
    .sort()
    .map((key) => [key, ["kind", "display", "direction"].includes(key) && typeof value[key] === "string" ? value[key] : shapeOf(value[key])]);
}

export class Form {
  #fields = [];
  #shape = null;
  #model = 0; // index of the shown model of recorded noise

  // `schemas`: the answer of `web.schema`; `definition`: a name of its $defs; `leaveOut`: keys that are shown elsewhere.
  constructor(editor, schemas, definition, leaveOut = []) {
    this.editor = editor;
    this.schemas = schemas;
    this.definition = definition;
    this.leaveOut = leaveOut;
    this.element = make("div", { class: "form" });
    this.follow();
  }

  follow() {
    const shape = JSON.stringify([shapeOf(this.editor.value), this.#model]);
    if (shape === this.#shape) {
      this.#fields.forEach((field) => field.follow());
      return;
    }
    this.#shape = shape;
    const focused = this.element.contains(document.activeElement) ? document.activeElement : null;
    const place = focused?.closest("[data-path]")?.dataset.path;
    const tag = focused?.tagName;
    this.#fields = [];
    this.element.replaceChildren(...this.#members(this.definition, []));
    if (place !== undefined) {
      const found = this.element.querySelector(`[data-path="${CSS.escape(place)}"]`);
      (found?.querySelector(tag.toLowerCase()) ?? found?.querySelector("input, select, button"))?.focus();
    }
  }

  // Returns the field that shows a path or a part of it.
  fieldAt(path) {
    return this.element.querySelector(`[data-path="${CSS.escape(path.join("."))}"]`);
  }

  #resolve(schema) {
    return schema.$ref ? { name: schema.$ref.split("/").pop(), ...this.schemas.$defs[schema.$ref.split("/").pop()], ...schema } : schema;
  }

  // Makes the elements for the members of a definition at a path: fields, then blocks, then buttons to add blocks.
  #members(name, path) {
    const definition = this.schemas.$defs[name];
    const value = this.editor.at(path) ?? {};
    const elements = [];
    const blocks = [];
    const missing = [];
    const done = new Set(path.length ? [] : this.leaveOut);
    const choices = (CHOICES[name] ?? []).filter(({ only }) => only === undefined || only(value));
    const governed = new Map(choices.flatMap((choice) => choice.options.flatMap(({ keys }) => keys.map((key) => [key, choice]))));
    for (const [key, raw] of Object.entries(definition.properties)) {
      const choice = governed.get(key);
      if (choice !== undefined && !done.has(choice)) {
        done.add(choice);
        elements.push(this.#choice(name, path, choice, value));
      }
      if (done.has(key) || "const" in raw) {
        continue;
      }
      const schema = this.#resolve(raw);
      if (this.#isBlock(schema)) {
        (key in value ? blocks : missing).push([key, schema]);
      } else if (key in value) {
        pairOf(key)?.keys.forEach((other) => done.add(other));
        elements.push(this.#field(name, [...path, key], key, schema, definition.properties));
      }
    }
    elements.push(...blocks.map(([key, schema]) => this.#block([...path, key], key, schema)));
    const addable = missing.filter(([key]) => key in BLOCKS && !(key === "second" && "waveform" in value));
    if (addable.length) {
      elements.push(this.#adders(path, addable));
    }
    return elements;
  }

  // Returns whether a value of this schema, a map or one of several kinds of maps, is shown as a block.
  #isBlock(schema) {
    const kind = schema.title;
    return !(kind in TABLES) && (isMap(schema.properties) || schema.oneOf?.[0]?.$ref !== undefined);
  }

  #field(definition, path, key, schema, properties) {
    const spec = { definition, key, path, schema, label: labelOf(definition, key) };
    const field = this.#control(spec, properties);
    this.#fields.push(field);
    return field.element;
  }

  #control(spec, properties) {
    const { editor } = this;
    const { key, schema } = spec;
    const pair = pairOf(key);
    if (pair !== undefined && pair.keys.every((each) => each in properties)) {
      return pairField(editor, spec, pair, properties);
    }
    if (key in TABLES) {
      return tableField(editor, spec, TABLES[key]);
    }
    if (key in LISTS) {
      return listField(editor, spec, LISTS[key]);
    }
    if (key === "patches") {
      return tableField(editor, spec, (list) => patches(list, editor.app.materialNames()));
    }
    if (key === "models") {
      return this.#models(spec);
    }
    if (key === "material") {
      return materialField(editor, spec);
    }
    if (key === "normal") {
      return directionField(editor, spec);
    }
    if (schema.prefixItems) {
      return vectorField(editor, spec, COMPONENTS[key]);
    }
    if (schema.enum) {
      return enumField(editor, { ...spec, also: (value) => this.#needed(spec, value) });
    }
    if (schema.type === "boolean") {
      return switchField(editor, spec);
    }
    return numberField(editor, spec);
  }

  // Returns the changes that must accompany a new value of an enumeration: for the display of grooves, its keys.
  #needed({ definition, path }, value) {
    return definition === "Grooves" ? displayed(this.editor.at(path.slice(0, -1)) ?? {}, value, this.editor.at(["tap"])) : {};
  }

  // Makes a list of the options of a choice; the keys of the option in force follow as fields.
  #choice(definition, path, choice, value) {
    const id = newId("choice");
    const select = make("select", { class: "select", id });
    const current = chosen(choice, value);
    const offered = choice.options.filter((option) => !option.rare || option === current);
    fill(select, offered.map(({ name, label }) => [name, label]), current.name);
    const problem = make("p", { class: "error-line", role: "alert" });
    select.addEventListener("change", async () => {
      const option = choice.options.find(({ name }) => name === select.value);
      const patch = () => this.editor.patch(path, switchTo(choice, option, this.editor.at(path) ?? {}));
      const refused = await this.editor.change(choice.label.toLowerCase(), patch);
      problem.textContent = refused ?? "";
      if (refused !== null) {
        select.value = chosen(choice, this.editor.at(path)).name;
      }
    });
    const place = [...path, `choice-${choice.name}`].join(".");
    return make("div", { class: "field choice", data: { path: place } }, make("label", { for: id, text: choice.label }), make("span", { class: "entry" }, select), problem);
  }

  #block(path, key, schema) {
    const { editor } = this;
    if (key === "provenance") {
      return originBlock(editor, path);
    }
    const label = labelOf(this.definition, key);
    const problem = make("p", { class: "error-line", role: "alert" });
    const heading = make("h3", { text: label });
    const head = make("div", { class: "block-head" }, heading);
    const optional = key in BLOCKS;
    if (optional) {
      head.append(
        button("Remove", "quiet small", async () => (problem.textContent = (await editor.change(label.toLowerCase(), () => editor.patch(path, null))) ?? ""), { "aria-label": `Remove ${label.toLowerCase()}` }),
      );
    }
    const note = make("p", { class: "note", text: schema.description ?? "" });
    const parts = [];
    let name = schema.name;
    if (schema.oneOf) {
      const kind = editor.at([...path, "kind"]);
      name = schema.discriminator.mapping[kind].split("/").pop();
      parts.push(this.#kinds(path, kind));
    }
    parts.push(...this.#members(name, path));
    return make("section", { class: "block", "aria-label": label, data: { path: path.join(".") } }, head, note, problem, ...parts);
  }

  // Makes the choice of the kind of texture.
  #kinds(path, kind) {
    const id = newId("kind");
    const select = make("select", { class: "select", id });
    fill(select, Object.entries(TEXTURES), kind);
    const problem = make("p", { class: "error-line", role: "alert" });
    select.addEventListener("change", async () => {
      const start = TEXTURE_STARTS[select.value]();
      const patch = () => {
        const removed = Object.fromEntries(Object.keys(this.editor.at(path) ?? {}).map((key) => [key, null]));
        return this.editor.patch(path, { ...removed, ...start });
      };
      const refused = await this.editor.change("kind of texture", patch);
      problem.textContent = refused ?? "";
    });
    return make("div", { class: "field", data: { path: [...path, "kind"].join(".") } }, make("label", { for: id, text: "Kind" }), make("span", { class: "entry" }, select), problem);
  }

  #adders(path, missing) {
    const problem = make("p", { class: "error-line", role: "alert" });
    const buttons = missing.map(([key]) => {
      const label = labelOf(this.definition, key);
      return button(`Add ${label.toLowerCase()}`, "small", async () => {
        const patch = () => this.editor.patch([...path, key], BLOCKS[key](this.editor.at(path) ?? {}));
        problem.textContent = (await this.editor.change(label.toLowerCase(), patch)) ?? "";
      });
    });
    return make("div", { class: "adders" }, make("div", { class: "row" }, ...buttons), problem);
  }

  // Makes the block for models of recorded noise, of which one is shown.
  #models(spec) {
    const { editor } = this;
    const id = newId("model");
    const list = () => editor.at(spec.path) ?? [];
    this.#model = Math.min(this.#model, list().length - 1);
    const at = this.#model;
    const select = make("select", { class: "select", id });
    const show = (index) => {
      this.#model = index;
      this.follow();
    };
    select.addEventListener("change", () => show(Number(select.value)));
    const problem = make("p", { class: "error-line", role: "alert" });
    const send = async (models, index) => {
      problem.textContent = (await editor.change("models", () => editor.patch(spec.path, models()))) ?? "";
      show(Math.min(index, list().length - 1));
    };
    const another = () => ({ ...(list()[at] ?? MODEL), force_n: 2 * (list().at(-1).force_n || 0.5) });
    const add = button("Add model", "small", () => send(() => [...list(), another()], Infinity)); // Infinity: shows the last one
    const remove = button("Remove model", "small", () => send(() => list().toSpliced(at, 1), at));
    const follow = () => {
      const names = list().map((model, index) => [String(index), `${index + 1}: ${Number((1000 * model.speed_m_per_s).toPrecision(4))} mm/s, ${model.force_n} N`]);
      fill(select, names, String(at));
      remove.disabled = names.length < 2;
    };
    follow();
    const element = make(
      "div",
      { class: "models", data: { path: spec.path.join(".") } },
      make("div", { class: "field" }, make("label", { for: id, text: "Model" }), make("span", { class: "entry" }, select)),
      make("div", { class: "row" }, add, remove),
      problem,
      ...this.#members("AutoregressiveModel", [...spec.path, at]),
    );
    return { element, path: spec.path, follow };
  }
}
