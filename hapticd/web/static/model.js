// Scene, materials and configuration as the daemon has them. Events: `scene` (also for its `display`), `materials` and
// `config` after each change; `status` once a second; `state` with every newest sample; `away` when the daemon does not
// answer; `back` when it answers again.
//
// Changes come by the topic `change` and are applied at once. Everything is requested again only if a change was missed or
// too large to be listed, or if the daemon was restarted; there is at most one request at a time.
import { CallError } from "./connection.js";
import { merged } from "./editor/merge_patch.js";

const LOAD_RETRY_S = 1;

export class Model extends EventTarget {
  scene = { objects: {} };
  materials = {};
  config = {};
  status = {}; // as get_status
  state = null; // the newest sample, 60 times a second
  revision = null;
  margins; // by surface, as in get_scene; undefined: the daemon does not know them
  marginsRevision = null; // the newest revision whose changes are all in `margins`
  away = false;
  #link;
  #loading = null;
  #again = false;
  #during = []; // changes that came while everything was requested

  constructor(link) {
    super();
    this.#link = link;
    link.addEventListener("status", (event) => this.#gotStatus(event.detail));
    link.addEventListener("state", (event) => {
      this.state = event.detail;
      this.dispatchEvent(new Event("state"));
    });
    link.addEventListener("change", (event) => this.#changed(event.detail));
  }

  get rateHz() {
    return this.status.rate_hz ?? this.config.servo?.rate_hz ?? 10000;
  }

  // Requests everything, again after a failure, and resolves when it has come.
  load() {
    if (this.#loading !== null) {
      this.#again = true;
      return this.#loading;
    }
    this.#loading = this.#loadUntilWhole().finally(() => (this.#loading = null));
    return this.#loading;
  }

  async #loadUntilWhole() {
    do {
      this.#again = false;
      this.#during = [];
      try {
        await this.#loadOnce();
      } catch (error) {
        if (!(error instanceof CallError)) {
          throw error;
        }
        this.#isAway(true, error.message);
        await new Promise((resolve) => setTimeout(resolve, 1e3 * LOAD_RETRY_S));
        this.#again = true;
      }
    } while (this.#again);
  }

  async #loadOnce() {
    const call = (method) => this.#link.call(method);
    const methods = ["get_status", "get_scene", "get_materials", "get_config"];
    const [status, scene, materials, config] = await Promise.all(methods.map(call));
    this.#isAway(false);
    if (scene.revision !== materials.revision) {
      this.#again = true; // something changed between the two answers
      return;
    }
    // A status has histograms only if it came as telemetry.
    this.status = { ...(this.status.started_ns === status.started_ns ? this.status : {}), ...status };
    this.scene = scene.scene;
    this.materials = materials.materials;
    this.config = config.config;
    this.revision = scene.revision;
    this.takeMargins(scene);
    for (const name of ["config", "status", "materials", "scene"]) {
      this.dispatchEvent(new Event(name));
    }
    const during = this.#during;
    this.#during = null;
    during.forEach((change) => this.#changed(change));
  }

  #gotStatus(status) {
    const another = this.status.started_ns !== undefined && status.started_ns !== this.status.started_ns;
    this.status = status;
    this.#isAway(false);
    this.dispatchEvent(new Event("status"));
    // A status from before the newest change is outdated.
    if (another || this.revision === null || status.revision > this.revision) {
      this.load();
    }
  }

  // The answer of get_scene has the margins of all surfaces.
  takeMargins({ margins, revision }) {
    this.margins = margins;
    this.marginsRevision = revision;
  }

  // Applies a change by a call of this page: a merge patch of `materials`, `objects` or `scene`, and its answer. The topic
  // `change` brings the same change a little later in canonical form, but without margins.
  applied(target, patch, { revision, margins }) {
    if (revision === this.marginsRevision + 1) {
      this.margins = margins && { ...this.margins, ...margins };
      this.marginsRevision = revision;
    }
    const removed = target === "materials" && Object.values(patch).includes(null); // a shipped material may be restored
    if (this.#loading !== null || revision !== this.revision + 1 || removed) {
      return;
    }
    this.revision = revision;
    if (target === "materials") {
      this.materials = merged(this.materials, patch);
    } else {
      this.scene = merged(this.scene, target === "objects" ? { objects: patch } : patch);
    }
    this.dispatchEvent(new Event(target === "materials" ? "materials" : "scene"));
  }

  #changed(change) {
    if (this.#loading !== null && this.#during !== null) {
      this.#during.push(change);
      return;
    }
    if (change.revision === undefined || this.revision === null || change.revision < this.revision) {
      return; // a change by play or reset, or one that is already loaded
    }
    if (change.large || change.revision > this.revision + 1) {
      this.load();
      return;
    }
    this.revision = change.revision;
    const merge = (target, changes) => {
      const result = { ...target };
      for (const [name, value] of Object.entries(changes)) {
        if (value === null) {
          delete result[name];
        } else {
          result[name] = value;
        }
      }
      return result;
    };
    if (change.materials) {
      this.materials = merge(this.materials, change.materials);
      this.dispatchEvent(new Event("materials"));
    }
    if (change.objects || change.scene) {
      this.scene = { ...this.scene, ...change.scene, objects: merge(this.scene.objects, change.objects ?? {}) };
      this.dispatchEvent(new Event("scene"));
    }
  }

  #isAway(away, problem = "") {
    if (away !== this.away) {
      this.away = away;
      this.dispatchEvent(new CustomEvent(away ? "away" : "back", { detail: { problem } }));
    }
  }
}
