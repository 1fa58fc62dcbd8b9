// The shapes of a scene, in m: frames, distances, outlines. The same definitions as csrc/shapes: a normal n points out of
// the solid, t = (n_y, -n_x) is the tangent. Pure.

export const SURFACES = new Set(["wall", "box", "disc", "membrane"]);
export const EVERYWHERE = new Set(["viscous", "constant"]); // fields without a place

export const dot = (a, b) => a[0] * b[0] + a[1] * b[1];
export const minus = (a, b) => [a[0] - b[0], a[1] - b[1]];
export const along = (point, direction, length) => [
  point[0] + direction[0] * length,
  point[1] + direction[1] * length,
];
export const tangentOf = (normal) => [normal[1], -normal[0]];
export const lengthOf = (vector) => Math.hypot(vector[0], vector[1]);

export function unit(vector) {
  const length = lengthOf(vector);
  return length > 0 ? [vector[0] / length, vector[1] / length] : [0, 1];
}

// Returns the frame of an object: its point, its normal, and half its sides along tangent and normal. The point of a field
// without a place is the origin.
export function frameOf(object) {
  switch (object.kind) {
    case "wall": {
      const normal = unit(object.normal);
      return { point: object.point_m, normal, tangent: tangentOf(normal), half: [Infinity, Infinity] };
    }
    case "box": {
      const angle = object.angle_rad ?? 0;
      const normal = [-Math.sin(angle), Math.cos(angle)];
      const half = [object.size_m[0] / 2, object.size_m[1] / 2];
      return { point: object.center_m, normal, tangent: tangentOf(normal), half };
    }
    case "disc":
      return {
        point: object.center_m, normal: [0, 1], tangent: [1, 0], half: [object.radius_m, object.radius_m],
      };
    case "membrane": {
      const normal = unit(object.normal);
      return { point: object.center_m, normal, tangent: tangentOf(normal), half: [object.width_m / 2, 0] };
    }
    default:
      return { point: object.center_m ?? [0, 0], normal: [0, 1], tangent: [1, 0], half: [0, 0] };
  }
}

// Returns the coordinates of a point in a frame, along its tangent and its normal.
export function local(frame, point) {
  const offset = minus(point, frame.point);
  return [dot(offset, frame.tangent), dot(offset, frame.normal)];
}

export function global(frame, [s, h]) {
  return along(along(frame.point, frame.tangent, s), frame.normal, h);
}

// Returns the distance of a point from a surface; negative inside of a solid.
export function distanceTo(object, point) {
  const frame = frameOf(object);
  const [s, h] = local(frame, point);
  switch (object.kind) {
    case "wall":
      return h;
    case "disc":
      return Math.hypot(s, h) - frame.half[0];
    case "box": {
      const beside = Math.abs(s) - frame.half[0];
      const above = Math.abs(h) - frame.half[1];
      return Math.max(beside, above) <= 0
        ? Math.max(beside, above)
        : Math.hypot(Math.max(beside, 0), Math.max(above, 0));
    }
    case "membrane":
      return Math.hypot(Math.max(Math.abs(s) - frame.half[0], 0), h);
    default:
      return Math.hypot(s, h);
  }
}

// The corners of a box, anticlockwise from the right end of its upper side.
export function corners(frame) {
  const [a, b] = frame.half;
  return [[a, b], [-a, b], [-a, -b], [a, -b]].map((corner) => global(frame, corner));
}

// The ends of a membrane.
export function ends(frame) {
  return [global(frame, [-frame.half[0], 0]), global(frame, [frame.half[0], 0])];
}

// Returns the part of a convex polygon behind a line: where (p - point).normal <= 0.
export function behind(polygon, point, normal) {
  const kept = [];
  for (let i = 0; i < polygon.length; i++) {
    const a = polygon[i];
    const b = polygon[(i + 1) % polygon.length];
    const ha = dot(minus(a, point), normal);
    const hb = dot(minus(b, point), normal);
    if (ha <= 0) {
      kept.push(a);
    }
    if (ha < 0 !== hb < 0 && ha !== hb) {
      kept.push(along(a, minus(b, a), ha / (ha - hb)));
    }
  }
  return kept;
}

// Returns the section [from, to] of a line through `point` along `direction` within a rectangle [left, bottom, right, top];
// null if there is none.
export function sectionSeen(point, direction, [left, bottom, right, top]) {
  let from = -Infinity;
  let to = Infinity;
  for (const [axis, low, high] of [[0, left, right], [1, bottom, top]]) {
    if (direction[axis] === 0) {
      if (point[axis] < low || point[axis] > high) {
        return null;
      }
      continue;
    }
    const a = (low - point[axis]) / direction[axis];
    const b = (high - point[axis]) / direction[axis];
    from = Math.max(from, Math.min(a, b));
    to = Math.min(to, Math.max(a, b));
  }
  return from < to ? [from, to] : null;
}

// Returns the bounding box of an object, [left, bottom, right, top]; null if it is unbounded or has no place.
export function boundsOf(object) {
  if (object.kind === "wall" || EVERYWHERE.has(object.kind)) {
    return null;
  }
  const frame = frameOf(object);
  const reach = [0, 1].map(
    (axis) =>
      object.kind === "disc"
        ? frame.half[0]
        : Math.abs(frame.tangent[axis]) * frame.half[0] + Math.abs(frame.normal[axis]) * frame.half[1],
  );
  const [x, y] = frame.point;
  return [x - reach[0], y - reach[1], x + reach[0], y + reach[1]];
}

// Returns the part of a scene that a view should show, [left, bottom, right, top]: bounded objects, patches of walls, a
// strip around each wall's point, and the points `also`.
export function extentOf(objects, also, margin) {
  const points = [...also];
  for (const object of Object.values(objects)) {
    const bounds = boundsOf(object);
    if (bounds !== null) {
      points.push([bounds[0], bounds[1]], [bounds[2], bounds[3]]);
    } else if (object.kind === "wall") {
      const frame = frameOf(object);
      const patches = object.patches ?? [];
      points.push(frame.point, ...patches.flatMap((p) => [global(frame, [p.from_m, 0]), global(frame, [p.to_m, 0])]));
    }
  }
  const low = [0, 1].map((axis) => points.reduce((least, p) => Math.min(least, p[axis]), Infinity) - margin);
  const high = [0, 1].map((axis) => points.reduce((largest, p) => Math.max(largest, p[axis]), -Infinity) + margin);
  return [...low, ...high];
}

// Returns the id of the object under a point, or null. Small objects have priority over large ones, so that objects on a
// wall can be selected: fields with a centre, membranes, discs and boxes, walls.
export function pick(objects, point, reach) {
  const order = { spring: 0, membrane: 1, disc: 2, box: 2, wall: 3 };
  let best = null;
  for (const [id, object] of Object.entries(objects)) {
    const rank = order[object.kind];
    if (rank === undefined) {
      continue;
    }
    const distance = distanceTo(object, point);
    if (distance <= reach && (best === null || rank < best.rank || (rank === best.rank && distance < best.distance))) {
      best = { id, rank, distance };
    }
  }
  return best === null ? null : best.id;
}
