// A and B: two states of a material, or of all, of which one is in force and the other is kept.
//
// What is in force is simply what the daemon has: every change goes to it. The other state is kept here until the
// two change places, by a button or by the key X.
import { button, fill, make } from "../dom.js";
import { difference, equal, isMap, merged } from "./merge_patch.js";
import { withUnit } from "./numbers.js";
import { labelOf } from "./words.js";
import { notice } from "../undo.js";

const OTHER = { A: "B", B: "A" };
const ALL = "";
const MOST_SHOWN = 12;

// Events: `changed`.
export class Compare extends EventTarget {
  scope = ALL; // a material's name, or ALL
  #app;
  #kept = new Map(); // by scope: {inForce, other: materials by name}
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
    return this.#kept.has(this.scope);
  }

  get inForce() {
    return this.#kept.get(this.scope)?.inForce ?? "A";
  }

  // The materials of the scope as they are; those that are gone are left out.
  #current(names = this.#names()) {
    const { materials } = this.#app.model;
    return Object.fromEntries(names.filter((name) => name in materials).map((name) => [name, materials[name]]));
  }

  #names() {
    return this.scope === ALL ? Object.keys(this.#app.model.materials) : [this.scope];
  }

  // Puts the state of this letter in force, and keeps the other.
  to(letter) {
    this.#busy = this.#busy.then(async () => {
      if (letter === this.inForce) {
        return;
      }
      const scope = this.scope;
      const current = this.#current();
      const kept = this.#kept.get(scope)?.other ?? current;
      const patch = difference(this.#current(Object.keys(kept)), kept);
      if (Object.keys(patch).length) {
        await this.#app.undo.changes.send("materials", patch);
      }
      this.#kept.set(scope, { inForce: letter, other: current });
      this.dispatchEvent(new Event("changed"));
    });
    const done = this.#busy;
    this.#busy = done.catch(() => {});
    return done;
  }

  // As `to`, as a step that can be taken back.
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

  // One after the other, however fast the keys come.
  toggle() {
    this.#toggling = this.#toggling.then(() => this.choose(OTHER[this.inForce]));
    return this.#toggling;
  }

  // The other state becomes what is in force.
  copy() {
    this.#kept.set(this.scope, { inForce: this.inForce, other: this.#current() });
    this.dispatchEvent(new Event("changed"));
  }

  // [{path, A, B}] of every figure in which the two differ; undefined: not there.
  differences() {
    const kept = this.#kept.get(this.scope);
    if (kept === undefined) {
      return [];
    }
    const current = this.#current();
    return [...figures(current, kept.other)].map(({ path, one, other }) => ({ path, [kept.inForce]: one, [OTHER[kept.inForce]]: other }));
  }
}

// Where two values differ, key by key.
export function* figures(one, other, path = []) {
  if (isMap(one) && isMap(other)) {
    for (const key of Object.keys(merged(one, other))) {
      yield* figures(one[key], other[key], [...path, key]);
    }
  } else if (!equal(one, other)) {
    yield { path, one, other };
  }
}

// The two states, as a card. `units`: by key.
export function compareCard(app, compare, units) {
  const letters = ["A", "B"].map((letter) => button(letter, "", () => compare.choose(letter), { "aria-pressed": "false", "aria-keyshortcuts": "x" }));
  const scope = make("select", { class: "select", "aria-label": "What is compared" });
  const copy = button("", "small", () => compare.copy());
  const state = make("p", { class: "note", role: "status" });
  const list = make("ul", { class: "differences" });
  let material = null;
  scope.addEventListener("change", () => compare.look(scope.value === "all" ? ALL : material));

  function follow() {
    fill(scope, [["one", `of ${material ?? "the material"}`], ["all", "of all materials"]], compare.scope === ALL ? "all" : "one");
    const { inForce } = compare;
    letters.forEach((each) => each.setAttribute("aria-pressed", String(each.textContent === inForce)));
    copy.textContent = `Copy ${inForce} to ${OTHER[inForce]}`;
    copy.disabled = !compare.begun;
    const found = compare.differences();
    state.textContent = !compare.begun
      ? "Choose B, or press X, and change something: A stays as it is now."
      : found.length
        ? `${inForce} is in force. ${found.length === 1 ? "One figure differs" : `${found.length} figures differ`}:`
        : `${inForce} is in force. A and B are the same.`;
    const more = found.length - MOST_SHOWN;
    list.replaceChildren(
      ...found.slice(0, MOST_SHOWN).map((each) => make("li", { text: differenceText(each, units, compare.scope === ALL) })),
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
      const one = compare.scope !== ALL || material === null;
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
