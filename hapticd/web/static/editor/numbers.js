// Numbers in practical units (mm, ms, degrees), while the daemon has SI units.
//
// The decimal point is moved in the text, not by a multiplication, so that 6.48 ms is exactly the double 0.00648.

// By the schema's unit: the shown unit, the decimal places to it, and its name for screen readers.
const SHOWN_UNITS = {
  m: ["mm", 3, "millimetres"],
  s: ["ms", 3, "milliseconds"],
  "m/s": ["mm/s", 3, "millimetres per second"],
  rad: ["°", null, "degrees"],
  kg: ["g", 3, "grams"],
  Hz: ["Hz", 0, "hertz"],
  N: ["N", 0, "newtons"],
  "N/m": ["N/m", 0, "newtons per metre"],
  "N s/m": ["N s/m", 0, "newton seconds per metre"],
  "1/s": ["1/s", 0, "per second"],
  "m/s^2": ["m/s²", 0, "metres per second squared"],
  "m/s^2/N": ["m/s²/N", 0, "metres per second squared per newton"],
  "m^2/s^4": ["m²/s⁴", 0, "metres squared per second to the fourth"],
  "rad/s": ["rad/s", 0, "radians per second"],
};
const DEGREES_PER_RAD = 180 / Math.PI;
const SIGNIFICANT_DIGITS = 7;
export const NOT_A_NUMBER_TEXT = "Must be a number, such as 6.48.";

// Returns {si, text, spoken, places}: how values of a schema's unit are shown; unknown units are not converted.
export function shownUnit(si) {
  if (si === undefined || si === null) {
    return { si: "", text: "", spoken: "", places: 0 };
  }
  const [text, places, spoken] = SHOWN_UNITS[si] ?? [si, 0, si];
  return { si, text, spoken, places };
}

// Returns a number's text with the decimal point moved to the right.
function moved(value, places) {
  const [mantissa, exponent = "0"] = String(value).split("e");
  return Number(`${mantissa}e${Number(exponent) + places}`);
}

export function toShown(value, unit) {
  return unit.places === null ? value * DEGREES_PER_RAD : moved(value, unit.places);
}

export function fromShown(value, unit) {
  return unit.places === null ? value / DEGREES_PER_RAD : moved(value, -unit.places);
}

// Returns a value in SI units as text in the shown unit, without the unit.
export function format(value, unit) {
  const shown = toShown(value, unit);
  const rounded = Number(shown.toPrecision(unit.places === null ? 6 : SIGNIFICANT_DIGITS));
  return Math.abs(rounded) < 1e-12 && unit.places === null ? "0" : String(rounded);
}

// Returns the value in SI units of a text in the shown unit; NaN if it is not a number.
export function parse(text, unit) {
  const trimmed = text.trim().replace("\u2212", "-");
  return /^[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?$/i.test(trimmed) ? fromShown(Number(trimmed), unit) : NaN;
}

// Returns a value with its unit for a sentence, with `digits` significant digits.
export function withUnit(value, si, digits = 4) {
  const unit = shownUnit(si);
  const number = String(Number(toShown(value, unit).toPrecision(digits)));
  return unit.text === "" ? number : unit.text === "°" ? `${number}°` : `${number} ${unit.text}`;
}
