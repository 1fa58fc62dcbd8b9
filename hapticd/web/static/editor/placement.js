// The place of a new object: where there is space, within the view.

const MAX_OFFSET_M = 0.06; // largest distance from the middle of the view
const GRID_STEPS = 13;
const HANDLE_CLEARANCE_M = 0.008; // distance to the handle that stays free
const SUFFICIENT_DISTANCE_M = 0.02; // sufficient distance to other objects
const WALL_CANDIDATES = [
  { point_m: [0, -0.055], normal: [0, 1] },
  { point_m: [-0.065, 0], normal: [1, 0] },
  { point_m: [0.065, 0], normal: [-1, 0] },
  { point_m: [0, 0.065], normal: [0, -1] },
];

// Returns a length in m, rounded to micrometres.
export const rounded = (value) => Number(value.toFixed(6));

// Returns the distance of a point from an object, in m; negative: inside. Objects that cannot be touched are far away.
export function clearance([x, y], object) {
  const [dx, dy] = object.center_m ? [x - object.center_m[0], y - object.center_m[1]] : [0, 0];
  switch (object.kind) {
    case "wall":
      return (x - object.point_m[0]) * object.normal[0] + (y - object.point_m[1]) * object.normal[1];
    case "disc":
      return Math.hypot(dx, dy) - object.radius_m;
    case "box": {
      const [cos, sin] = [Math.cos(object.angle_rad ?? 0), Math.sin(object.angle_rad ?? 0)];
      const [u, v] = [Math.abs(dx * cos + dy * sin) - object.size_m[0] / 2, Math.abs(dy * cos - dx * sin) - object.size_m[1] / 2];
      return Math.hypot(Math.max(u, 0), Math.max(v, 0)) + Math.min(Math.max(u, v), 0);
    }
    case "membrane": {
      const [nx, ny] = object.normal;
      return Math.hypot(Math.max(Math.abs(dx * ny - dy * nx) - object.width_m / 2, 0), dx * nx + dy * ny);
    }
    default:
      return Infinity;
  }
}

// Returns a point with enough space around it, or else the one with the most; of equal points the nearest to the middle.
export function roomiest(objects, handle) {
  const solids = Object.values(objects);
  const free = (point) => Math.min(SUFFICIENT_DISTANCE_M, Math.hypot(point[0] - handle[0], point[1] - handle[1]) - HANDLE_CLEARANCE_M, ...solids.map((object) => clearance(point, object)));
  let best = { room: -Infinity };
  for (let i = 0; i < GRID_STEPS; i++) {
    for (let j = 0; j < GRID_STEPS; j++) {
      const point = [i, j].map((step) => rounded(MAX_OFFSET_M * ((2 * step) / (GRID_STEPS - 1) - 1)));
      const room = free(point);
      const nearer = Math.hypot(...point) < Math.hypot(...(best.point ?? [9, 9]));
      if (room > best.room + 1e-9 || (room > best.room - 1e-9 && nearer)) {
        best = { point, room };
      }
    }
  }
  return best;
}

// Returns a wall that has the handle and the middles of other objects outside; else the first one.
function freeWall(objects, handle) {
  const points = [handle, ...Object.values(objects).flatMap((object) => (object.center_m ? [object.center_m] : []))];
  const walls = Object.values(objects).filter(({ kind }) => kind === "wall");
  const parallel = (wall) => walls.some(({ normal }) => normal[0] * wall.normal[0] + normal[1] * wall.normal[1] > 0.99);
  const outside = (wall) => points.every((point) => clearance(point, { kind: "wall", ...wall }) > 0);
  return WALL_CANDIDATES.find((wall) => !parallel(wall) && outside(wall)) ?? WALL_CANDIDATES.find(outside) ?? WALL_CANDIDATES[0];
}

// Returns a new object of a kind, with `material` if the kind has a material.
export function newObject(kind, { objects, handle, material }) {
  const { point, room } = roomiest(objects, handle);
  const size = rounded(Math.min(Math.max(0.6 * room, 0.003), 0.012));
  switch (kind) {
    case "wall":
      return { kind, ...structuredClone(freeWall(objects, handle)), material };
    case "box":
      return { kind, center_m: point, size_m: [rounded(1.4 * size), size], angle_rad: 0, material };
    case "disc":
      return { kind, center_m: point, radius_m: size, material };
    case "membrane":
      return { kind, center_m: point, normal: [0, 1], width_m: rounded(2 * size), material };
    case "spring":
      return { kind, center_m: [0, 0], stiffness_n_per_m: 50, damping_n_s_per_m: 0.5 };
    case "viscous":
      return { kind, damping_n_s_per_m: 2 };
    default:
      return { kind: "constant", force_n: [0, -0.2] };
  }
}

// Returns a copy of an object, shifted a little if the object has a place.
export function duplicate(object, objects, handle) {
  const copy = structuredClone(object);
  if (copy.center_m) {
    copy.center_m = roomiest(objects, handle).point;
  } else if (copy.point_m) {
    copy.point_m = copy.point_m.map((value, index) => rounded(value + 0.01 * copy.normal[index]));
  }
  return copy;
}

// Returns an unused name: `wall`, `wall_2`, ...
export function freeName(wanted, taken) {
  const base = wanted.replace(/_\d+$/, "");
  let name = taken.includes(wanted) ? `${base}_2` : wanted;
  for (let number = 3; taken.includes(name); number++) {
    name = `${base}_${number}`;
  }
  return name;
}
