// The keyboard on the canvas. In Feel mode the arrow keys move the hand, in Arrange mode the selected object; with Ctrl, or
// if there is nothing to move, they move the view.
import { TURN_RAD } from "./grips.js";

const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
const PAN_PX = 40;
// Length of a step, in m, and speed of the hand, in m/s: FINE_STEP with Alt, FAST_STEP with Shift, NORMAL_STEP without them.
const FINE_STEP = [0.0001, 0.02];
const NORMAL_STEP = [0.001, 0.06];
const FAST_STEP = [0.005, 0.25];

export const KEY_HELP =
  "Arrow keys move the hand by 1 mm, with Shift by 5 mm, with Alt by 0.1 mm. In Arrange mode they move the selected " +
  "object, [ and ] turn it, Delete deletes it. Ctrl and arrow keys move the view, plus and minus zoom, 0 shows all " +
  "objects, 9 the workspace.";

export function stepOf(event) {
  return event.shiftKey ? FAST_STEP : event.altKey ? FINE_STEP : NORMAL_STEP;
}

// `view`: {mode, canFeel, transform, arrange, stepHand(delta, speed), viewed(), fit(what), zoom(factor)}
export function listenToKeys(canvas, view) {
  canvas.addEventListener("keydown", (event) => {
    if (key(event, view)) {
      event.preventDefault();
    }
  });
}

function key(event, view) {
  const arrow = ARROWS[event.key];
  if (arrow !== undefined) {
    return arrows(event, arrow, view);
  }
  if (event.ctrlKey || event.metaKey || event.altKey) {
    return false;
  }
  switch (event.key) {
    case "+":
    case "=":
      view.zoom(1.25);
      return true;
    case "-":
      view.zoom(0.8);
      return true;
    case "0":
      view.fit("objects");
      return true;
    case "9":
      view.fit("workspace");
      return true;
    default:
      return view.mode === "arrange" && arranging(event, view.arrange);
  }
}

function arrows(event, [dx, dy], view) {
  if (event.metaKey) {
    return false;
  }
  const [length, speed] = stepOf(event);
  const step = [dx * length, dy * length];
  if (!event.ctrlKey && view.mode === "feel" && view.canFeel) {
    view.stepHand(step, speed);
  } else if (!event.ctrlKey && view.mode === "arrange" && view.arrange.object !== null) {
    view.arrange.moveBy(step, false);
  } else {
    view.transform.pan(-dx * PAN_PX, dy * PAN_PX);
    view.viewed();
  }
  return true;
}

function arranging(event, arrange) {
  switch (event.key) {
    case "Delete":
    case "Backspace":
      arrange.remove();
      return true;
    case "[":
      arrange.turnBy(TURN_RAD);
      return true;
    case "]":
      arrange.turnBy(-TURN_RAD);
      return true;
    case "Escape":
      if (arrange.selected === null) {
        return false; // left to the stop of the forces
      }
      arrange.select(null);
      return true;
    default:
      return false;
  }
}
