// The surface point (proxy): the point that stays on the surface while the probe is inside an object. As in the daemon
// (csrc/shapes, docs/architecture.md), a box is pressed at the face through which the probe entered, a membrane at the side
// of the contact, and the proxy is outside of all pressed surfaces. Pure functions.
import { along, dot, frameOf, lengthOf, local, minus } from "./geometry.js";

const ITERATIONS = 3; // as in hd_proxy.c: one is enough for surfaces at right angles
const RIM_M = 1e-12;

// The faces of a box: 0 along its normal, 1 along its tangent, 2 and 3 opposite to them.
function faceNormal(frame, face) {
  const axis = face % 2 === 0 ? frame.normal : frame.tangent;
  return face < 2 ? axis : [-axis[0], -axis[1]];
}

function faceOf(axis, positive) {
  return axis === 1 ? (positive ? 0 : 2) : positive ? 1 : 3;
}

// Returns the face through which the segment from a to b, in the box's axes, enters the box; null if it does not.
export function enteredFace(half, a, b) {
  let longest = 0;
  let face = null;
  if (Math.abs(a[0]) < half[0] - RIM_M && Math.abs(a[1]) < half[1] - RIM_M) {
    return null;
  }
  for (const axis of [0, 1]) {
    const step = b[axis] - a[axis];
    const length = Math.abs(step);
    const gap = (step < 0 ? a[axis] : -a[axis]) - half[axis];
    if (!(gap < length) || gap < -RIM_M || length <= longest) {
      continue;
    }
    const cut = gap > 0 ? gap / length : 0;
    const other = a[1 - axis] + cut * (b[1 - axis] - a[1 - axis]);
    if (Math.abs(other) <= half[1 - axis] + RIM_M) {
      face = faceOf(axis, step < 0);
      longest = length;
    }
  }
  return face;
}

export function nearestFace(half, point) {
  const side = half[0] - Math.abs(point[0]);
  const top = half[1] - Math.abs(point[1]);
  return top <= side ? faceOf(1, point[1] >= 0) : faceOf(0, point[0] >= 0);
}

// Returns the face of a box or the side of a membrane at the onset of a contact. `before` and `now` are the probe's
// positions around the onset.
export function featureOf(object, before, now) {
  const frame = frameOf(object);
  if (object.kind === "membrane") {
    return { side: local(frame, before)[1] >= 0 ? 1 : -1 };
  }
  if (object.kind === "box") {
    const to = local(frame, now);
    return { face: enteredFace(frame.half, local(frame, before), to) ?? nearestFace(frame.half, to) };
  }
  return {};
}

// Returns the contact point of the probe on a surface: depth and normal.
export function contactPoint(object, feature, position) {
  const frame = frameOf(object);
  const offset = minus(position, frame.point);
  switch (object.kind) {
    case "membrane": {
      const normal = [frame.normal[0] * feature.side, frame.normal[1] * feature.side];
      return { normal, depth: -dot(offset, normal) };
    }
    case "box": {
      const normal = faceNormal(frame, feature.face);
      return { normal, depth: frame.half[feature.face % 2 === 0 ? 1 : 0] - dot(offset, normal) };
    }
    case "disc": {
      const distance = lengthOf(offset);
      const normal = distance > 0 ? [offset[0] / distance, offset[1] / distance] : [0, 1];
      return { normal, depth: object.radius_m - distance };
    }
    default:
      return { normal: frame.normal, depth: -dot(offset, frame.normal) };
  }
}

// Returns the probe's position moved out of all pressed surfaces; null if none is pressed. `pressed`: contact points.
export function surfacePoint(position, pressed) {
  let point = position;
  let lifted = false;
  for (let iteration = 0; iteration < ITERATIONS; iteration++) {
    let any = false;
    for (const { normal, depth } of pressed) {
      const left = depth - dot(minus(point, position), normal);
      if (left > 1e-12) {
        point = along(point, normal, left);
        any = true;
      }
    }
    lifted ||= any;
    if (!any) {
      break;
    }
  }
  return lifted ? point : null;
}
