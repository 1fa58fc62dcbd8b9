// Moving, turning and sizing objects: the grips of an object, and the merge patches that dragging one gives. Pure functions.
import { along, frameOf, global, local, minus } from "./geometry.js";

const STEP_M = 0.001; // step of snapping
export const TURN_RAD = Math.PI / 36; // step of turning: 5 degrees
const MIN_SIZE_M = 0.0005;
const KNOB_PX = 34;

const snapped = (value, step) => Math.round(value / step) * step;
// Removes rounding errors, as in 0.012000000000000002.
const tidy = (value) => +value.toPrecision(9);
const tidyPoint = (point) => point.map(tidy);

const PLACE_KEYS = { wall: "point_m", box: "center_m", disc: "center_m", membrane: "center_m", spring: "center_m" };

export const isMovable = (object) => object.kind in PLACE_KEYS;
export const isTurnable = (object) => ["wall", "box", "membrane"].includes(object.kind);

// Moves an object by `delta`; `snap`: to integer millimetres.
export function moved(object, delta, snap = false) {
  const key = PLACE_KEYS[object.kind];
  let point = along(object[key], delta, 1);
  if (snap) {
    point = point.map((value) => snapped(value, STEP_M));
  }
  return { [key]: tidyPoint(point) };
}

// Turns an object anticlockwise by `angle`; `snap`: to multiples of 5 degrees.
export function turned(object, angle, snap = false) {
  if (object.kind === "box") {
    let next = (object.angle_rad ?? 0) + angle;
    next = snap ? snapped(next, TURN_RAD) : next;
    return { angle_rad: tidy(Math.atan2(Math.sin(next), Math.cos(next))) };
  }
  const normal = frameOf(object).normal;
  let next = Math.atan2(normal[1], normal[0]) + angle;
  next = snap ? snapped(next, TURN_RAD) : next;
  return { normal: tidyPoint([Math.cos(next), Math.sin(next)]) };
}

// The grips of an object: {name, point}, in m.
export function gripsOf(object, pxPerM) {
  const frame = frameOf(object);
  const [a, b] = frame.half;
  const knob = KNOB_PX / pxPerM;
  const at = (name, s, h) => ({ name, point: global(frame, [s, h]) });
  switch (object.kind) {
    case "wall":
      return [at("turn", 0, knob)];
    case "box":
      return [at("turn", 0, b + knob), at("width", a, 0), at("height", 0, b), at("size", a, -b)];
    case "disc":
      return [at("radius", a, 0)];
    case "membrane":
      return [at("turn", 0, knob), at("width", a, 0), at("width", -a, 0)];
    default:
      return [];
  }
}

const side = (half, snap) => tidy(Math.max(MIN_SIZE_M, snap ? snapped(2 * half, STEP_M) : 2 * half));

// Returns the patch for dragging a grip of an object from `from` to `to`.
export function dragged(object, name, from, to, snap = false) {
  const frame = frameOf(object);
  const [s, h] = local(frame, to).map(Math.abs);
  switch (name) {
    case "turn": {
      const before = minus(from, frame.point);
      const after = minus(to, frame.point);
      return turned(object, Math.atan2(after[1], after[0]) - Math.atan2(before[1], before[0]), snap);
    }
    case "radius": {
      const radius = Math.hypot(s, h);
      return { radius_m: tidy(Math.max(MIN_SIZE_M, snap ? snapped(radius, STEP_M) : radius)) };
    }
    case "width":
      return object.kind === "box" ? { size_m: [side(s, snap), object.size_m[1]] } : { width_m: side(s, snap) };
    case "height":
      return { size_m: [object.size_m[0], side(h, snap)] };
    case "size":
      return { size_m: [side(s, snap), side(h, snap)] };
    default:
      throw new Error(`an object has no grip ${name}`);
  }
}
