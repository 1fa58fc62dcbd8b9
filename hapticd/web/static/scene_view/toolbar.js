// The buttons above the canvas: Feel or Arrange, actions on the selected object, zoom; and the legend below it.
import { button, make } from "../dom.js";
import { TURN_RAD } from "./grips.js";

const named = (text, name, call) => button(text, "small", call, { "aria-label": name, title: name });
const group = (classes, label, ...children) => make("div", { class: classes, role: "group", "aria-label": label }, ...children);

// `view`: {setMode, arrange, zoom, fit, heal}. Returns {element, show}.
export function toolbar(view) {
  const feel = named("Feel", "Feel: the pointer is the hand", () => view.setMode("feel"));
  const arrange = named("Arrange", "Arrange: the pointer moves objects", () => view.setMode("arrange"));
  const modes = group("toolbar segmented", "Pointer mode", feel, arrange);

  const pick = () => view.arrange.select(picked.value === "" ? null : picked.value);
  const picked = make("select", { class: "select scene-picked", "aria-label": "Selected object", on: { change: pick } });
  const left = named("↺", "Turn left by 5 degrees", () => view.arrange.turnBy(TURN_RAD));
  const right = named("↻", "Turn right by 5 degrees", () => view.arrange.turnBy(-TURN_RAD));
  const remove = named("Delete", "Delete the selected object", () => view.arrange.remove());
  const arranging = group("row scene-arranging", "Selected object", picked, left, right, remove);

  const heal = button("Heal membranes", "small", () => view.heal());
  const zooming = group(
    "row scene-zoom", "View",
    named("−", "Zoom out", () => view.zoom(0.8)),
    named("+", "Zoom in", () => view.zoom(1.25)),
    named("Objects", "Show all objects", () => view.fit("objects")),
    named("Workspace", "Show the complete workspace", () => view.fit("workspace")),
  );
  const spacer = make("span", { class: "spacer" });
  const element = make("div", { class: "toolbar scene-toolbar" }, modes, arranging, heal, spacer, zooming);

  // Enables the buttons that can be used now.
  const show = ({ mode, canFeel, objects, selected, turnable, punctured }) => {
    feel.setAttribute("aria-pressed", String(mode === "feel"));
    arrange.setAttribute("aria-pressed", String(mode === "arrange"));
    feel.textContent = canFeel ? "Feel" : "Watch";
    arranging.hidden = mode !== "arrange";
    const ids = Object.keys(objects).slice(0, 1000);
    if (picked.dataset.ids !== ids.join("\n")) {
      picked.dataset.ids = ids.join("\n");
      picked.replaceChildren(new Option("Select an object", ""), ...ids.map((id) => new Option(id, id)));
    }
    picked.value = selected ?? "";
    left.disabled = right.disabled = !turnable;
    remove.disabled = selected === null;
    heal.hidden = !punctured;
  };
  return { element, show };
}

const LEGEND = [
  ["handle", "Handle"], ["surface-point", "Surface point"], ["hand", "Hand"], ["contact", "Contact force"],
  ["vibration", "Vibration"], ["force", "Sum"], ["limit", "Limit"],
];

// Makes the legend of the canvas. Returns {element, limit}: `limit` shows the force limit; null: it is not known.
export function legend() {
  const texts = Object.fromEntries(LEGEND.map(([sign, text]) => [sign, document.createTextNode(text)]));
  const items = LEGEND.map(([sign]) => {
    const swatch = make("span", { class: `scene-sign ${sign}`, "aria-hidden": "true" });
    return make("li", {}, swatch, texts[sign]);
  });
  const element = make("ul", { class: "scene-legend", "aria-label": "Legend" }, ...items);
  return { element, limit: (newtons) => {
    items.at(-1).hidden = newtons === null;
    texts.limit.data = newtons === null ? "" : `Limit ${+newtons.toPrecision(3)} N`;
  } };
}
