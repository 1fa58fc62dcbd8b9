// Buttons with which the simulated hand tries a material, and that play its mode without a contact.
import { button, make } from "../dom.js";
import { playOf, punctureGesture, spotOf, strokeGesture, tapGesture } from "./try_it.js";

export function tryCard(app) {
  let name = null;
  let pressed = 0;
  const says = make("p", { class: "note", role: "status" });
  const buttons = {
    tap: button("Tap", "small", () => gesture(tapGesture)),
    stroke: button("Stroke", "small", () => gesture(strokeGesture)),
    puncture: button("Puncture", "small", () => gesture(punctureGesture)),
    play: button("Play the mode", "small", play),
  };

  // Returns null, or why the hand cannot try the material.
  function missing() {
    if (app.model.config.device && app.model.config.device.kind !== "sim") {
      return "This device has no simulated hand: try the material with the joystick.";
    }
    return spotOf(app.model.scene, name) === null ? "No object has this material: give it to one under Objects to feel it." : null;
  }

  // Shows the result of the button that was pressed last, in whatever order the answers come.
  async function call(method, params, done) {
    const own = ++pressed;
    const say = (text) => {
      if (own === pressed) {
        says.textContent = text;
      }
    };
    try {
      await app.link.call(method, params);
      say(done);
    } catch (error) {
      say(error.message);
      return false;
    }
    return true;
  }

  async function gesture(make_) {
    const spot = spotOf(app.model.scene, name);
    const params = make_(spot);
    const message = `The hand ${{ tap: "taps", stroke: "strokes", puncture: "punctures" }[params.gesture.kind]} ${spot.object}.`;
    if (make_ !== punctureGesture || (await call("reset", { objects: [spot.object] }, "The membrane is healed."))) {
      await call("set_operator", params, message);
    }
  }

  function play() {
    return call("play", playOf(name, app.model.materials[name]), `Plays the mode of ${name}.`);
  }

  function follow() {
    const material = app.model.materials[name];
    if (material === undefined) {
      return;
    }
    const why = missing();
    const spot = why === null ? spotOf(app.model.scene, name) : null;
    const membrane = app.model.scene.objects[spot?.object]?.kind === "membrane";
    buttons.tap.disabled = buttons.stroke.disabled = why !== null;
    buttons.puncture.hidden = !(material.rupture && membrane);
    buttons.play.hidden = playOf(name, material) === null;
    for (const each of [buttons.tap, buttons.stroke]) {
      each.title = why ?? `On ${spot.object}`;
    }
    if (why !== null) {
      says.textContent = why;
    }
  }
  app.model.addEventListener("materials", follow);
  app.model.addEventListener("scene", follow);
  const element = make("section", { class: "card", "aria-label": "Try the material" }, make("div", { class: "toolbar" }, make("h3", { text: "Try it" }), ...Object.values(buttons)), says);
  return {
    element,
    show(chosen) {
      name = chosen;
      pressed++;
      says.textContent = "";
      follow();
    },
  };
}
