// Drawing of walls, boxes and discs, and of the names of all objects (membranes: membranes.js). `pen` has what drawing
// needs: {ctx, transform, materials, colours, labels}.
import { behind, boundsOf, corners, ends, frameOf, global, sectionSeen } from "./geometry.js";
import { BAND_PX, drawSurface, tint } from "./textures.js";

const HATCH_PX = 12;

function path(ctx, transform, points) {
  ctx.beginPath();
  for (const point of points) {
    ctx.lineTo(...transform.toPx(point));
  }
  ctx.closePath();
}

// Hatching within the current path: lines from lower left to upper right.
function hatch(pen) {
  const { ctx, transform, colours } = pen;
  const { width, height } = transform;
  ctx.save();
  ctx.clip();
  ctx.strokeStyle = colours.edge;
  ctx.globalAlpha = 0.4;
  ctx.lineWidth = 1;
  ctx.beginPath();
  // The hatching moves with the plane, so that panning is visible.
  const [x, y] = transform.toPx([0, 0]);
  const start = (((x + y) % HATCH_PX) + HATCH_PX) % HATCH_PX;
  for (let c = start - HATCH_PX; c < width + height; c += HATCH_PX) {
    ctx.moveTo(c, 0);
    ctx.lineTo(c - height, height);
  }
  ctx.stroke();
  ctx.restore();
}

// Returns the sections of the visible part of a wall, [from, to, material]: patches and the parts between them.
export function sections(wall, from, to) {
  const found = [];
  let at = from;
  for (const patch of [...(wall.patches ?? [])].sort((a, b) => a.from_m - b.from_m)) {
    if (patch.to_m <= from || patch.from_m >= to) {
      continue;
    }
    if (patch.from_m > at) {
      found.push([at, patch.from_m, wall.material]);
    }
    found.push([Math.max(patch.from_m, from), Math.min(patch.to_m, to), patch.material]);
    at = Math.min(patch.to_m, to);
  }
  if (at < to) {
    found.push([at, to, wall.material]);
  }
  return found;
}

// Draws along a surface in its own axes: x along the tangent in pixels from `point`, y into the solid.
function onSurface(pen, point, normal, tangent, draw) {
  const { ctx, transform } = pen;
  const [x, y] = transform.toPx(point);
  ctx.save();
  ctx.transform(tangent[0], -tangent[1], -normal[0], normal[1], x, y);
  draw(ctx);
  ctx.restore();
}

function drawWall(pen, wall) {
  const { ctx, transform, colours } = pen;
  const [left, bottom, right, top] = transform.seen;
  const frame = frameOf(wall);
  const solid = behind([[left, bottom], [right, bottom], [right, top], [left, top]], frame.point, frame.normal);
  if (solid.length < 3) {
    return;
  }
  path(ctx, transform, solid);
  ctx.fillStyle = tint(wall.material, 0.13);
  ctx.fill();
  hatch(pen);
  const seen = sectionSeen(frame.point, frame.tangent, [left, bottom, right, top]);
  if (seen === null) {
    return;
  }
  const scale = transform.pxPerM;
  const parts = sections(wall, ...seen);
  onSurface(pen, frame.point, frame.normal, frame.tangent, (surface) => {
    for (const [from, to, material] of parts) {
      surface.fillStyle = tint(material, 0.4);
      surface.fillRect(from * scale, 0, (to - from) * scale, BAND_PX);
    }
    surface.strokeStyle = colours.surface;
    surface.lineWidth = 2;
    surface.beginPath();
    surface.moveTo(seen[0] * scale, 0);
    surface.lineTo(seen[1] * scale, 0);
    surface.stroke();
    for (const [from, to, material] of parts) {
      drawSurface(surface, pen.materials[material], scale, from, to, colours);
    }
  });
}

function nameWall(pen, id, wall) {
  const { ctx, transform, colours, labels } = pen;
  const frame = frameOf(wall);
  const seen = sectionSeen(frame.point, frame.tangent, transform.seen);
  if (seen === null) {
    return;
  }
  const parts = sections(wall, ...seen);
  const below = (s, px) => transform.toPx(global(frame, [s, -px / transform.pxPerM]));
  for (const [from, to, material] of parts.slice(0, 200)) {
    if (material !== wall.material) {
      const places = [below((from + to) / 2, BAND_PX + 13), below((from + to) / 2, BAND_PX + 33)];
      labels.write(ctx, material, places, { colour: colours.muted, plate: colours.ground });
    }
  }
  const text = `${id} · ${wall.material}`;
  const places = [];
  for (const part of [0.12, 0.5, 0.88, 0.3, 0.7]) {
    const s = seen[0] + (seen[1] - seen[0]) * part;
    places.push(below(s, BAND_PX + 35), below(s, BAND_PX + 13), below(s, BAND_PX + 55));
  }
  labels.write(ctx, text, places, { weight: 600, colour: colours.text, plate: colours.ground });
}

// Draws the name of a solid: inside if there is space, else around it.
function nameSolid(pen, id, object) {
  const { ctx, transform, colours, labels } = pen;
  const [left, bottom, right, top] = boundsOf(object);
  const [x0, y1] = transform.toPx([left, bottom]);
  const [x1, y0] = transform.toPx([right, top]);
  const text = `${id} · ${object.material}`;
  ctx.font = "600 12px system-ui, sans-serif";
  const half = ctx.measureText(text).width / 2 + 8;
  const middle = [(x0 + x1) / 2, (y0 + y1) / 2];
  const places = [[middle[0], y0 - 12], [x1 + half, middle[1]], [x0 - half, middle[1]], [middle[0], y1 + 12]];
  if (x1 - x0 > 2 * half && y1 - y0 > 30) {
    places.unshift(middle);
  }
  labels.write(ctx, text, places, { weight: 600, colour: colours.text, plate: colours.ground });
}

function drawBox(pen, box) {
  const { ctx, transform, colours, materials } = pen;
  const frame = frameOf(box);
  path(ctx, transform, corners(frame));
  ctx.fillStyle = colours.ground;
  ctx.fill();
  ctx.fillStyle = tint(box.material, 0.3);
  ctx.fill();
  hatch(pen);
  path(ctx, transform, corners(frame));
  ctx.strokeStyle = colours.surface;
  ctx.lineWidth = 2;
  ctx.stroke();
  const scale = transform.pxPerM;
  for (const face of [0, 1, 2, 3]) {
    const sign = face < 2 ? 1 : -1;
    const axis = face % 2 === 0 ? frame.normal : frame.tangent;
    const normal = [axis[0] * sign, axis[1] * sign];
    const tangent = [normal[1], -normal[0]];
    const [length, height] = face % 2 === 0 ? frame.half : [frame.half[1], frame.half[0]];
    if (height * scale < BAND_PX) {
      continue; // a thin box without space below its surface
    }
    const middle = [frame.point[0] + normal[0] * height, frame.point[1] + normal[1] * height];
    onSurface(pen, middle, normal, tangent, (surface) =>
      drawSurface(surface, materials[box.material], scale, -length, length, colours),
    );
  }
}

function drawDisc(pen, disc) {
  const { ctx, transform, colours, materials } = pen;
  const [x, y] = transform.toPx(disc.center_m);
  const radius = disc.radius_m * transform.pxPerM;
  ctx.beginPath();
  ctx.arc(x, y, radius, 0, 2 * Math.PI);
  ctx.fillStyle = colours.ground;
  ctx.fill();
  ctx.fillStyle = tint(disc.material, 0.3);
  ctx.fill();
  hatch(pen);
  ctx.beginPath();
  ctx.arc(x, y, radius, 0, 2 * Math.PI);
  ctx.strokeStyle = colours.surface;
  ctx.lineWidth = 2;
  ctx.stroke();
  const material = materials[disc.material];
  if (radius > 2 * BAND_PX && (material?.texture || material?.friction)) {
    // The surface is drawn as short straight pieces along the rim.
    const pieces = Math.min(180, Math.max(24, Math.round(radius / 4)));
    for (let i = 0; i < pieces; i++) {
      const angle = -Math.PI + ((i + 0.5) * 2 * Math.PI) / pieces; // angle of the normal, clockwise from up: s / R
      const normal = [Math.sin(angle), Math.cos(angle)];
      const s = disc.radius_m * angle;
      const half = (Math.PI * disc.radius_m) / pieces;
      const rim = [disc.center_m[0] + normal[0] * disc.radius_m, disc.center_m[1] + normal[1] * disc.radius_m];
      const tangent = [normal[1], -normal[0]];
      const origin = [rim[0] - tangent[0] * s, rim[1] - tangent[1] * s];
      onSurface(pen, origin, normal, tangent, (surface) =>
        drawSurface(surface, material, transform.pxPerM, s - half, s + half, colours),
      );
    }
  }
}

// Draws the name of a membrane; membranes.js draws the membrane.
function nameMembrane(pen, id, membrane) {
  const { ctx, transform, colours, labels } = pen;
  const frame = frameOf(membrane);
  const [from, to] = ends(frame).map((end) => transform.toPx(end));
  const above = transform.toPx(global(frame, [0, 16 / transform.pxPerM]));
  const text = `${id} · ${membrane.material}`;
  ctx.font = "600 12px system-ui, sans-serif";
  const half = ctx.measureText(text).width / 2 + 10;
  const outer = from[0] < to[0] ? [from, to] : [to, from];
  const places = [
    [above[0], above[1]], [outer[1][0] + half, outer[1][1]], [outer[0][0] - half, outer[0][1]],
    [above[0], above[1] - 20], [above[0], 2 * transform.toPx(frame.point)[1] - above[1]],
  ];
  labels.write(ctx, text, places, { weight: 600, colour: colours.text, plate: colours.ground });
}

// in this order: objects on a wall are drawn over it
const SHAPE_DRAWERS = { wall: drawWall, box: drawBox, disc: drawDisc };
// in this order: names with the least space first
const NAME_DRAWERS = { membrane: nameMembrane, box: nameSolid, disc: nameSolid, wall: nameWall };

// Returns whether an object overlaps [left, bottom, right, top].
export function isSeen(object, [left, bottom, right, top]) {
  const bounds = boundsOf(object);
  return bounds === null || (bounds[0] <= right && bounds[2] >= left && bounds[1] <= top && bounds[3] >= bottom);
}

function* ofKinds(pen, objects, kinds) {
  const seen = pen.transform.seen;
  const entries = Object.entries(objects).filter(([, object]) => object.kind in kinds && isSeen(object, seen));
  for (const [kind, call] of Object.entries(kinds)) {
    for (const [id, object] of entries) {
      if (object.kind === kind) {
        yield [call, id, object];
      }
    }
  }
}

export function drawSolids(pen, objects) {
  for (const [draw, , object] of ofKinds(pen, objects, SHAPE_DRAWERS)) {
    draw(pen, object);
  }
}

export function nameSurfaces(pen, objects) {
  for (const [name, id, object] of ofKinds(pen, objects, NAME_DRAWERS)) {
    name(pen, id, object);
  }
}
