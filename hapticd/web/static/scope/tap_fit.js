// Fit of decaying sines to samples: frequency and decay from the samples alone. Linear prediction (Prony) gives the start
// values, and is exact if the samples are only one to three decaying sines; Levenberg and Marquardt's least squares then
// give the best fit in noise.
import { leastSquares, roots } from "./least_squares.js";

const MAX_MODES = 3;
const EXACT_RESIDUAL = 1e-7; // residual, relative to the samples' RMS, that is only the rounding of single precision
const MAX_ITERATIONS = 40;

// Returns the decaying sines in `samples`, the strongest first: each {frequencyHz, decayPerS, cosine, sine, energy}, which is
// exp(-decayPerS t) (cosine cos(w t) + sine sin(w t)), t from the first sample. `residual`: RMS of the residual over RMS of
// the samples. Returns null if no decaying sine fits the samples.
export function fitModes(samples, periodS) {
  const scale = rms(samples);
  if (!(scale > 0)) {
    return null;
  }
  let best = null;
  for (let count = 1; count <= MAX_MODES && 4 * count < samples.length; count++) {
    const begin = beginning(samples, count, EXACT_RESIDUAL * scale * Math.sqrt(samples.length));
    if (begin === null) {
      continue;
    }
    const fit = refine(samples, begin);
    const residual = Math.sqrt(fit.sum / samples.length) / scale;
    // Bayes' criterion: another mode must explain more than its four numbers would of noise.
    const cost = samples.length * Math.log(residual * residual + 1e-24) + 4 * count * Math.log(samples.length);
    if (best === null || cost < best.cost) {
      best = { ...fit, residual, cost };
    }
    if (residual < EXACT_RESIDUAL) {
      break;
    }
  }
  if (best === null || !(best.residual < 0.7)) {
    return null;
  }
  const modes = best.modes.map((mode) => describe(mode, samples.length, periodS));
  modes.sort((a, b) => b.energy - a.energy);
  return { modes, residual: best.residual };
}

function rms(samples) {
  let sum = 0;
  for (const value of samples) {
    sum += value * value;
  }
  return Math.sqrt(sum / samples.length);
}

// Modes are {b, w, c, s} per sample, not per second, up to here.
function describe({ b, w, c, s }, count, periodS) {
  let energy = 0;
  for (let i = 0; i < count; i++) {
    const value = Math.exp(-b * i) * (c * Math.cos(w * i) + s * Math.sin(w * i));
    energy += value * value;
  }
  return { frequencyHz: w / (2 * Math.PI * periodS), decayPerS: b / periodS, cosine: c, sine: s, energy };
}

// Returns start values for `count` modes. If sines are slow relative to the rate, neighbouring samples differ by less than
// the noise: prediction then also uses every 2nd, 4th, ... sample, and the smallest residual wins.
function beginning(samples, count, enough) {
  const left = new Float64Array(samples.length);
  let best = null;
  let smallest = Infinity;
  for (let stride = 1; 4 * count * stride <= samples.length && !(Math.sqrt(smallest) < enough); stride *= 2) {
    const modes = predict(samples, count, stride);
    if (modes !== null && amplitudes(samples, modes)) {
      const sum = remainder(samples, modes, left);
      if (sum < smallest) {
        [best, smallest] = [modes, sum];
      }
    }
  }
  return best;
}

// Returns `count` modes by linear prediction with the stride m: y[n] = a[1] y[n-m] + ... + a[2 count] y[n-2 count m].
function predict(samples, count, stride) {
  const order = 2 * count;
  const rows = samples.length - order * stride;
  const lagged = (k) => Float64Array.from({ length: rows }, (_, i) => samples[i + k * stride]);
  const next = leastSquares(
    Array.from({ length: order }, (_, k) => lagged(k)),
    lagged(order),
  );
  if (next === null) {
    return null;
  }
  const modes = [];
  for (const [re, im] of roots(next.map((value) => -value))) {
    const size = Math.hypot(re, im);
    if (im > 1e-9 && size > 1e-6) {
      modes.push({ b: -Math.log(size) / stride, w: Math.atan2(im, re) / stride, c: 0, s: 0 });
    }
  }
  return modes.length === 0 ? null : modes;
}

// Sets the amplitudes of modes with known frequency and decay; returns whether this was possible.
function amplitudes(samples, modes) {
  const n = samples.length;
  const columns = [];
  for (const { b, w } of modes) {
    columns.push(Float64Array.from({ length: n }, (_, i) => Math.exp(-b * i) * Math.cos(w * i)));
    columns.push(Float64Array.from({ length: n }, (_, i) => Math.exp(-b * i) * Math.sin(w * i)));
  }
  const found = leastSquares(columns, Float64Array.from(samples));
  if (found === null) {
    return false;
  }
  modes.forEach((mode, k) => {
    mode.c = found[2 * k];
    mode.s = found[2 * k + 1];
  });
  return true;
}

function remainder(samples, modes, into) {
  let sum = 0;
  for (let i = 0; i < samples.length; i++) {
    let value = samples[i];
    for (const { b, w, c, s } of modes) {
      value -= Math.exp(-b * i) * (c * Math.cos(w * i) + s * Math.sin(w * i));
    }
    into[i] = value;
    sum += value * value;
  }
  return sum;
}

function refine(samples, begin) {
  let modes = begin.map((mode) => ({ ...mode }));
  const left = new Float64Array(samples.length);
  const trial = new Float64Array(samples.length);
  let sum = remainder(samples, modes, left);
  let damping = 1e-4;
  for (let round = 0; round < MAX_ITERATIONS && sum > 0; round++) {
    const moved = step(modes, left, damping);
    const next = moved !== null && amplitudes(samples, moved) ? remainder(samples, moved, trial) : Infinity;
    if (next < sum) {
      const gain = (sum - next) / sum;
      [modes, sum] = [moved, next];
      left.set(trial);
      damping /= 10;
      if (gain < 1e-12) {
        break;
      }
    } else {
      damping *= 10;
      if (damping > 1e8) {
        break;
      }
    }
  }
  return { modes, sum };
}

// Returns the modes after one damped step; null if there is no step.
function step(modes, left, damping) {
  const n = left.length;
  const unknowns = 4 * modes.length;
  const columns = Array.from({ length: unknowns }, () => new Float64Array(n + unknowns));
  const right = new Float64Array(n + unknowns);
  right.set(left);
  modes.forEach(({ b, w, c, s }, k) => {
    for (let i = 0; i < n; i++) {
      const decay = Math.exp(-b * i);
      const cosine = decay * Math.cos(w * i);
      const sine = decay * Math.sin(w * i);
      columns[4 * k][i] = -i * (c * cosine + s * sine);
      columns[4 * k + 1][i] = i * (s * cosine - c * sine);
      columns[4 * k + 2][i] = cosine;
      columns[4 * k + 3][i] = sine;
    }
  });
  columns.forEach((column, j) => {
    let square = 0;
    for (let i = 0; i < n; i++) {
      square += column[i] * column[i];
    }
    column[n + j] = Math.sqrt(damping * square);
  });
  const change = leastSquares(columns, right);
  if (change === null || !change.every(Number.isFinite)) {
    return null;
  }
  return modes.map(({ b, w, c, s }, k) => ({
    b: b + change[4 * k],
    w: Math.min(Math.PI, Math.max(1e-9, w + change[4 * k + 1])),
    c,
    s,
  }));
}

// Returns the main direction of a plane vibration as a unit vector, with the sign of the first half wave.
export function mainDirection(x, y) {
  let [xx, xy, yy] = [0, 0, 0];
  for (let i = 0; i < x.length; i++) {
    xx += x[i] * x[i];
    xy += x[i] * y[i];
    yy += y[i] * y[i];
  }
  const angle = 0.5 * Math.atan2(2 * xy, xx - yy);
  const [ux, uy] = [Math.cos(angle), Math.sin(angle)];
  let greatest = 0;
  for (let i = 0; i < x.length; i++) {
    greatest = Math.max(greatest, Math.abs(x[i] * ux + y[i] * uy));
  }
  for (let i = 0; i < x.length; i++) {
    const value = x[i] * ux + y[i] * uy;
    if (Math.abs(value) > 0.3 * greatest) {
      return value < 0 ? [-ux, -uy] : [ux, uy];
    }
  }
  return [ux, uy];
}
