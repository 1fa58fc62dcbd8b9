// The editing of one material, one object or the scene's keys: its value, and its changes.
import { at, difference, inverse, merged, patchAt } from "./merge_patch.js";
import { related } from "./problem_path.js";

// `target`: materials, objects or scene; `name`: of the material or object, null for the scene.
export class Editor {
  constructor(app, target, name) {
    this.app = app;
    this.target = target;
    this.name = name;
    this.label = name ?? "the scene";
  }

  get value() {
    const { materials, scene } = this.app.model;
    if (this.target === "scene") {
      return scene;
    }
    return (this.target === "materials" ? materials : scene.objects)[this.name] ?? {};
  }

  at(path) {
    return at(this.value, path);
  }

  // Returns the merge patch that sets the value at a path. A map is merged, a list is replaced completely.
  patch(path, value) {
    const cut = path.findIndex((key) => typeof key === "number");
    if (cut < 0) {
      return patchAt(path, value);
    }
    const place = path[cut];
    const list = [...this.at(path.slice(0, cut))];
    list[place] = merged(list[place], patchAt(path.slice(cut + 1), value));
    return patchAt(path.slice(0, cut), list);
  }

  // Returns whether a value at this path is not in force yet.
  isUnderWay(path) {
    const cut = path.findIndex((key) => typeof key === "number");
    return this.app.undo.changes.isUnderWay(this.target, this.#fullPath(cut < 0 ? path : path.slice(0, cut)));
  }

  // Sends an intermediate value, as of a dragged slider. Resolves with null or the daemon's problem, as one line.
  async live(patch) {
    try {
      await this.app.undo.changes.send(this.target, this.#wrap(patch));
      return null;
    } catch (error) {
      return this.#problem(error, patch);
    }
  }

  // Sends a final value and stores the step for undo. `before`: the value before the drag; `join`: joins steps of a control.
  // The value is sent together with other waiting changes, so that older values of a slider may be skipped.
  commit(what, patch, { before = this.value, join = null } = {}) {
    return this.app.undo.during(() => this.#commit(what, patch, before, join));
  }

  // Sends a change as a separate step, after all changes before it. `build` returns the patch from the value after these;
  // it returns undefined if there is nothing to change any more.
  change(what, build) {
    const { undo } = this.app;
    const send = () => {
      const patch = build();
      return patch === undefined ? null : this.#commit(what, patch, this.value, null);
    };
    return undo.during(() => undo.changes.afterAll(send));
  }

  async #commit(what, patch, before, join) {
    const problem = await this.live(patch);
    if (problem === null && Object.keys(difference(before, merged(before, patch))).length) {
      const backward = { [this.target]: this.#wrap(inverse(before, patch)) };
      this.app.undo.note(`${what} of ${this.label}`, { [this.target]: this.#wrap(patch) }, backward, join && `${this.target} ${this.name} ${join}`);
    }
    return problem;
  }

  // Returns the warnings that concern a path, as lines.
  warningsAt(path) {
    const full = this.#fullPath(path);
    return this.app.warnings
      .of(this.target)
      .filter((each) => related(each.path, full) && each.path.length >= full.length)
      .map(({ text }) => text);
  }

  #fullPath(path) {
    return this.name === null ? path : [this.name, ...path];
  }

  #wrap(patch) {
    return this.name === null ? patch : { [this.name]: patch };
  }

  #problem(error, patch) {
    if (!error.problems?.length) {
      return `Not applied: ${error.message}`;
    }
    const own = this.#fullPath([]);
    return error.problems
      .filter(({ path }) => related(path, own))
      .map(({ path, problem }) => {
        const inside = path.slice(own.length);
        const sent = at(patch, inside.slice(0, 1)) !== undefined && typeof inside.at(-1) === "string";
        return sent || !inside.length ? problem : `${inside.join(".")}: ${problem}`;
      })
      .join("; ");
  }
}
