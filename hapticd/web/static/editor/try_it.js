// How the simulated hand tries a material: where in the scene it can be touched, and by which gesture.
import { rounded } from "./placement.js";

const REACH_M = 0.06; // reach of the hand, to either side of the middle
const MARGIN = 0.1; // fraction of a section that is left free at each end

const TAP = { kind: "tap", speed_m_per_s: 0.2 };
const STROKE = { kind: "stroke", speed_m_per_s: 0.08, press_n: 1, count: 2 };

// Returns the sections of a wall with a material, within reach: [from, to] along the surface from the wall's point.
export function sections(wall, name) {
  const [nx, ny] = wall.normal;
  const middle = -(wall.point_m[0] * ny - wall.point_m[1] * nx); // position of the origin along the surface
  const patches = (wall.patches ?? []).toSorted((a, b) => a.from_m - b.from_m);
  const found = [];
  let from = middle - REACH_M;
  for (const patch of patches) {
    found.push({ from, to: patch.from_m, material: wall.material });
    found.push({ from: patch.from_m, to: patch.to_m, material: patch.material });
    from = patch.to_m;
  }
  found.push({ from, to: middle + REACH_M, material: wall.material });
  return found
    .map((each) => ({ ...each, from: Math.max(each.from, middle - REACH_M), to: Math.min(each.to, middle + REACH_M) }))
    .filter((each) => each.material === name && each.to > each.from);
}

// Returns {object, from, to}, the section of a surface where the material can be touched best; null if there is none.
export function spotOf(scene, name) {
  const spots = [];
  for (const [object, each] of Object.entries(scene.objects)) {
    if (each.kind === "wall") {
      spots.push(...sections(each, name).map(({ from, to }) => ({ object, from, to })));
    } else if (each.material === name) {
      const half = { box: each.size_m?.[0], membrane: each.width_m, disc: each.radius_m }[each.kind] / 2;
      spots.push({ object, from: -half, to: half });
    }
  }
  const longest = spots.sort((a, b) => b.to - b.from - (a.to - a.from))[0];
  if (longest === undefined) {
    return null;
  }
  const inset = MARGIN * (longest.to - longest.from);
  return { object: longest.object, from: longest.from + inset, to: longest.to - inset };
}

// Returns the params of set_operator.
export function tapGesture({ object, from, to }) {
  return { gesture: { ...TAP, object, at_m: rounded((from + to) / 2) } };
}

export function strokeGesture({ object, from, to }) {
  return { gesture: { ...STROKE, object, from_m: rounded(from), to_m: rounded(to) } };
}

export function punctureGesture({ object, from, to }) {
  return { gesture: { kind: "puncture", object, speed_m_per_s: 0.1, at_m: rounded((from + to) / 2) } };
}

// Returns the params of play for a material's mode, as for an approach at the tap's speed; null if it has no mode.
export function playOf(name, material) {
  const tap = material.tap && !("waveform" in material.tap) ? material.tap : null;
  if (tap === null && !material.rupture) {
    return null;
  }
  const speed = TAP.speed_m_per_s;
  const amplitude = tap === null ? material.rupture.amplitude_m_per_s2 : tap.attack_slope_per_s !== undefined ? tap.attack_slope_per_s * speed : tap.amplitudes.at(-1)[1];
  return { material: name, direction: [0, 1], amplitude_m_per_s2: amplitude };
}
