// What a surface is made of, drawn along it: grooves at their true spacing and width, the grain of sandpaper, a hint of
// friction. Where a groove would be finer than the canvas can show, a band says so instead of a false pattern.
//
// All of it is drawn in the surface's own axes, in pixels: x along the tangent, y into the solid.

export const BAND_PX = 11; // how deep below the surface a texture is drawn
const LEAST_SPACING_PX = 3; // grooves nearer than this cannot be told apart
const SHOWN_DEPTH_PX = 5; // of grooves that have no depth of their own

// Hues of the shipped materials; others get one by their name.
const HUES = {
  wood: 32, acrylic: 200, delrin: 265, aluminum: 215, glass: 175, cast_iron: 245, steel: 225, cellophane: 55,
};

function hueOf(name) {
  if (name in HUES) {
    return HUES[name];
  }
  let hash = 7;
  for (const letter of name) {
    hash = (hash * 31 + letter.codePointAt(0)) % 360;
  }
  return hash;
}

// A colour that stands for a material, to be laid over the page's ground.
export function tint(name, strength) {
  return `hsl(${hueOf(name)} 55% 50% / ${strength})`;
}

// A sequence that looks random and is the same each time, from 0 to 1.
export function hashed(index, salt) {
  let x = Math.imul(index ^ (salt * 0x9e3779b9), 0x85ebca6b);
  x ^= x >>> 13;
  x = Math.imul(x, 0xc2b2ae35);
  x ^= x >>> 16;
  return (x >>> 0) / 4294967296;
}

// The numbers k of the grooves whose middle k spacing lies within [from, to], as [first, last]; last < first: none.
export function grooveNumbers(spacing, from, to) {
  return [Math.ceil(from / spacing - 1e-9), Math.floor(to / spacing + 1e-9)];
}

// How deep a groove is drawn, in pixels. One of geometry has a depth, and is drawn to scale.
export function grooveDepthPx(texture, pxPerM) {
  return texture.display === "geometry" ? texture.depth_m * pxPerM : SHOWN_DEPTH_PX;
}

function drawGrooves(ctx, texture, pxPerM, from, to, colours) {
  const spacingPx = texture.spacing_m * pxPerM;
  if (spacingPx < LEAST_SPACING_PX) {
    ctx.fillStyle = colours.groove;
    ctx.globalAlpha = 0.35;
    ctx.fillRect(from * pxPerM, 0, (to - from) * pxPerM, 3);
    ctx.globalAlpha = 1;
    return;
  }
  const [first, last] = grooveNumbers(texture.spacing_m, from, to);
  const half = (texture.width_m * pxPerM) / 2;
  const depth = grooveDepthPx(texture, pxPerM);
  ctx.fillStyle = texture.display === "damping" ? colours.groove : colours.ground;
  ctx.strokeStyle = colours.surface;
  ctx.lineWidth = 1;
  if (texture.display === "damping") {
    ctx.globalAlpha = 0.45;
  }
  ctx.beginPath();
  for (let k = first; k <= last; k++) {
    const x = k * spacingPx;
    // A raised cosine, as the daemon has it: two curves that leave the surface level and are level at the bottom.
    ctx.moveTo(x - half, -0.5);
    ctx.bezierCurveTo(x - half * 0.64, -0.5, x - half * 0.36, depth, x, depth);
    ctx.bezierCurveTo(x + half * 0.36, depth, x + half * 0.64, -0.5, x + half, -0.5);
  }
  ctx.fill();
  ctx.globalAlpha = 1;
  if (half >= 1.5) {
    ctx.stroke();
  }
}

// Grain: the coarser, the more it vibrates with speed; the denser, the higher its peak.
function drawGrain(ctx, texture, pxPerM, from, to, colours) {
  const gain = texture.velocity_gain_per_s ?? 40;
  const size = Math.min(2.6, 0.7 + 0.022 * Math.max(0, gain));
  const apart = Math.max(2.2, 1.7 * size);
  const first = Math.ceil((from * pxPerM) / apart);
  const last = Math.floor((to * pxPerM) / apart);
  ctx.fillStyle = colours.surface;
  for (let i = first; i <= last; i++) {
    const x = (i + 0.6 * hashed(i, 1)) * apart;
    const radius = size * (0.5 + 0.5 * hashed(i, 2));
    ctx.fillRect(x - radius / 2, -radius * 0.6, radius, radius);
    ctx.globalAlpha = 0.5;
    ctx.fillRect(x, 2 + hashed(i, 3) * (BAND_PX - 4), radius * 0.7, radius * 0.7);
    ctx.globalAlpha = 1;
  }
}

// Friction: short slanted hairs below the surface, the longer the more it rubs.
function drawFriction(ctx, friction, pxPerM, from, to, colours) {
  const length = Math.min(BAND_PX - 2, 3 + 8 * friction.coefficient);
  const apart = 7;
  ctx.strokeStyle = colours.muted;
  ctx.lineWidth = 1;
  ctx.globalAlpha = 0.75;
  ctx.beginPath();
  for (let x = Math.ceil((from * pxPerM) / apart) * apart; x < to * pxPerM; x += apart) {
    ctx.moveTo(x, 2);
    ctx.lineTo(x - length * 0.5, 2 + length * 0.87);
  }
  ctx.stroke();
  ctx.globalAlpha = 1;
}

// The surface of a material from `from` to `to`, m along the tangent.
export function drawSurface(ctx, material, pxPerM, from, to, colours) {
  if (material === undefined || !(from < to)) {
    return;
  }
  if (material.friction && material.friction.coefficient > 0) {
    drawFriction(ctx, material.friction, pxPerM, from, to, colours);
  }
  const texture = material.texture;
  if (texture?.kind === "grooves") {
    drawGrooves(ctx, texture, pxPerM, from, to, colours);
  } else if (texture) {
    drawGrain(ctx, texture, pxPerM, from, to, colours);
  }
}
