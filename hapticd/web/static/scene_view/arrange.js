// Arranging: selecting, moving, turning, sizing and deleting objects with the pointer or the keyboard. Changes of a drag are
// shown at once and sent by updates.js; a complete drag is one step of undo.
import { lengthOf, minus, pick } from "./geometry.js";
import { dragged, gripsOf, isMovable, isTurnable, moved, turned } from "./grips.js";

const GRIP_REACH_PX = 13;
const PICK_REACH_PX = 8;

// Event: `selected`, when another object or none is selected.
export class Arrange extends EventTarget {
  selected = null; // an id
  #app;
  #view;
  #drag = null;

  // `view`: {transform, objects, updates, chips, canArrange}; `chips` are the labels of fields without a place.
  constructor(app, view) {
    super();
    this.#app = app;
    this.#view = view;
    app.view.addEventListener("select", (event) => this.#take(event.detail.id));
  }

  get object() {
    return this.#view.objects[this.selected] ?? null;
  }

  // Whether an object is selected that may be changed.
  get #free() {
    return this.object !== null && this.#view.canArrange;
  }

  #take(id) {
    const known = id !== null && id in this.#view.objects ? id : null;
    if (known !== this.selected) {
      this.selected = known;
      this.dispatchEvent(new Event("selected"));
    }
  }

  // Selects an object for all modules of the page.
  select(id) {
    this.#app.view.dispatchEvent(new CustomEvent("select", { detail: { id } }));
  }

  // Returns what is at a place on the canvas: {grip} of the selected object, {id}, or {}.
  at(px) {
    const { transform, objects, chips } = this.#view;
    if (this.object !== null) {
      for (const grip of gripsOf(this.object, transform.pxPerM)) {
        if (lengthOf(minus(transform.toPx(grip.point), px)) <= GRIP_REACH_PX) {
          return { id: this.selected, grip: grip.name };
        }
      }
    }
    const chip = chips.find(([, [left, top, right, bottom]]) =>
      px[0] >= left && px[0] <= right && px[1] >= top && px[1] <= bottom);
    const id = chip?.[0] ?? pick(objects, transform.toM(px), PICK_REACH_PX / transform.pxPerM);
    return id === null ? {} : { id };
  }

  // Called when the pointer is pressed; returns false if nothing is there, so that the view is panned.
  begin(px) {
    const { id, grip } = this.at(px);
    this.select(id ?? null);
    if (id === undefined) {
      return false;
    }
    const object = this.#view.objects[id];
    if (this.#view.canArrange && (grip !== undefined || isMovable(object))) {
      this.#drag = { id, grip, object, from: this.#view.transform.toM(px), fromPx: px, patch: null };
    }
    return true;
  }

  drag(px, snap) {
    const drag = this.#drag;
    if (drag === null || (drag.patch === null && lengthOf(minus(px, drag.fromPx)) < 3)) {
      return; // a click, not a drag
    }
    const to = this.#view.transform.toM(px);
    drag.patch = drag.grip === undefined
      ? moved(drag.object, minus(to, drag.from), snap)
      : dragged(drag.object, drag.grip, drag.from, to, snap);
    this.#view.updates.send(drag.id, drag.patch);
  }

  end() {
    const drag = this.#drag;
    this.#drag = null;
    if (drag?.patch) {
      this.#note(drag.grip === undefined ? "move" : drag.grip === "turn" ? "turn" : "size", drag.id, drag.object, drag.patch);
    }
  }

  // Cancels the drag.
  cancel() {
    const drag = this.#drag;
    this.#drag = null;
    if (drag?.patch) {
      this.#view.updates.send(drag.id, before(drag.object, drag.patch));
    }
  }

  moveBy(delta, snap) {
    if (this.#free && isMovable(this.object)) {
      this.#change("move", moved(this.object, delta, snap), "keys");
    }
  }

  turnBy(angle) {
    if (this.#free && isTurnable(this.object)) {
      this.#change("turn", turned(this.object, angle), "keys");
    }
  }

  remove() {
    const [id, object] = [this.selected, this.object];
    if (this.#free) {
      this.select(null);
      this.#view.updates.send(id, null);
      this.#app.undo?.note(`delete ${id}`, { objects: { [id]: null } }, { objects: { [id]: object } });
    }
  }

  #change(word, patch, join) {
    const [id, object] = [this.selected, this.object];
    this.#view.updates.send(id, patch);
    this.#note(word, id, object, patch, `${join} ${word} ${id}`);
  }

  #note(word, id, object, patch, join = null) {
    const backward = { objects: { [id]: before(object, patch) } };
    this.#app.undo?.note(`${word} ${id}`, { objects: { [id]: patch } }, backward, join);
  }
}

// Returns the patch that undoes another one.
function before(object, patch) {
  return Object.fromEntries(Object.keys(patch).map((key) => [key, object[key] ?? null]));
}

// Draws the grips and the outline of the selected object over the picture.
export function drawSelection(ctx, transform, object, outline, colours) {
  ctx.save();
  ctx.strokeStyle = colours.accent;
  ctx.lineWidth = 2;
  ctx.setLineDash([5, 4]);
  outline(ctx);
  ctx.stroke();
  ctx.setLineDash([]);
  for (const { name, point } of gripsOf(object, transform.pxPerM)) {
    const [x, y] = transform.toPx(point);
    ctx.beginPath();
    if (name === "turn") {
      ctx.arc(x, y, 7, 0, 2 * Math.PI);
    } else {
      ctx.rect(x - 6, y - 6, 12, 12);
    }
    ctx.fillStyle = colours.ground;
    ctx.fill();
    ctx.lineWidth = 2;
    ctx.stroke();
    if (name === "turn") {
      ctx.beginPath();
      ctx.arc(x, y, 3, 0.3, 5);
      ctx.lineWidth = 1.5;
      ctx.stroke();
    }
  }
  ctx.restore();
}
