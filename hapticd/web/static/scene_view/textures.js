// Drawing of materials along a surface: grooves at their true spacing and width, the grain of sandpaper, and friction. If
// grooves are finer than pixels, a band is drawn instead of a false pattern.
//
// Drawing is in the axes of the surface, in pixels: x along the tangent, y into the solid.

export const BAND_PX = 11; // depth of a drawn texture
const MIN_SPACING_PX = 3; // closer grooves are drawn as a band
const SHOWN_DEPTH_PX = 5; // drawn depth of grooves without a depth

// Hues of the shipped materials; others get a hue computed from their name.
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

// Returns the translucent colour of a material.
export function tint(name, strength) {
  return `hsl(${hueOf(name)} 55% 50% / ${strength})`;
}

// Returns a pseudorandom sequence from 0 to 1 that is the same each time.
export function hashed(index, salt) {
  let x = Math.imul(index ^ (salt * 0x9e3779b9), 0x85ebca6b);
  x ^= x >>> 13;
  x = Math.imul(x, 0xc2b2ae35);
  x ^= x >>> 16;
  return (x >>> 0) / 4294967296;
}

// Returns the numbers k of the grooves with their middle, k * spacing, in [from, to] as [first, last]; none: last < first.
export function grooveNumbers(spacing, from, to) {
  return [Math.ceil(from / spacing - 1e-9), Math.floor(to / spacing + 1e-9)];
}

// Returns the drawn depth of a groove, in pixels. A groove displayed as geometry has a depth and is drawn to scale.
export function grooveDepthPx(texture, pxPerM) {
  return texture.display === "geometry" ? texture.depth_m * pxPerM : SHOWN_DEPTH_PX;
}

function drawGrooves(ctx, texture, pxPerM, from, to, colours) {
  const spacingPx = texture.spacing_m * pxPerM;
  if (spacingPx < MIN_SPACING_PX) {
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
    // A raised cosine, as in the daemon: two curves that are level at the surface and at the bottom.
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

// Draws grain: coarser for more vibration with speed, denser for a higher peak frequency.
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

// Draws friction as short slanted lines below the surface, longer for more friction.
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

// Draws the surface of a material from `from` to `to`, in m along the tangent.
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
