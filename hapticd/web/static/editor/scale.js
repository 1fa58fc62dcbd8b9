// The range of a slider: a useful range around the current value, logarithmic if the limits span decades.

export const STEPS = 1000;
const LOG_SPAN = 10; // a logarithmic slider reaches from a tenth to ten times the value
const LOG_FROM_RATIO = 1000; // ratio of the limits from which on a slider is logarithmic
const SLIDER_DIGITS = 3;

const rounded = (value) => Number(value.toPrecision(SLIDER_DIGITS));
const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

// `limits`: {min, max, integer, linear}; `typical`: a typical value of this key, used if the current value is 0. Returns
// {low, high, position(value), value(position)}, positions from 0 to STEPS.
export function scaleAround(value, limits, typical) {
  const { min, max } = limits;
  if (isLogarithmic(value, limits)) {
    return logarithmic(value, limits, typical);
  }
  const reach = Math.max(2 * Math.abs(value), typical);
  const low = clamp(min < 0 ? -reach : 0, min, max);
  const high = clamp(reach, min, max);
  const position = (at) => Math.round(STEPS * clamp((at - low) / (high - low), 0, 1));
  const fine = Math.pow(10, Math.floor(Math.log10((high - low) / STEPS)));
  const raw = (at) => low + ((high - low) * at) / STEPS;
  const step = limits.integer ? 1 : fine;
  return { low, high, position, value: (at) => clamp(Number((Math.round(raw(at) / step) * step).toPrecision(12)), low, high) };
}

function isLogarithmic(value, { min, max, linear }) {
  return !linear && value >= 0 && (min > 0 ? max / min >= LOG_FROM_RATIO : max >= LOG_FROM_RATIO);
}

function logarithmic(value, { min, max }, typical) {
  const middle = value > 0 ? value : typical;
  const low = Math.max(min, rounded(middle / LOG_SPAN));
  const high = Math.min(max, rounded(middle * LOG_SPAN));
  const zero = min <= 0 ? 1 : 0; // the leftmost position is 0 if 0 is allowed
  const steps = STEPS - zero;
  const position = (at) =>
    zero && at <= 0 ? 0 : zero + Math.round((steps * Math.log(clamp(at, low, high) / low)) / Math.log(high / low));
  const valueAt = (at) => {
    if (zero && at < 1) {
      return 0;
    }
    const found = low * Math.pow(high / low, (at - zero) / steps);
    return at >= STEPS ? high : clamp(rounded(found), low, high);
  };
  return { low, high, position, value: valueAt };
}

// Returns whether a value is so near an end of the scale that the scale should move when the slider is released.
export function atEnd(scale, value) {
  const position = scale.position(value);
  return value < scale.low || value > scale.high || position < 0.04 * STEPS || position > 0.96 * STEPS;
}
