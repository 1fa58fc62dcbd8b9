// Lists of numbers as tables and texts: points over speed, frequency tables, coefficients, samples of a waveform, patches.
//
// A list is sent completely when one of its numbers changed.
import { button, fill, make, svg } from "../dom.js";
import { fieldFrame } from "./field_frame.js";
import { withWarnings } from "./fields.js";
import { NOT_A_NUMBER_TEXT, format, parse, shownUnit } from "./numbers.js";
import { rounded } from "./placement.js";

// `table(value)` returns {head: [text or cell], rows: [[cell]], add, columns: buttons as [text, function],
// remove: {min, of}}. `remove.of(row)` removes a row if the table has more than `min` rows. A cell is {name, unit, value,
// set} or, for a name, {name, options, value, set}. All functions return the complete new value.
export function tableField(editor, spec, table) {
  const frame = fieldFrame(editor, spec);
  frame.label.removeAttribute("for");
  const holder = make("div", { class: "table-holder", role: "group", "aria-label": spec.label });
  frame.before(holder);
  let shown = null;

  // `newValueOf` returns the complete new value from the table after all earlier changes: a field that loses its focus to a
  // button sends its number just before the button is pressed.
  async function send(newValueOf, cell) {
    const patch = () => {
      const value = editor.at(spec.path);
      const changed = value === undefined ? undefined : newValueOf(table(value));
      return changed === undefined ? undefined : editor.patch(spec.path, changed);
    };
    const problem = await editor.change(spec.label.toLowerCase(), patch);
    frame.showProblem(problem, cell ? [cell] : []);
    shown = problem === null ? null : shown;
    follow();
  }

  // `find(table)` returns the same cell in a newer table; undefined if it was removed.
  function drawCell(cell, find) {
    const sendCell = (value, input) => send((then) => find(then)?.set(value), input);
    return cell.options ? drawChoice(cell, sendCell, frame) : drawNumber(cell, sendCell, frame);
  }

  function draw(value) {
    const { head, rows, add, remove, columns } = table(value);
    const line = (cells, tag, find) =>
      make("tr", {}, ...cells.map((each, column) => make(tag, tag === "th" ? { scope: "col" } : {}, typeof each === "string" ? each : drawCell(each, (then) => find(then)?.[column]))));
    const body = rows.map((cells, index) => {
      const tr = line(cells, "td", (then) => then.rows[index]);
      if (remove && rows.length > remove.min) {
        const cut = (then) => (then.rows.length > index && then.rows.length > then.remove.min ? then.remove.of(index) : undefined);
        tr.append(make("td", {}, button("×", "quiet small", () => send(cut), { "aria-label": `Remove row ${index + 1}` })));
      }
      return tr;
    });
    const tool = (list, text) => button(text, "small", () => send((then) => then[list]?.find(([other]) => other === text)?.[1]()));
    const tools = [...(add ?? []).map(([text]) => tool("add", text)), ...(columns ?? []).map(([text]) => tool("columns", text))];
    const focused = [...holder.querySelectorAll("input, select, button")].indexOf(document.activeElement);
    holder.replaceChildren(
      make("table", { class: "table editor-table" }, make("thead", {}, line(head, "th", (then) => then.head)), make("tbody", {}, ...body)),
      make("div", { class: "row" }, ...tools),
    );
    if (focused >= 0) {
      [...holder.querySelectorAll("input, select, button")][focused]?.focus();
    }
  }

  function follow() {
    const value = editor.at(spec.path);
    const key = JSON.stringify([value, editor.app.materialNames().length]);
    if (key !== shown && value !== undefined && !holder.querySelector('[data-draft="true"], [aria-invalid="true"]') && !editor.isUnderWay(spec.path)) {
      shown = key;
      draw(value);
    }
  }
  follow();
  return withWarnings({ element: frame.element, path: spec.path, follow }, frame);
}

function drawNumber(cell, send, frame) {
  const unit = shownUnit(cell.unit);
  const shown = format(cell.value, unit);
  const input = make("input", {
    type: "text",
    inputmode: "decimal",
    class: "number-input",
    autocomplete: "off",
    value: shown,
    "aria-label": unit.spoken ? `${cell.name}, ${unit.spoken}` : cell.name,
    "aria-describedby": frame.describedBy,
    data: { number: "true" },
  });
  input.addEventListener("input", () => (input.dataset.draft = String(input.value !== shown)));
  input.addEventListener("keydown", (event) => {
    if (event.key === "Escape" && (input.value !== shown || input.getAttribute("aria-invalid") !== null)) {
      event.preventDefault(); // otherwise the key would stop the forces
      input.value = shown;
      input.dataset.draft = "false";
      frame.showProblem(null, [input]);
    }
  });
  input.addEventListener("change", () => {
    input.dataset.draft = "false";
    if (input.value === shown && input.getAttribute("aria-invalid") === null) {
      return;
    }
    const value = input.value === shown ? cell.value : parse(input.value, unit);
    if (Number.isNaN(value)) {
      frame.showProblem(NOT_A_NUMBER_TEXT, [input]);
    } else {
      frame.showProblem(null, [input]);
      send(value, input);
    }
  });
  return make("span", { class: "cell" }, input);
}

function drawChoice(cell, send, frame) {
  const select = make("select", { class: "select", "aria-label": cell.name, "aria-describedby": frame.describedBy });
  fill(select, cell.options.map((name) => [name, name]), cell.value);
  select.addEventListener("change", () => send(select.value, select));
  return select;
}

const without = (list, index) => list.toSpliced(index, 1);
const withUnits = (text, si) => `${text}, ${shownUnit(si).text}`;

// Returns the table of points [speed, amplitude].
export function amplitudes(points) {
  const set = (row, column) => (value) => points.with(row, points[row].with(column, value));
  const last = points.at(-1);
  return {
    head: [withUnits("Speed", "m/s"), withUnits("Amplitude", "m/s^2")],
    rows: points.map(([speed, amplitude], row) => [
      { name: `Speed ${row + 1}`, unit: "m/s", value: speed, set: set(row, 0) },
      { name: `Amplitude ${row + 1}`, unit: "m/s^2", value: amplitude, set: set(row, 1) },
    ]),
    add: [["Add point", () => [...points, [2 * last[0], 2 * last[1]]]]],
    remove: { min: 1, of: (row) => without(points, row) },
  };
}

// Returns the table of speeds, frequencies and decay times, three lists of the same length.
export function modeTable(table) {
  const keys = ["speeds_m_per_s", "frequencies_hz", "decay_times_s"];
  const names = [["Speed", "m/s"], ["Frequency", "Hz"], ["Decay time", "s"]];
  const each = (change) => Object.fromEntries(keys.map((key) => [key, change(table[key], key)]));
  return {
    head: names.map(([name, unit]) => withUnits(name, unit)),
    rows: table.speeds_m_per_s.map((_, row) =>
      keys.map((key, column) => ({
        name: `${names[column][0]} ${row + 1}`,
        unit: names[column][1],
        value: table[key][row],
        set: (value) => ({ ...table, [key]: table[key].with(row, value) }),
      })),
    ),
    add: [["Add speed", () => each((list, key) => [...list, key === "speeds_m_per_s" ? 2 * (list.at(-1) || 0.05) : list.at(-1)])]],
    remove: { min: 1, of: (row) => each((list) => without(list, row)) },
  };
}

// Returns the table with a frequency for each speed (row) and each force (column).
export function frequencyTable(table) {
  const { speeds_m_per_s: speeds, forces_n: forces, frequencies_hz: grid } = table;
  return {
    head: [
      "Speed, mm/s, down; force, N, across",
      ...forces.map((force, column) => ({ name: `Force ${column + 1}`, unit: "N", value: force, set: (value) => ({ ...table, forces_n: forces.with(column, value) }) })),
    ],
    rows: speeds.map((speed, row) => [
      { name: `Speed ${row + 1}`, unit: "m/s", value: speed, set: (value) => ({ ...table, speeds_m_per_s: speeds.with(row, value) }) },
      ...grid[row].map((frequency, column) => ({
        name: `Frequency at speed ${row + 1} and force ${column + 1}`,
        unit: "Hz",
        value: frequency,
        set: (value) => ({ ...table, frequencies_hz: grid.with(row, grid[row].with(column, value)) }),
      })),
    ]),
    add: [["Add speed", () => ({ ...table, speeds_m_per_s: [...speeds, 2 * (speeds.at(-1) || 0.05)], frequencies_hz: [...grid, grid.at(-1)] })]],
    columns: [
      ["Add force", () => ({ ...table, forces_n: [...forces, 2 * (forces.at(-1) || 0.5)], frequencies_hz: grid.map((line) => [...line, line.at(-1)]) })],
      ...(forces.length > 1 ? [["Remove last force", () => ({ ...table, forces_n: forces.slice(0, -1), frequencies_hz: grid.map((line) => line.slice(0, -1)) })]] : []),
    ],
    remove: { min: 1, of: (row) => ({ ...table, speeds_m_per_s: without(speeds, row), frequencies_hz: without(grid, row) }) },
  };
}

// Returns the table of a wall's patches: from, to, material.
export function patches(list, names) {
  const set = (row, key) => (value) => list.with(row, { ...list[row], [key]: value });
  return {
    head: [withUnits("From", "m"), withUnits("To", "m"), "Material"],
    rows: list.map((patch, row) => [
      { name: `Patch ${row + 1} from`, unit: "m", value: patch.from_m, set: set(row, "from_m") },
      { name: `Patch ${row + 1} to`, unit: "m", value: patch.to_m, set: set(row, "to_m") },
      { name: `Material of patch ${row + 1}`, options: names, value: patch.material, set: set(row, "material") },
    ]),
    add: [["Add patch", () => [...list, newPatch(list, names)]]],
    remove: { min: 0, of: (row) => without(list, row) },
  };
}

// Returns a new patch of 20 mm, 5 mm beyond the last one.
export function newPatch(list, names) {
  const from = list.length ? Math.max(...list.map((patch) => patch.to_m)) : -0.01;
  const start = rounded(list.length ? from + 0.005 : from);
  return { from_m: start, to_m: rounded(start + 0.02), material: names[0] };
}

// Makes a field for a list of numbers, as text with spaces or commas. `picture`: whether their curve is drawn.
export function listField(editor, spec, picture) {
  const frame = fieldFrame(editor, spec);
  const text = make("textarea", { class: "list-input", rows: 3, spellcheck: "false", id: frame.ids.control, "aria-describedby": frame.describedBy });
  const graph = make("div", { class: "curve", "aria-hidden": "true" });
  let shown = null;
  let refused = false;
  const showProblem = (problem) => {
    refused = problem !== null;
    frame.showProblem(problem, [text]);
  };
  text.addEventListener("input", () => (text.dataset.draft = String(text.value !== shown)));
  text.addEventListener("change", async () => {
    if (text.value === shown && !refused) {
      return;
    }
    const numbers = text.value.trim().split(/[\s,;]+/).filter(Boolean).map(Number);
    const wrong = numbers.findIndex((number) => !Number.isFinite(number));
    const problem = wrong >= 0 ? `Entry ${wrong + 1} is not a number.` : await editor.change(spec.label.toLowerCase(), () => editor.patch(spec.path, numbers));
    text.dataset.draft = "false";
    showProblem(problem);
    follow();
  });
  function follow() {
    const value = editor.at(spec.path);
    if (value !== undefined && !refused && text.dataset.draft !== "true" && !editor.isUnderWay(spec.path)) {
      shown = value.join(", ");
      if (text.value !== shown) {
        text.value = shown;
      }
      graph.replaceChildren(...(picture ? [curve(value)] : []));
    }
  }
  frame.before(text);
  frame.before(graph);
  follow();
  return withWarnings({ element: frame.element, path: spec.path, follow }, frame);
}

function curve(samples) {
  const largest = Math.max(...samples.map(Math.abs)) || 1;
  const points = samples.map((sample, index) => `${((200 * index) / (samples.length - 1)).toFixed(2)},${(20 - (18 * sample) / largest).toFixed(2)}`);
  return svg("svg", { viewBox: "0 0 200 40", preserveAspectRatio: "none" }, svg("polyline", { points: points.join(" ") }));
}
