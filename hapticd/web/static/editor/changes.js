// The editors' calls of the daemon: at most one is under way, and of waiting changes only the newest value of each key is
// kept.
//
// A dragged slider changes its value a hundred times a second. Each value is merged into the waiting patch, which is sent as
// one call when the daemon has answered. Superseded values are not sent; the last value always is.
import { at, canJoin, departures, isMap, joined, leaves, merged } from "./merge_patch.js";
import { parsePath, related } from "./problem_path.js";

const INVALID_PARAMS_CODE = -32602;
const HANDLE_INSIDE_CODE = -32011;
const STALE_REVISION_CODE = -32001;
const RING_FULL_CODE = -32005;
const RETRY_MS = 100;
const MAX_TRIES = 50;
const TARGETS = ["materials", "objects", "scene"];

// The error of a change that the daemon refused. `problems`: [{path, problem}], the path inside the target.
export class Refused extends Error {
  constructor(message, problems) {
    super(message);
    this.problems = problems;
  }
}

// The error of a step whose values another client has changed. `departures`: [{path, is, wanted}].
export class Changed extends Error {
  constructor(target, found) {
    super("it was changed elsewhere");
    this.target = target;
    this.departures = found;
  }
}

const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

// Event: `accepted`, {target, patch, warnings}, after each call that the daemon accepted.
export class Changes extends EventTarget {
  calls = 0; // number of calls
  #link;
  #model;
  #waiting = []; // {target, patch, resolve, reject}, oldest first
  #running = null;

  constructor(link, model) {
    super();
    this.#link = link;
    this.#model = model;
  }

  // Sends a merge patch of `materials` or `objects`, both by name, or of `scene` (display, ramp_s, passivity). Resolves when
  // the patch, or a newer one that supersedes it, is in force; rejects with Refused.
  send(target, patch) {
    return new Promise((resolve, reject) => {
      this.#waiting.push({ target, patch, resolve, reject });
      this.#running ??= this.#run().finally(() => (this.#running = null));
    });
  }

  // Returns whether a value at this path of the target is not in force yet.
  isUnderWay(target, path) {
    return [...this.#waiting, ...this.#batch].some(
      (each) => each.target === target && [...leaves(each.patch)].some(([other]) => related(path, other)),
    );
  }

  // Calls `work` when all sent changes are answered. Other callers wait until the changes of `work` are answered.
  async afterAll(work = () => {}) {
    while (this.#running) {
      await this.#running;
    }
    return work();
  }

  // Sends a patch if the target still has the values of the patch `expected`; else rejects with Changed.
  async sendIfStill(target, patch, expected) {
    await this.afterAll();
    for (let tries = 0; tries < MAX_TRIES; tries++) {
      const { value, revision } = await this.#read(target);
      const found = departures(value, expected);
      if (found.length) {
        throw new Changed(target, found);
      }
      try {
        return await this.#call(target, patch, revision);
      } catch (error) {
        if (error.code !== STALE_REVISION_CODE) {
          throw this.#refusal(target, error);
        }
      }
    }
    throw new Refused("the scene changes all the time; try again", []);
  }

  #batch = [];

  async #run() {
    await null; // joins the changes of one task into one call
    while (this.#waiting.length) {
      const { target } = this.#waiting[0];
      let patch = {};
      const fits = (each) => each.target === target && canJoin(patch, each.patch);
      while (this.#waiting.length && fits(this.#waiting[0])) {
        patch = joined(patch, this.#waiting[0].patch);
        this.#batch.push(this.#waiting.shift());
      }
      await this.#deliver(target);
      this.#batch = [];
    }
  }

  // Sends the batch. If the daemon refuses a part of it, the rest is sent again.
  async #deliver(target) {
    for (let tries = 0; this.#batch.length; tries++) {
      const patch = this.#batch.map((each) => each.patch).reduce(joined);
      try {
        const result = await this.#call(target, patch);
        this.#batch.forEach((each) => each.resolve(result));
        return;
      } catch (error) {
        if (error.code === RING_FULL_CODE && tries < MAX_TRIES) {
          await pause(RETRY_MS);
          continue;
        }
        const refused = this.#refusal(target, error);
        const faulty = this.#batch.filter((each) => concerns(refused.problems, each.patch));
        const left = faulty.length ? this.#batch.filter((each) => !faulty.includes(each)) : [];
        this.#batch.filter((each) => !left.includes(each)).forEach((each) => each.reject(refused));
        this.#batch = left;
      }
    }
  }

  #refusal(target, error) {
    if (![INVALID_PARAMS_CODE, HANDLE_INSIDE_CODE].includes(error.code) || !Array.isArray(error.data)) {
      return new Refused(error.message, []);
    }
    const problems = error.data.map(({ where, problem }) => {
      const path = parsePath(where);
      return { path: path[0] === target || path[0] === "scene" ? path.slice(1) : path, problem };
    });
    return new Refused(error.message, problems);
  }

  async #read(target) {
    const materials = target === "materials";
    const got = await this.#link.call(materials ? "get_materials" : "get_scene");
    const value = materials ? got.materials : target === "objects" ? got.scene.objects : got.scene;
    return { value, revision: got.revision, scene: got.scene };
  }

  // Makes one call, and passes its result to the model at once.
  async #call(target, patch, revision) {
    if (!TARGETS.includes(target)) {
      throw new Error(`no such target: ${target}`);
    }
    this.calls++;
    const expected = revision === undefined ? {} : { expect_revision: revision };
    let result;
    if (target === "scene") {
      result = await this.#setScene(patch, revision);
    } else {
      result = await this.#link.call(`update_${target === "objects" ? "scene" : target}`, { [target]: patch, ...expected });
    }
    this.#model.applied(target, patch, result);
    const detail = { target, patch, warnings: result.warnings ?? [] };
    this.dispatchEvent(new CustomEvent("accepted", { detail }));
    return result;
  }

  // Keys other than objects are changed by sending the complete scene, unless another client changed it meanwhile.
  async #setScene(patch, revision) {
    for (let tries = 0; ; tries++) {
      const got = await this.#read("scene");
      const scene = merged(got.scene, patch);
      try {
        return await this.#link.call("set_scene", { scene, expect_revision: revision ?? got.revision });
      } catch (error) {
        if (error.code !== STALE_REVISION_CODE || revision !== undefined || tries === MAX_TRIES) {
          throw error;
        }
      }
    }
  }
}

// Returns whether a problem concerns a value that a patch sets.
function concerns(problems, patch) {
  return problems.some(({ path }) => {
    const there = at(patch, path);
    return there !== undefined || [...leaves(patch)].some(([leaf, value]) => related(leaf, path) && (leaf.length >= path.length || !isMap(value)));
  });
}
