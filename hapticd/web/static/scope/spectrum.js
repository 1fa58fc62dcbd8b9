// Levels by frequency: Hann window, weighted mean removed, dB re 1 (of N, m or m/s): a steady sine whose RMS is 1 has 0 dB.

// Transforms `re` and `im` in place; their length is a power of two.
export function fft(re, im) {
  const n = re.length;
  for (let i = 1, j = 0; i < n; i++) {
    let bit = n >> 1;
    for (; j & bit; bit >>= 1) {
      j ^= bit;
    }
    j ^= bit;
    if (i < j) {
      [re[i], re[j]] = [re[j], re[i]];
      [im[i], im[j]] = [im[j], im[i]];
    }
  }
  const { cos, sin } = twiddles(n);
  for (let size = 2; size <= n; size *= 2) {
    const half = size / 2;
    const stride = n / size;
    for (let begin = 0; begin < n; begin += size) {
      for (let k = 0; k < half; k++) {
        const wr = cos[k * stride];
        const wi = sin[k * stride];
        const a = begin + k;
        const b = a + half;
        const tr = re[b] * wr - im[b] * wi;
        const ti = re[b] * wi + im[b] * wr;
        re[b] = re[a] - tr;
        im[b] = im[a] - ti;
        re[a] += tr;
        im[a] += ti;
      }
    }
  }
}

const known = new Map();

function twiddles(n) {
  let found = known.get(n);
  if (found === undefined) {
    const angle = (k) => (-2 * Math.PI * k) / n;
    const make = (of) => Float64Array.from({ length: n / 2 }, (_, k) => of(angle(k)));
    found = { cos: make(Math.cos), sin: make(Math.sin) };
    known.set(n, found);
  }
  return found;
}

export const MAX_TRANSFORM_SAMPLES = 32768; // a longer section is the mean of several transforms that overlap by half

// Returns the beginnings of the parts of `count` samples, and their length.
export function parts(count) {
  const length = Math.min(count, MAX_TRANSFORM_SAMPLES);
  const begins = [];
  for (let begin = 0; begin + length <= count; begin += Math.floor(length / 2) || 1) {
    begins.push(begin);
    if (length === count) {
      break;
    }
  }
  return { length, begins };
}

// Adds the mean square at each frequency of the samples `begin`..`begin + length` - 1 to `power`, which is made if it is
// null. The samples are padded with zeros to at least twice the length, to find the peak between the lines.
export function addPower(samples, begin, length, power) {
  let size = 4;
  while (size < 2 * length) {
    size *= 2;
  }
  const re = new Float64Array(size);
  const im = new Float64Array(size);
  let sum = 0;
  let mean = 0;
  for (let i = 0; i < length; i++) {
    im[i] = 0.5 - 0.5 * Math.cos((2 * Math.PI * i) / length);
    sum += im[i];
    mean += im[i] * samples[begin + i];
  }
  // The mean weighted by the window. A plain mean would leave a hump as wide as the window, which would hide a short tap
  // near the window's beginning.
  mean /= sum > 0 ? sum : 1;
  for (let i = 0; i < length; i++) {
    re[i] = (samples[begin + i] - mean) * im[i];
    im[i] = 0;
  }
  fft(re, im);
  const result = power ?? new Float64Array(size / 2 + 1);
  // A sine of amplitude a is a/2 in each half of the transform: its mean square is a^2/2 = 2 |X|^2 / sum^2.
  const scale = sum > 0 ? 2 / (sum * sum) : 0;
  for (let k = 0; k < result.length; k++) {
    result[k] += scale * (re[k] * re[k] + im[k] * im[k]);
  }
  return result;
}

export const decibels = (power) => 10 * Math.log10(Math.max(power, 1e-30));

// Returns peak, centroid and resolution of a spectrum, in Hz and dB. Peak and centroid are NaN if the spectrum is empty.
export function summarize(power, rateHz, length) {
  const lineHz = rateHz / (2 * (power.length - 1));
  let peak = 1;
  let total = 0;
  let moment = 0;
  for (let k = 1; k < power.length; k++) {
    total += power[k];
    moment += power[k] * k * lineHz;
    if (power[k] > power[peak]) {
      peak = k;
    }
  }
  // The width of a line in the Hann window: two lines with a smaller distance cannot be separated.
  const resolutionHz = (1.5 * rateHz) / length;
  if (!(total > 1e-24)) {
    return { peakHz: NaN, peakDb: NaN, centroidHz: NaN, lineHz, resolutionHz };
  }
  let offset = 0;
  let peakDb = decibels(power[peak]);
  if (peak > 1 && peak < power.length - 1) {
    // A parabola through the three highest lines, in dB.
    const [left, middle, right] = [-1, 0, 1].map((side) => decibels(power[peak + side]));
    const bend = left - 2 * middle + right;
    offset = bend < 0 ? (0.5 * (left - right)) / bend : 0;
    peakDb = middle - 0.25 * (left - right) * offset;
  }
  return { peakHz: (peak + offset) * lineHz, peakDb, centroidHz: moment / total, lineHz, resolutionHz };
}

// Returns the complete result: {power, lineHz, peakHz, peakDb, centroidHz, resolutionHz}.
export function spectrum(samples, rateHz) {
  const { length, begins } = parts(samples.length);
  let power = null;
  for (const begin of begins) {
    power = addPower(samples, begin, length, power);
  }
  for (let k = 0; k < power.length; k++) {
    power[k] /= begins.length;
  }
  return { power, ...summarize(power, rateHz, length) };
}
