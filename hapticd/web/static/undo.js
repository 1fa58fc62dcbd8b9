// Undo and redo of all changes of scene and materials on the page: `app.undo`.
//
//   app.undo.change(label, forward, backward)   makes the change `forward` and stores the step
//   app.undo.note(label, forward, backward)     stores a step that was already made, as at the end of a drag
//   app.undo.undo(), app.undo.redo()            also by Ctrl+Z and Ctrl+Shift+Z
//
// `label` describes the step, as "move floor". `forward` and `backward` are changes: maps of `materials`, `objects` and
// `scene`, each a merge patch as for update_materials and update_scene (`scene`: display, ramp_s and passivity):
//
//   app.undo.note("move peg", {objects: {peg: {center_m: [0, 0]}}}, {objects: {peg: {center_m: [0.01, 0]}}})
//
// A step is undone only if its values are still those that it set. If another client changed them, the page shows a notice
// and changes nothing; a second undo overwrites them. `forward` and `backward` may also be functions, which are called
// without this check.
//
// Event: `changed`, when the steps to undo or redo changed.
import { button } from "./dom.js";
import { Changed, Changes } from "./editor/changes.js";
import { isMap } from "./editor/merge_patch.js";

const MAX_STEPS = 500;
const JOINED_WITHIN_MS = 1000;

export class Undo extends EventTarget {
  #app;
  #past = [];
  #future = [];
  #busy = Promise.resolve();
  #underWay = new Set(); // promises of changes that are not stored yet
  #insisting = null; // the step that is undone or redone even if other clients changed its values

  constructor(app) {
    super();
    this.#app = app;
    this.changes = new Changes(app.link, app.model);
    document.addEventListener("keydown", (event) => this.#key(event));
  }

  get undoable() {
    return this.#past.at(-1)?.label ?? null;
  }

  get redoable() {
    return this.#future.at(-1)?.label ?? null;
  }

  change(label, forward, backward) {
    return this.during(async () => {
      const result = await this.#carryOut(forward);
      this.note(label, forward, backward);
      return result;
    });
  }

  // As `change`, but returns whether the change was made. If it was refused, `problem`, an element, shows why.
  async attempt(problem, label, forward, backward) {
    try {
      await this.change(label, forward, backward);
      problem.textContent = "";
      return true;
    } catch (error) {
      problem.textContent = error.problems?.map((each) => each.problem).join("; ") || error.message;
      return false;
    }
  }

  // Runs a change that ends with `note`. An undo that is requested meanwhile waits for this change, and undoes it.
  during(work) {
    const done = work();
    this.#underWay.add(done);
    const over = () => this.#underWay.delete(done);
    done.then(over, over);
    return done;
  }

  // `join`: a name; successive steps of the same name within a second become one step, as while a key is held.
  note(label, forward, backward, join = null) {
    const last = this.#past.at(-1);
    const now = performance.now();
    if (join !== null && last?.join === join && now - last.at < JOINED_WITHIN_MS && !this.#future.length) {
      last.forward = forward;
      last.at = now;
    } else {
      this.#past.push({ label, forward, backward, join, at: now });
      this.#past.splice(0, this.#past.length - MAX_STEPS);
    }
    this.#future = [];
    this.#insisting = null;
    this.#dispatch();
  }

  undo() {
    return this.#step(() => this.#past, () => this.#future, "backward", "forward", "Undone");
  }

  redo() {
    return this.#step(() => this.#future, () => this.#past, "forward", "backward", "Redone");
  }

  // Runs one undo or redo after the other, even if keys are pressed fast.
  #step(from, to, direction, other, done) {
    this.#busy = this.#busy.then(async () => {
      await Promise.allSettled(this.#underWay);
      const step = from().at(-1);
      if (step === undefined) {
        return;
      }
      const word = direction === "backward" ? "undo" : "redo";
      try {
        await this.#carryOut(step[direction], this.#insisting === step ? null : step[other]);
      } catch (error) {
        if (error instanceof Changed) {
          this.#insisting = step;
          this.#app.view.dispatchEvent(notice(`Not changed: ${changedText(error)}. To ${word} “${step.label}” all the same, ${word} once more.`, "error"));
        } else {
          this.#app.view.dispatchEvent(notice(`Cannot ${word} “${step.label}”: ${error.message}`, "error"));
        }
        return;
      }
      this.#insisting = null;
      from().pop();
      to().push({ ...step, join: null });
      this.#app.view.dispatchEvent(notice(`${done}: ${step.label}`, "info"));
      this.#dispatch();
    });
    return this.#busy;
  }

  // `expected`: values that must still be in force; null: they are not checked.
  async #carryOut(change, expected = null) {
    if (typeof change === "function") {
      return change();
    }
    let result = null;
    for (const [target, patch, names] of ordered(change)) {
      const still = expected === null || typeof expected === "function" ? null : only(expected[target] ?? {}, names);
      result = await (still === null ? this.changes.send(target, patch) : this.changes.sendIfStill(target, patch, still));
    }
    return result;
  }

  #dispatch() {
    this.dispatchEvent(new Event("changed"));
  }

  #key(event) {
    if (!(event.ctrlKey || event.metaKey) || event.altKey || event.defaultPrevented) {
      return;
    }
    const key = event.key.toLowerCase();
    const redo = (key === "z" && event.shiftKey) || key === "y";
    // A text field has its separate undo.
    if ((key !== "z" && !redo) || event.target.matches?.('textarea, [data-draft="true"], [type="search"], [type="text"]:not([data-number])')) {
      return;
    }
    event.preventDefault();
    redo ? this.redo() : this.undo();
  }
}

// Adds materials, changes objects, then removes unused materials, so that the scene is valid after every step.
function* ordered(change) {
  const materials = Object.entries(change.materials ?? {});
  const coming = Object.fromEntries(materials.filter(([, patch]) => patch !== null));
  const going = Object.fromEntries(materials.filter(([, patch]) => patch === null));
  for (const [target, patch] of [["materials", coming], ["objects", change.objects], ["scene", change.scene], ["materials", going]]) {
    if (isMap(patch) && Object.keys(patch).length) {
      yield [target, patch, Object.keys(patch)];
    }
  }
}

const only = (patch, names) => Object.fromEntries(names.filter((name) => Object.hasOwn(patch, name)).map((name) => [name, patch[name]]));

function changedText(error) {
  const [{ path, is }] = error.departures;
  const value = is === undefined ? "no longer exists" : typeof is === "object" ? "has another value" : `is now ${is}`;
  return `${path.join(".")} was changed elsewhere and ${value}`;
}

export function notice(text, kind) {
  return new CustomEvent("notice", { detail: { text, kind } });
}

// Two buttons, for a toolbar.
export function undoButtons(app) {
  const buttons = [["Undo", "undo", "Control+Z"], ["Redo", "redo", "Control+Shift+Z"]].map(([text, name, keys]) =>
    button(text, "small", () => app.undo[name](), { "aria-keyshortcuts": keys }),
  );
  const follow = () => {
    for (const [button, word, label] of [[buttons[0], "Undo", app.undo.undoable], [buttons[1], "Redo", app.undo.redoable]]) {
      button.disabled = label === null;
      button.title = label === null ? `Nothing to ${word.toLowerCase()}` : `${word}: ${label}`;
    }
  };
  app.undo.addEventListener("changed", follow);
  follow();
  return buttons;
}
