// The touched objects, each with its face or side, and marks of contacts, grooves and ruptures, from the daemon's events.
// The topic `state` corrects them after a lost event.
import { SURFACES } from "./geometry.js";
import { Marks } from "./marks.js";
import { Punctures } from "./membranes.js";
import { positionsAround } from "./moments.js";
import { contactPoint, featureOf, surfacePoint } from "./surface_point.js";

const SAMPLE_TIMEOUT_S = 0.5; // time that an event waits for the sample of its tick

// Event: `changed`, when touched objects, marks or holes changed.
export class Contacts extends EventTarget {
  marks = new Marks();
  punctures = new Punctures();
  #touched = new Map(); // id: its feature
  #app;
  #objects;
  #tick = -1; // tick of the last event
  #waiting = []; // events whose samples have not come yet
  #live = true; // false: a recording is shown

  // `objects()` returns the drawn objects by id.
  constructor(app, objects) {
    super();
    this.#app = app;
    this.#objects = objects;
    app.link.addEventListener("event", (event) => {
      this.#waiting.push(event.detail);
      this.#sift();
    });
    app.samples.addEventListener("added", () => this.#sift());
    app.link.addEventListener("state", (event) => {
      this.#sift(event.detail.tick);
      if (this.#live) {
        this.#gotState(event.detail);
      }
    });
    app.link.addEventListener("change", (event) => this.#commanded(event.detail));
  }

  get touching() {
    return [...this.#touched.keys()];
  }

  // Sets the touched objects of a recording that is shown; null: live again.
  show(touching, position) {
    this.#live = touching === null;
    const ids = touching ?? this.#app.model.state?.touching ?? [];
    this.#touched = new Map(ids.map((id) => [id, this.#feature(id, position, position)]));
    this.dispatchEvent(new Event("changed"));
  }

  #feature(id, before, now) {
    const object = this.#objects()[id];
    return object === undefined ? {} : featureOf(object, before, now);
  }

  // An event comes before the sample of its tick, which has its position. Without samples, as on a hidden page, the
  // position of the newest state is used.
  #sift(stateTick = 0) {
    const { samples, model } = this.#app;
    const patience = SAMPLE_TIMEOUT_S * (model.config?.servo?.rate_hz ?? 0);
    while (this.#waiting.length > 0) {
      const { tick } = this.#waiting[0];
      const newest = samples.rows > 0 ? samples.ticks[(samples.rows - 1) % samples.capacity] : -Infinity;
      const coming = newest < tick && newest > tick - patience;
      if (coming && stateTick < tick + patience) {
        return;
      }
      const event = this.#waiting.shift();
      if (this.#live) {
        this.#happened(event);
      }
    }
  }

  #happened(event) {
    const object = this.#objects()[event.object];
    if (object === undefined || !SURFACES.has(object.kind)) {
      this.#touched.delete(event.object);
      return;
    }
    this.#tick = Math.max(this.#tick, event.tick);
    const around = positionsAround(this.#app.samples, event.tick);
    const last = this.#app.model.state?.position_m ?? [0, 0];
    const [before, now] = around ?? [last, last];
    switch (event.event) {
      case "contact": {
        const feature = featureOf(object, before, now);
        this.#touched.set(event.object, feature);
        this.#mark("contact", this.#onSurface(object, feature, now));
        break;
      }
      case "groove":
        this.#mark("groove", this.#onSurface(object, this.#touched.get(event.object) ?? featureOf(object, before, now), now));
        break;
      case "puncture":
        this.punctures.puncture(event.object, object, now);
        this.#touched.delete(event.object);
        this.#mark("rupture", now);
        break;
      case "release":
        this.#touched.delete(event.object);
        if (this.#app.model.materials[object.material]?.rupture?.heals) {
          this.punctures.heal([event.object]);
        }
        break;
      default:
        return;
    }
    this.dispatchEvent(new Event("changed"));
  }

  // Returns the probe's position moved onto the surface, which the probe may have left within the tick of the event.
  #onSurface(object, feature, position) {
    const { normal, depth } = contactPoint(object, feature, position);
    return [position[0] + depth * normal[0], position[1] + depth * normal[1]];
  }

  #mark(kind, point) {
    this.marks.add(kind, point, performance.now());
  }

  // Adopts the servo's list of touched objects, unless events of later ticks have come.
  #gotState(state) {
    if (state.tick < this.#tick) {
      return;
    }
    const ids = new Set(state.touching);
    let changed = false;
    for (const id of this.#touched.keys()) {
      if (!ids.has(id)) {
        this.#touched.delete(id);
        changed = true;
      }
    }
    for (const id of ids) {
      if (!this.#touched.has(id)) {
        this.#touched.set(id, this.#feature(id, state.position_m, state.position_m));
        changed = true;
      }
    }
    if (changed) {
      this.dispatchEvent(new Event("changed"));
    }
  }

  #commanded(change) {
    if (change.reset !== undefined) {
      this.punctures.heal(change.reset.objects ?? null);
      this.dispatchEvent(new Event("changed"));
    }
  }

  // Returns the surface point of a probe at `position`; null if it presses no surface.
  surfacePoint(position) {
    const objects = this.#objects();
    const pressed = [];
    for (const [id, feature] of this.#touched) {
      const object = objects[id];
      if (object !== undefined && SURFACES.has(object.kind) && isKnown(object, feature)) {
        pressed.push(contactPoint(object, feature, position));
      }
    }
    return surfacePoint(position, pressed);
  }
}

// The face or side of a touched object is not valid after the object's kind has changed.
function isKnown(object, feature) {
  return object.kind === "membrane" ? "side" in feature : object.kind === "box" ? "face" in feature : true;
}
