// One material, one object or the scene's own keys while it is edited: its value, and what becomes of a change.
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

  // The merge patch that puts a value at a path; of a map, that merges it. Lists are sent whole.
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

  // Whether a value at this path is on its way to the daemon.
  isUnderWay(path) {
    const cut = path.findIndex((key) => typeof key === "number");
    return this.app.undo.changes.isUnderWay(this.target, this.#whole(cut < 0 ? path : path.slice(0, cut)));
  }

  // Sends a value that is not final: of a slider that is dragged. Null, or what the daemon found wrong, as one line.
  async live(patch) {
    try {
      await this.app.undo.changes.send(this.target, this.#wrap(patch));
      return null;
    } catch (error) {
      return this.#problem(error, patch);
    }
  }

  // Sends a final value and remembers how to take it back. `before`: the value before the drag; `join`: of one control.
  // It leaves at once, joined with what waits: for a slider, whose older values nobody misses.
  commit(what, patch, { before = this.value, join = null } = {}) {
    return this.app.undo.during(() => this.#commit(what, patch, before, join));
  }

  // Sends a change as a step of its own, after all changes before it. `build` returns the patch, made from the value that
  // these left; undefined: there is nothing to change any more.
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

  // Lines of warning that concern a path.
  warningsAt(path) {
    const whole = this.#whole(path);
    return this.app.warnings
      .of(this.target)
      .filter((each) => related(each.path, whole) && each.path.length >= whole.length)
      .map(({ text }) => text);
  }

  #whole(path) {
    return this.name === null ? path : [this.name, ...path];
  }

  #wrap(patch) {
    return this.name === null ? patch : { [this.name]: patch };
  }

  #problem(error, patch) {
    if (!error.problems?.length) {
      return `Not taken: ${error.message}`;
    }
    const own = this.#whole([]);
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
