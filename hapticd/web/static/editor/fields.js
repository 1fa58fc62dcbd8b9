// The fields of a form, one for each kind of value: number with slider, choice, switch, vector, direction, material.
//
// A field is {element, follow(), path}. `follow` takes the daemon's value, unless the field is being edited or shows a
// refused value. Only values that the user changed are sent.
import { fill, make } from "../dom.js";
import { fieldFrame, inShownUnit, limitsOf } from "./field_frame.js";
import { NOT_A_NUMBER_TEXT, format, parse, shownUnit, withUnit } from "./numbers.js";
import { STEPS, atEnd, scaleAround } from "./scale.js";
import { typicalOf, valueLabel } from "./words.js";

const MAX_SLIDER_VALUE = 1e9; // larger numbers have no slider, such as a seed

// A number in a text field and, if `slider` is given, on a slider; both show one value.
//
// `number`: {get() -> SI or undefined, patch(value) -> merge patch, unit, limits: {min, max, integer, linear}, typical, name}.
export function numberInput(editor, frame, spec, number) {
  const unit = shownUnit(number.unit);
  const state = { draft: false, edits: 0, drag: null, refused: false, scale: null };
  const text = make("input", {
    type: "text",
    inputmode: "decimal",
    class: "number-input",
    autocomplete: "off",
    spellcheck: "false",
    id: number.id,
    "aria-label": number.name,
    "aria-describedby": frame.describedBy,
    data: { number: "true" },
  });
  const slider = number.slider
    ? make("input", { type: "range", min: 0, max: STEPS, step: 1, "aria-label": `${number.name}, slider`, "aria-describedby": frame.describedBy })
    : null;

  function show(value) {
    text.value = value === undefined ? "" : format(value, unit);
    state.shown = text.value;
    text.dataset.draft = "false";
    if (slider !== null && value !== undefined) {
      slider.setAttribute("aria-valuetext", `${text.value} ${unit.spoken}`.trim());
      if (state.drag === null) {
        if (state.scale === null || atEnd(state.scale, value)) {
          state.scale = scaleAround(value, number.limits, number.typical);
        }
        slider.value = state.scale.position(value);
      }
    }
  }

  function showProblem(problem) {
    state.refused = problem !== null;
    const held = number.get();
    const inForce = state.refused && held !== undefined ? ` In force: ${withUnit(held, number.unit)}; Escape puts it back.` : "";
    frame.showProblem(problem && `${inShownUnit(problem, unit).replace(/\.$/, "")}.${inForce}`, [text]);
  }

  // The answer to a value does not change what was typed or dragged after it was sent. Steps of the slider are joined, as
  // while a key is held; each typed number is a separate step. `before`: the value before a drag.
  async function send(value, before = null, join = null) {
    const sent = state.edits;
    const label = spec.label.toLowerCase();
    const patch = () => number.patch(value);
    const problem = await (before === null ? editor.change(label, patch) : editor.commit(label, patch(), { before, join }));
    if (state.edits !== sent) {
      return;
    }
    showProblem(problem);
    if (problem === null) {
      state.draft = false;
      follow();
    }
  }

  text.addEventListener("input", () => {
    state.edits++;
    state.draft = text.value !== state.shown;
    text.dataset.draft = String(state.draft);
  });
  text.addEventListener("change", () => {
    if (text.value === state.shown && !state.refused) {
      state.draft = false;
      return;
    }
    const value = text.value === format(number.get() ?? NaN, unit) ? number.get() : parse(text.value, unit);
    Number.isNaN(value) ? showProblem(NOT_A_NUMBER_TEXT) : send(value);
  });
  text.addEventListener("keydown", (event) => {
    if (event.key === "Escape" && (state.draft || state.refused)) {
      event.preventDefault(); // otherwise the key would stop the forces
      reset();
    }
  });

  function reset() {
    state.draft = false;
    showProblem(null);
    show(number.get());
  }

  slider?.addEventListener("input", () => {
    state.edits++;
    state.drag ??= { before: editor.value };
    const value = state.scale.value(Number(slider.value));
    state.drag.value = value;
    state.draft = false;
    show(value);
    const drag = state.drag;
    editor.live(number.patch(value)).then((problem) => {
      if (state.drag === drag && drag.value === value) {
        showProblem(problem);
      }
    });
  });
  slider?.addEventListener("change", () => {
    const drag = state.drag;
    state.drag = null;
    if (drag !== null) {
      send(drag.value, drag.before, `${spec.path.join(".")} ${number.name}`);
    }
  });

  function follow() {
    if (!state.draft && !state.refused && state.drag === null && !editor.isUnderWay(spec.path)) {
      show(number.get());
    }
  }
  show(number.get());
  return { text, slider, follow, reset };
}

export function limitsFor(schema) {
  const { minimum: min, maximum: max } = limitsOf(schema);
  return { min: min ?? -Infinity, max: max ?? Infinity, integer: schema.type === "integer", linear: (min < 0 && schema.unit === "m") || schema.unit === "rad" };
}

export function numberField(editor, spec) {
  const frame = fieldFrame(editor, spec);
  const limits = limitsFor(spec.schema);
  const unit = shownUnit(spec.schema.unit);
  const input = numberInput(editor, frame, spec, {
    id: frame.ids.control,
    name: unit.spoken ? `${spec.label}, ${unit.spoken}` : spec.label,
    unit: spec.schema.unit,
    limits: spec.schema.unit === "rad" ? turns(limits) : limits,
    typical: typicalOf(spec.definition, spec.key, spec.schema.unit),
    slider: limits.max < MAX_SLIDER_VALUE,
    get: () => editor.at(spec.path),
    patch: (value) => editor.patch(spec.path, value),
  });
  frame.entry.append(input.text, make("span", { class: "unit", text: unit.text }));
  if (input.slider) {
    frame.before(input.slider);
  }
  return withWarnings({ element: frame.element, path: spec.path, follow: input.follow }, frame);
}

// The slider of an angle covers at most one turn, regardless of the limits.
const turns = (limits) => ({ ...limits, min: Math.max(limits.min, -Math.PI), max: Math.min(limits.max, Math.PI) });

// Makes the field of a quantity that one of two keys gives: a number with a choice of units.
export function pairField(editor, spec, pair, schemas) {
  const frame = fieldFrame(editor, spec);
  const held = () => pair.keys.find((key) => editor.at([...spec.path.slice(0, -1), key]) !== undefined) ?? pair.keys[0];
  const parent = spec.path.slice(0, -1);
  const key = held();
  const schema = schemas[key];
  const units = make("select", { class: "select unit-select", "aria-label": `Unit of ${spec.label.toLowerCase()}` });
  fill(units, pair.keys.map((each) => [each, shownUnit(schemas[each].unit).text]), key);
  const input = numberInput(editor, frame, spec, {
    id: frame.ids.control,
    name: `${spec.label}, ${shownUnit(schema.unit).spoken}`,
    unit: schema.unit,
    limits: limitsFor(schema),
    typical: typicalOf(spec.definition, key, schema.unit),
    slider: true,
    get: () => editor.at([...parent, key]),
    patch: (value) => editor.patch([...parent, key], value),
  });
  units.addEventListener("change", async () => {
    const wanted = units.value;
    const convert = wanted === pair.keys[0] ? pair.from : pair.to;
    const patch = () => {
      const value = editor.at([...parent, key]);
      return value === undefined ? undefined : editor.patch(parent, { [key]: null, [wanted]: convert(value) });
    };
    frame.showProblem(await editor.change(`unit of the ${spec.label.toLowerCase()}`, patch));
  });
  frame.entry.append(input.text, units);
  frame.before(input.slider);
  return withWarnings({ element: frame.element, path: [...parent, key], follow: input.follow }, frame);
}

export function withWarnings(field, frame) {
  const follow = () => {
    field.follow();
    frame.showWarnings();
  };
  frame.showWarnings();
  return { ...field, follow };
}

// Sends the value of a control at once; `follow` restores it if it is refused. `patchOf` returns the patch for a value.
function sending(editor, frame, spec, control, follow, patchOf = (value) => editor.patch(spec.path, value)) {
  return async (value) => {
    const problem = await editor.change(spec.label.toLowerCase(), () => patchOf(value));
    frame.showProblem(problem, [control]);
    if (problem !== null) {
      follow();
    }
  };
}

// A choice of one of the [value, text] pairs that `pairsOf` returns.
function selectField(editor, spec, pairsOf, patchOf) {
  const frame = fieldFrame(editor, spec);
  const select = make("select", { class: "select", id: frame.ids.control, "aria-describedby": frame.describedBy });
  const follow = () => fill(select, pairsOf(), String(editor.at(spec.path)));
  const send = sending(editor, frame, spec, select, follow, patchOf);
  select.addEventListener("change", () => send(select.value));
  follow();
  frame.entry.append(select);
  return withWarnings({ element: frame.element, path: spec.path, follow }, frame);
}

export function enumField(editor, spec) {
  const pairs = spec.schema.enum.map((value) => [String(value), valueLabel(spec.definition, spec.key, value)]);
  const also = spec.also ?? (() => ({}));
  return selectField(editor, spec, () => pairs, (value) => editor.patch(spec.path.slice(0, -1), { [spec.key]: value, ...also(value) }));
}

export function switchField(editor, spec) {
  const frame = fieldFrame(editor, spec);
  const box = make("input", { type: "checkbox", id: frame.ids.control, "aria-describedby": frame.describedBy });
  const follow = () => (box.checked = editor.at(spec.path) ?? spec.schema.default ?? false);
  const send = sending(editor, frame, spec, box, follow);
  box.addEventListener("change", () => send(box.checked));
  follow();
  frame.entry.append(box);
  return withWarnings({ element: frame.element, path: spec.path, follow }, frame);
}

// A choice of material names; those of the scene first.
export function materialField(editor, spec) {
  return selectField(editor, spec, () => editor.app.materialNames().map((name) => [name, name]));
}

// Two components, x and y (or width and height), each with a slider.
export function vectorField(editor, spec, names = ["x", "y"]) {
  const frame = fieldFrame(editor, spec);
  const unit = shownUnit(spec.schema.unit);
  frame.element.classList.add("vector");
  frame.label.removeAttribute("for");
  frame.element.setAttribute("role", "group");
  frame.element.setAttribute("aria-label", spec.label);
  const inputs = names.map((name, index) => {
    const input = numberInput(editor, frame, spec, {
      id: frame.ids.control + name,
      name: `${spec.label}, ${name}, ${unit.spoken}`,
      unit: spec.schema.unit,
      limits: limitsFor(spec.schema),
      typical: typicalOf(spec.definition, spec.key, spec.schema.unit),
      slider: true,
      get: () => editor.at(spec.path)?.[index],
      patch: (value) => editor.patch(spec.path, editor.at(spec.path).with(index, value)),
    });
    frame.before(make("div", { class: "component" }, make("span", { class: "axis", text: name, "aria-hidden": "true" }), input.slider, input.text, make("span", { class: "unit", text: unit.text })));
    return input;
  });
  return withWarnings({ element: frame.element, path: spec.path, follow: () => inputs.forEach((input) => input.follow()) }, frame);
}

// A unit vector, shown as its angle from the x axis, counterclockwise.
export function directionField(editor, spec) {
  const frame = fieldFrame(editor, spec);
  const angle = () => {
    const [x, y] = editor.at(spec.path) ?? [0, 1];
    return Math.atan2(y, x);
  };
  const input = numberInput(editor, frame, spec, {
    id: frame.ids.control,
    name: `${spec.label}, degrees`,
    unit: "rad",
    limits: { min: -Math.PI, max: Math.PI, integer: false, linear: true },
    typical: Math.PI,
    slider: true,
    get: angle,
    patch: (value) => editor.patch(spec.path, unitVector(value)),
  });
  frame.entry.append(input.text, make("span", { class: "unit", text: "°" }));
  frame.before(input.slider);
  return withWarnings({ element: frame.element, path: spec.path, follow: input.follow }, frame);
}

// Multiples of a right angle give exact components.
export function unitVector(angle) {
  const clean = (value) => (Math.abs(value) < 1e-15 ? 0 : Math.abs(Math.abs(value) - 1) < 1e-15 ? Math.sign(value) : value);
  return [clean(Math.cos(angle)), clean(Math.sin(angle))];
}
