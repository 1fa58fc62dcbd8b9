// The scene: objects, handle, hand and forces on a canvas, to scale. Mouse, touch, keyboard and gamepad move the hand of the
// simulated joystick or arrange objects. scene_view/picture.js draws; contacts.js shows events.
//
// It sets `app.scene`: {mode, setMode, fit, hand, transform, picture}, and listens to `select` and `playback` of app.view.
// `playback` {state, touching} shows a moment of a recording (playback.js), a map as in the topic `state`, in the recorded
// scene; {state: null} shows the present again.
import { make } from "./dom.js";
import { onTheme } from "./theme.js";
import { Arrange } from "./scene_view/arrange.js";
import { Contacts } from "./scene_view/contacts.js";
import { Description } from "./scene_view/description.js";
import { GamepadHand } from "./scene_view/gamepad.js";
import { EDGE_BOTTOM_PX, EDGE_LEFT_PX } from "./scene_view/grid.js";
import { extentOf } from "./scene_view/geometry.js";
import { isTurnable } from "./scene_view/grips.js";
import { Hand } from "./scene_view/hand.js";
import { KEY_HELP, listenToKeys } from "./scene_view/keys.js";
import { momentOf, Moments } from "./scene_view/moments.js";
import { Picture } from "./scene_view/picture.js";
import { Pointers } from "./scene_view/pointers.js";
import { legend, toolbar } from "./scene_view/toolbar.js";
import { Transform } from "./scene_view/transform.js";
import { Updates } from "./scene_view/updates.js";

const MARGIN = { left: EDGE_LEFT_PX + 6, right: 10, top: 10, bottom: EDGE_BOTTOM_PX + 8 };

export function mount(app, element) {
  const view = new SceneView(app, element);
  app.scene = view;
  view.begin();
}

class SceneView {
  mode = "feel";
  transform = new Transform();
  objects = {};
  #app;
  #fitted = "objects"; // what the view shows completely at any size of the canvas; null: the user moved the view
  #drawnKey = ""; // key of the last drawn moment

  constructor(app, element) {
    this.#app = app;
    this.updates = new Updates((objects) => app.link.call("update_scene", { objects }));
    this.moments = new Moments(app);
    this.contacts = new Contacts(app, () => this.objects);
    this.hand = new Hand((message) => app.link.notify("stream_target", message));
    this.arrange = new Arrange(app, this);
    this.#build(element);
    this.picture = new Picture(this.canvas, this);
    this.#listen();
  }

  // ---- Methods that the parts call ----

  get chips() {
    return this.picture.chips;
  }

  get selected() {
    return this.arrange.selected;
  }

  get materials() {
    return this.#app.model.materials;
  }

  get #device() {
    return this.#app.model.config.device ?? {};
  }

  // The workspace of the handle: [left, bottom, right, top], in m.
  get workspace() {
    const half = this.#device.kind === "sim" ? this.#device.sim?.workspace_m : this.#device.hid?.travel_m;
    return half === undefined ? null : [-half, -half, half, half];
  }

  // Null: the configuration is not known.
  get limitN() {
    return this.#device.max_force_n ?? null;
  }

  // Whether this page can move the hand: that of the simulated joystick, and not of a recording.
  get canFeel() {
    return this.#device.kind === "sim" && this.moments.playback === null;
  }

  // Whether objects may be changed: not while a recording is shown.
  get canArrange() {
    return this.moments.playback === null;
  }

  setMode(mode) {
    this.mode = mode;
    this.hand.releaseAll();
    delete this.canvas.dataset.over;
    this.#show();
    this.picture.draw();
  }

  zoom(factor) {
    this.transform.zoom(factor, [this.transform.width / 2, this.transform.height / 2]);
    this.viewed();
  }

  // Fits all "objects" and the handle, or the complete "workspace", into the view.
  fit(what) {
    this.#fitted = what;
    const workspace = what === "workspace" ? this.workspace : null;
    this.transform.fit(workspace ?? extentOf(this.objects, [this.#handle], 0.01), MARGIN);
    this.picture.refresh();
  }

  // The view was moved or zoomed.
  viewed() {
    this.#fitted = null;
    this.picture.refresh();
  }

  // Sets the cursor for what the pointer does now.
  touched(use) {
    this.canvas.dataset.use = use ?? "";
    this.picture.draw();
  }

  hover(px) {
    const found = this.arrange.at(px);
    this.canvas.dataset.over = found.grip ? "grip" : found.id !== undefined ? "object" : "nothing";
  }

  takeHand(px) {
    this.hand.take("pointer", this.#handle, this.transform.toM(px));
    this.#ready();
  }

  stepHand(delta, speed) {
    this.hand.step(delta, this.#handle, speed);
    this.#ready();
  }

  heal() {
    this.#try(this.#app.link.call("reset", { objects: this.contacts.punctures.ids }));
  }

  // A frame was drawn.
  drawn(moment) {
    this.#app.timing.drew(this.#app.samples.rows - 1);
    this.#description.update(moment, this.contacts.touching);
  }

  // ---- Private ----

  #description;
  #tools;
  #legend;

  get #handle() {
    return this.moments.newest?.position ?? [0, 0];
  }

  // The page that moves the hand needs control of the forces: it takes the lease if it does not have it. If it cannot,
  // safety.js shows why, and the page releases the hand.
  async #ready() {
    if (!(await this.#app.safety.begin())) {
      this.hand.releaseAll();
      this.hand.forget();
    }
  }

  async #try(promise) {
    try {
      await promise;
    } catch (error) {
      this.#notice(error.message);
    }
  }

  #notice(text) {
    this.#app.view.dispatchEvent(new CustomEvent("notice", { detail: { text, kind: "error" } }));
  }

  #build(element) {
    this.#tools = toolbar(this);
    this.#legend = legend();
    const spokenAs = { role: "application", "aria-label": "Scene", "aria-describedby": "scene-keys" };
    this.canvas = make("canvas", { class: "scene-canvas", tabindex: 0, ...spokenAs });
    const keys = make("p", { id: "scene-keys", class: "visually-hidden", text: KEY_HELP });
    const figures = make("p", { class: "scene-figures", "aria-hidden": "true" });
    const spoken = make("p", { class: "visually-hidden", role: "status", "aria-label": "State of the scene" });
    element.append(
      this.#tools.element,
      make("div", { class: "view-body" }, this.canvas, keys),
      make("div", { class: "view-foot scene-foot" }, figures, spoken, this.#legend.element),
    );
    this.#description = new Description(figures, spoken);
  }

  #listen() {
    const { link, model, safety, samples, view } = this.#app;
    new Pointers(this.canvas, this);
    listenToKeys(this.canvas, this);
    new GamepadHand(
      this.hand, () => this.#handle, () => this.mode === "feel" && this.canFeel && !document.hidden, () => this.#ready(),
    );
    model.addEventListener("scene", () => {
      this.updates.arrived(model.revision);
      this.#changed();
    });
    model.addEventListener("materials", () => this.picture.refresh());
    this.updates.addEventListener("changed", () => this.#changed());
    this.updates.addEventListener("refused", (event) => this.#notice(event.detail.message));
    this.contacts.addEventListener("changed", () => {
      this.#show();
      this.picture.draw();
    });
    this.arrange.addEventListener("selected", () => {
      this.#show();
      this.picture.draw();
    });
    this.hand.addEventListener("moved", () => {
      this.#movedTick = this.moments.newest?.tick ?? this.#movedTick;
      this.picture.draw();
    });
    safety.addEventListener("change", () => this.hand.allow(safety.holds));
    this.hand.allow(safety.holds);
    samples.addEventListener("added", () => this.#arrived());
    link.addEventListener("state", () => this.#arrived());
    for (const name of ["playback", "moment"]) {
      view.addEventListener(name, (event) => this.#played(event.detail));
    }
    onTheme(() => this.picture.recolour());
    new ResizeObserver(() => this.#resized()).observe(this.canvas);
    model.addEventListener("status", () => this.#handTaken());
  }

  begin() {
    this.#changed();
    this.#resized();
  }

  #resized() {
    this.picture.resize();
    if (this.#fitted !== null) {
      this.fit(this.#fitted);
    }
    this.picture.drawAtOnce();
  }

  // The scene, with changes that are not confirmed yet.
  #changed() {
    const { model, playback } = this.#app;
    this.objects = playback.active ? playback.scene.objects : this.updates.over(model.scene.objects);
    this.contacts.punctures.keepOnly(this.objects);
    this.hand.limits = this.workspace;
    this.#legend.limit(this.limitN);
    if (this.selected !== null && !(this.selected in this.objects)) {
      this.arrange.select(null);
    }
    this.#show();
    this.picture.refresh();
  }

  #show() {
    this.#tools.show({
      mode: this.mode,
      canFeel: this.canFeel,
      objects: this.objects,
      selected: this.selected,
      turnable: this.arrange.object !== null && isTurnable(this.arrange.object),
      punctured: this.contacts.punctures.ids.length > 0,
    });
  }

  // Draws new samples if they differ visibly from the last drawn moment.
  #arrived() {
    const moment = this.moments.newest;
    if (moment === null || this.moments.playback !== null) {
      return;
    }
    const px = this.transform.toPx(moment.position).map((value) => Math.round(value * 4));
    const forces = [...moment.contact, ...moment.force, ...moment.vibration].map((value) => Math.round(value * 100));
    const looks = [...px, ...forces, moment.flags].join();
    if (looks !== this.#drawnKey) {
      this.#drawnKey = looks;
      this.picture.draw();
    }
  }

  // Forgets the hand's position if `set_operator` moved it after this page did. Called with the status, once a second.
  #handTaken() {
    const { operator } = this.#app.model.status;
    if (operator && operator.started_tick !== null && operator.started_tick !== this.#operatorTick) {
      this.#operatorTick = operator.started_tick;
      const restarted = (this.moments.newest?.tick ?? 0) < this.#movedTick; // a daemon begins at tick 0
      if (restarted || operator.started_tick > this.#movedTick) {
        this.hand.forget();
      }
    }
  }

  #operatorTick = null;
  #movedTick = -1; // newest tick when this page last moved the hand
  #sceneShown = null; // the scene of the recording that was drawn last; the present one if none is open

  #played({ state, touching }) {
    this.moments.playback = state === null ? null : momentOf(state);
    const { model, playback } = this.#app;
    const shown = playback.active ? playback.scene : model.scene;
    if (shown !== this.#sceneShown) {
      this.#sceneShown = shown;
      this.#changed();
    }
    this.hand.releaseAll();
    this.contacts.marks.clear();
    this.contacts.show(state === null ? null : (touching ?? []), this.#handle);
    this.#show();
    this.picture.draw();
  }
}
