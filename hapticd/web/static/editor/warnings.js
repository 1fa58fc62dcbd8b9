// What of the scene is displayed otherwise than it was meant, and how stable it is: `app.warnings`, from the daemon's status.
//
// The status comes once a second. After a change of this page it is asked for at once, one call under way.
import { parsePath } from "./problem_path.js";
import { withUnit } from "./numbers.js";

const MOST_OBJECTS = 3;

// Events: `changed`.
export class Warnings extends EventTarget {
  #app;
  #status;
  #told = {}; // by material: what the daemon said when it was sent, for those that the scene does not use
  #asking = false;
  #again = false;

  constructor(app) {
    super();
    this.#app = app;
    this.#status = app.model.status;
    app.model.addEventListener("status", () => this.#take(app.model.status));
    app.undo.changes.addEventListener("taken", ({ detail }) => {
      if (detail.target === "materials") {
        const lines = detail.warnings.map(({ where, problem }) => ({ path: parsePath(where).slice(1), text: problem }));
        for (const name of Object.keys(detail.patch)) {
          this.#told[name] = lines.filter(({ path }) => path[0] === name);
        }
      }
      this.#ask();
    });
  }

  get status() {
    return this.#status;
  }

  // [{path, text}] of a target: materials, objects or scene; paths begin with the name.
  of(target) {
    const { undisplayable = [], warnings = [] } = this.#status;
    const placed = warnings.map(({ where, problem }) => ({ ...placeOf(parsePath(where)), text: problem }));
    const found = placed.filter((each) => each.target === target);
    if (target !== "materials") {
      return found;
    }
    const used = usedMaterials(this.#app.model.scene);
    const told = Object.entries(this.#told).flatMap(([name, lines]) => (used.has(name) ? [] : lines));
    return [...found, ...told, ...undisplayable.map((mode) => this.#undisplayable(mode))];
  }

  // {kind: ok, warn, bad or plain; text} of the objects that have a material.
  stabilityOf(name) {
    return stabilityOf(this.#status.stability, this.#app.model.scene, name);
  }

  #undisplayable({ material, mode, frequency_hz: frequency, shown_hz: shown }) {
    const path = [material, ...modePath(this.#app.model.materials[material] ?? {}, mode)];
    const high = `${withUnit(frequency, "Hz")} is too high for a rate of ${withUnit(this.#status.rate_hz ?? 0, "Hz")}`;
    return { path, text: shown === null ? `${high}: it is silent.` : `${high}: it is shown as ${withUnit(shown, "Hz")}.` };
  }

  #take(status) {
    this.#status = status;
    this.dispatchEvent(new Event("changed"));
  }

  async #ask() {
    if (this.#asking) {
      this.#again = true;
      return;
    }
    this.#asking = true;
    try {
      do {
        this.#again = false;
        this.#take({ ...this.#status, ...(await this.#app.link.call("get_status")) });
      } while (this.#again);
    } catch (error) {
      this.#app.view.dispatchEvent(new CustomEvent("notice", { detail: { text: `No status: ${error.message}`, kind: "error" } }));
    } finally {
      this.#asking = false;
    }
  }
}

function placeOf(path) {
  if (path[0] === "materials") {
    return { target: "materials", path: path.slice(1) };
  }
  return path[1] === "objects" ? { target: "objects", path: path.slice(2) } : { target: "scene", path: path.slice(1) };
}

// Where in a material the frequency of a mode stands.
export function modePath(material, mode) {
  const block = { tap: ["tap"], second: ["tap", "second"], rupture: ["rupture"], texture: ["texture"] }[mode];
  const own = (keys, within) => keys.find((key) => key in (within ?? {}));
  const keys = ["frequency_hz", "angular_frequency_rad_per_s", "mode_table", "frequency_table", "waveform", "peak_hz"];
  if (mode === "groove") {
    const key = own(keys, material.texture);
    return key === undefined ? ["tap", own(keys, material.tap) ?? "frequency_hz"] : ["texture", key];
  }
  const within = mode === "second" ? material.tap?.second : material[block[0]];
  const key = own(keys, within);
  return key === undefined ? block : [...block, key];
}

// Names of the materials that objects and patches of a scene have.
export function usedMaterials(scene) {
  const used = new Set();
  for (const object of Object.values(scene.objects ?? {})) {
    if (object.material !== undefined) {
      used.add(object.material);
    }
    (object.patches ?? []).forEach((patch) => used.add(patch.material));
  }
  return used;
}

// Ids of the objects that have a material, on a patch or all over.
export function objectsOf(scene, name) {
  return Object.entries(scene.objects ?? {})
    .filter(([, object]) => object.material === name || (object.patches ?? []).some((patch) => patch.material === name))
    .map(([id]) => id);
}

export function stabilityOf(stability, scene, name) {
  const ids = objectsOf(scene, name);
  if (!ids.length) {
    return { kind: "plain", text: "No object of the scene has this material." };
  }
  if (!stability) {
    return { kind: "plain", text: "Stability: not known yet." };
  }
  if (stability.unknown !== null) {
    return { kind: "plain", text: `Stability: not known: ${stability.unknown}` };
  }
  const set = stability.worst.find(({ objects }) => objects.some((id) => ids.includes(id)));
  if (set === undefined) {
    const safe = stability.worst.every(({ safe }) => safe) || stability.unsafe < stability.worst.length;
    return { kind: safe ? "ok" : "plain", text: `Not among the ${stability.worst.length} least stable groups of objects.` };
  }
  return { kind: { safe: "ok", unproved: "warn", unsafe: "bad" }[set.verdict], text: setText(set) };
}

function setText({ objects, stiffness_n_per_m: stiffness, margin, limit_n_per_m: limit, verdict, remedy }) {
  const names = objects.slice(0, MOST_OBJECTS).join(", ") + (objects.length > MOST_OBJECTS ? ` and ${objects.length - MOST_OBJECTS} more` : "");
  const which = `${names}${objects.length > 1 ? " together" : ""}: ${withUnit(stiffness, "N/m", 3)}.`;
  const held = verdict === "unproved" ? " In the hand that is set up it is stable." : "";
  const help = remedy ? ` To be safe: ${remedy.replace(/_(n_per_m|m)\b/g, "").replace(/\.$/, "")}.` : "";
  return `${which}${reachText(margin, limit, remedy)}${held}${help}`;
}

// How stiff it might be; empty where the remedy alone says it.
function reachText(margin, limit, remedy) {
  if (margin === null) {
    return " No stiffness is too much.";
  }
  if (limit > 0) {
    return ` Limit: ${withUnit(limit, "N/m", 3)}, margin ${Number(margin.toPrecision(2))}.`;
  }
  return remedy ? "" : " No stiffness is proved to be safe.";
}
