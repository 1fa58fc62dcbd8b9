// Warnings (`app.warnings`) about parts of the scene that are not displayed as specified, from the daemon's status. Also the
// stability of surfaces, from the margins in the daemon's answers.
//
// The status comes once a second. After a change of this page it is requested at once, with one call under way. Changes of
// other clients come without margins, which are requested with the next status.
import { parsePath } from "./problem_path.js";
import { withUnit } from "./numbers.js";

// Events: `changed`.
export class Warnings extends EventTarget {
  #app;
  #status;
  #unused = {}; // warnings when a material was sent, by material, for those that the scene does not use
  #asking = false;
  #askingMargins = false;
  #again = false;

  constructor(app) {
    super();
    this.#app = app;
    this.#status = app.model.status;
    app.model.addEventListener("status", () => {
      this.#take(app.model.status);
      this.#askMargins();
    });
    app.undo.changes.addEventListener("accepted", ({ detail }) => {
      if (detail.target === "materials") {
        const lines = detail.warnings.map(({ where, problem }) => ({ path: parsePath(where).slice(1), text: problem }));
        for (const name of Object.keys(detail.patch)) {
          this.#unused[name] = lines.filter(({ path }) => path[0] === name);
        }
      }
      this.#ask();
    });
  }

  get status() {
    return this.#status;
  }

  // Returns [{path, text}] for a target: materials, objects or scene; paths begin with the name.
  of(target) {
    const { undisplayable = [], warnings = [] } = this.#status;
    const placed = warnings.map(({ where, problem }) => ({ ...placeOf(parsePath(where)), text: problem }));
    const found = placed.filter((each) => each.target === target);
    if (target !== "materials") {
      return found;
    }
    const used = usedMaterials(this.#app.model.scene);
    const unused = Object.entries(this.#unused).flatMap(([name, lines]) => (used.has(name) ? [] : lines));
    return [...found, ...unused, ...undisplayable.map((mode) => this.#undisplayable(mode))];
  }

  // Returns {kind: ok, warn or plain; text} for the objects that have a material.
  stabilityOf(name) {
    const { margins, scene, materials } = this.#app.model;
    return stabilityOf(margins, scene, materials, name);
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

  async #askMargins() {
    const { model, link } = this.#app;
    if (this.#askingMargins || model.marginsRevision === null || model.marginsRevision === model.revision) {
      return;
    }
    this.#askingMargins = true;
    try {
      model.takeMargins(await link.call("get_scene"));
      this.dispatchEvent(new Event("changed"));
    } catch (error) {
      this.#failed("margins", error);
    } finally {
      this.#askingMargins = false;
    }
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
      this.#failed("status", error);
    } finally {
      this.#asking = false;
    }
  }

  #failed(asked, error) {
    const text = `No ${asked}: ${error.message}`;
    this.#app.view.dispatchEvent(new CustomEvent("notice", { detail: { text, kind: "error" } }));
  }
}

function placeOf(path) {
  if (path[0] === "materials") {
    return { target: "materials", path: path.slice(1) };
  }
  return path[1] === "objects" ? { target: "objects", path: path.slice(2) } : { target: "scene", path: path.slice(1) };
}

// Returns the path of a mode's frequency in a material.
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

// Returns the names of the materials of objects and patches in a scene.
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

// Returns the ids of the objects that have a material, completely or on a patch.
export function objectsOf(scene, name) {
  return Object.entries(scene.objects ?? {})
    .filter(([, object]) => object.material === name || (object.patches ?? []).some((patch) => patch.material === name))
    .map(([id]) => id);
}

// `margins`: by object, the factor by which its stiffness alone may grow; null: unlimited; undefined: not known.
export function stabilityOf(margins, scene, materials, name) {
  const ids = objectsOf(scene, name);
  if (!ids.length) {
    return { kind: "plain", text: "No object of the scene has this material." };
  }
  if (margins === undefined) {
    return { kind: "plain", text: "Stability: not known: device.handle is not given." };
  }
  const found = ids.filter((id) => id in margins).map((id) => [margins[id] ?? Infinity, id]);
  if (!found.length) {
    return { kind: "plain", text: "Stability: not known yet." };
  }
  const [margin, id] = found.reduce((least, each) => (each[0] < least[0] ? each : least));
  const stiffness = materials[name]?.stiffness_n_per_m ?? 0;
  const check = margin < 1 ? " `hapticd check` says what may oscillate, and what to lower." : "";
  return { kind: margin < 1 ? "warn" : "ok", text: `${id}: ${withUnit(stiffness, "N/m", 3)}.${reachText(margin, stiffness)}${check}` };
}

// Returns the text of the largest stiffness.
function reachText(margin, stiffness) {
  if (margin === Infinity) {
    return " No stiffness is too much.";
  }
  if (margin === 0) {
    return " No stiffness is proved to be safe.";
  }
  return ` Limit: ${withUnit(margin * stiffness, "N/m", 3)}, margin ${Number(margin.toPrecision(2))}.`;
}
