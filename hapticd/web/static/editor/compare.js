// A and B: two states of one or all materials, of which one is in force and the other is stored.
//
// The state in force is that of the daemon, and every change applies to it. The other state is stored here until the two are
// swapped, by a button or by the key X.
import { button, fill, make } from "../dom.js";
import { difference, equal, isMap, merged } from "./merge_patch.js";
import { withUnit } from "./numbers.js";
import { labelOf } from "./words.js";
import { notice } from "../undo.js";

const OTHER_LETTER = { A: "B", B: "A" };
const ALL_MATERIALS = "";
const MAX_SHOWN_DIFFERENCES = 12;

// Events: `changed`.
export class Compare extends EventTarget {
  scope = ALL_MATERIALS; // a material's name, or ALL_MATERIALS
  #app;
  #stored = new Map(); // by scope: {inForce, other: materials by name}
  #busy = Promise.resolve();
  #toggling = Promise.resolve();

  constructor(app) {
    super();
    this.#app = app;
    app.model.addEventListener("materials", () => this.dispatchEvent(new Event("changed")));
  }

  look(scope) {
    this.scope = scope;
    this.dispatchEvent(new Event("changed"));
  }

  get begun() {
    return this.#stored.has(this.scope);
  }

  get inForce() {
    return this.#stored.get(this.scope)?.inForce ?? "A";
  }

  // Returns the current materials of the scope, without removed ones.
  #current(names = this.#names()) {
    const { materials } = this.#app.model;
    return Object.fromEntries(names.filter((name) => name in materials).map((name) => [name, materials[name]]));
  }

  #names() {
    return this.scope === ALL_MATERIALS ? Object.keys(this.#app.model.materials) : [this.scope];
  }

  // Puts the state of this letter in force, and stores the other.
  to(letter) {
    this.#busy = this.#busy.then(async () => {
      if (letter === this.inForce) {
        return;
      }
      const scope = this.scope;
      const current = this.#current();
      const kept = this.#stored.get(scope)?.other ?? current;
      const patch = difference(this.#current(Object.keys(kept)), kept);
      if (Object.keys(patch).length) {
        await this.#app.undo.changes.send("materials", patch);
      }
      this.#stored.set(scope, { inForce: letter, other: current });
      this.dispatchEvent(new Event("changed"));
    });
    const done = this.#busy;
    this.#busy = done.catch(() => {});
    return done;
  }

  // Does the same as `to`, as a step that can be undone.
  async choose(letter) {
    const [scope, before] = [this.scope, this.inForce];
    if (letter === before) {
      return;
    }
    const there = (which) => () => {
      this.look(scope);
      return this.to(which);
    };
    try {
      await this.#app.undo.change(`${before} to ${letter}`, there(letter), there(before));
    } catch (error) {
      this.#app.view.dispatchEvent(notice(`${letter} cannot be displayed: ${error.message}`, "error"));
    }
  }

  // Runs one swap after the other, even if keys are pressed fast.
  toggle() {
    this.#toggling = this.#toggling.then(() => this.choose(OTHER_LETTER[this.inForce]));
    return this.#toggling;
  }

  // Copies the state in force to the other one.
  copy() {
    this.#stored.set(this.scope, { inForce: this.inForce, other: this.#current() });
    this.dispatchEvent(new Event("changed"));
  }

  // Returns [{path, A, B}] of all values that differ; undefined: the value does not exist.
  differences() {
    const kept = this.#stored.get(this.scope);
    if (kept === undefined) {
      return [];
    }
    const current = this.#current();
    return [...differences(current, kept.other)].map(({ path, one, other }) => ({ path, [kept.inForce]: one, [OTHER_LETTER[kept.inForce]]: other }));
  }
}

// Yields {path, one, other} for each place at which two values differ.
function* differences(one, other, path = []) {
  if (isMap(one) && isMap(other)) {
    for (const key of Object.keys(merged(one, other))) {
      yield* differences(one[key], other[key], [...path, key]);
    }
  } else if (!equal(one, other)) {
    yield { path, one, other };
  }
}

// Makes the card that compares the two states. `units`: units by key.
export function compareCard(app, compare, units) {
  const letters = ["A", "B"].map((letter) => button(letter, "", () => compare.choose(letter), { "aria-pressed": "false", "aria-keyshortcuts": "x" }));
  const scope = make("select", { class: "select", "aria-label": "Compared materials" });
  const copy = button("", "small", () => compare.copy());
  const state = make("p", { class: "note", role: "status" });
  const list = make("ul", { class: "differences" });
  let material = null;
  scope.addEventListener("change", () => compare.look(scope.value === "all" ? ALL_MATERIALS : material));

  function follow() {
    fill(scope, [["one", `of ${material ?? "the material"}`], ["all", "of all materials"]], compare.scope === ALL_MATERIALS ? "all" : "one");
    const { inForce } = compare;
    letters.forEach((each) => each.setAttribute("aria-pressed", String(each.textContent === inForce)));
    copy.textContent = `Copy ${inForce} to ${OTHER_LETTER[inForce]}`;
    copy.disabled = !compare.begun;
    const found = compare.differences();
    state.textContent = !compare.begun
      ? "Choose B, or press X, and change something: A stays as it is now."
      : found.length
        ? `${inForce} is in force. ${found.length === 1 ? "One figure differs" : `${found.length} figures differ`}:`
        : `${inForce} is in force. A and B are the same.`;
    const more = found.length - MAX_SHOWN_DIFFERENCES;
    list.replaceChildren(
      ...found.slice(0, MAX_SHOWN_DIFFERENCES).map((each) => make("li", { text: differenceText(each, units, compare.scope === ALL_MATERIALS) })),
      ...(more > 0 ? [make("li", { text: `and ${more} more` })] : []),
    );
    list.hidden = !found.length;
  }
  compare.addEventListener("changed", follow);
  document.addEventListener("keydown", (event) => {
    const typing = event.target.matches?.('input:not([type="range"]):not([type="checkbox"]), textarea, select');
    if (event.key.toLowerCase() === "x" && !typing && !event.ctrlKey && !event.metaKey && !event.altKey && !event.repeat) {
      event.preventDefault();
      compare.toggle();
    }
  });
  follow();
  const element = make(
    "section",
    { class: "card compare", "aria-label": "Compare A and B" },
    make("div", { class: "toolbar" }, make("h3", { text: "Compare" }), make("div", { class: "toolbar segmented", role: "group", "aria-label": "State in force" }, ...letters), scope, copy),
    state,
    list,
  );
  return {
    element,
    show(name) {
      const one = compare.scope !== ALL_MATERIALS || material === null;
      material = name;
      one ? compare.look(name) : follow();
    },
  };
}

function differenceText({ path, A, B }, units, named) {
  const words = path.slice(1).map((key, index) => labelOf(index ? "" : "Material", key));
  const text = (value) => (value === undefined ? "none" : typeof value === "number" ? withUnit(value, units[path.at(-1)]) : typeof value === "object" ? "set" : String(value));
  const [a, b] = [text(A), text(B)];
  return `${named ? `${path[0]}: ` : ""}${words.join(", ") || "material"}: A ${a}, B ${a === b ? "another" : b}`;
}
