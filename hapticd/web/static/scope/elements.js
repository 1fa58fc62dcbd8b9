// Choices and check boxes, and numbers as text.
import { make } from "../dom.js";

export function options(select, entries, chosen) {
  select.replaceChildren(
    ...entries.map(([value, label]) => make("option", { value, selected: value === chosen }, label)),
  );
  select.value = chosen;
  return select;
}

// A check box with its label.
export function check(label, checked, onchange, attributes = {}) {
  const box = make("input", {
    type: "checkbox",
    checked,
    on: { change: (event) => onchange(event.target.checked) },
    ...attributes,
  });
  return make("label", { class: "check" }, box, label);
}

// A number with `digits` significant digits and a true minus sign.
export function figure(value, digits = 4) {
  if (!Number.isFinite(value)) {
    return "–";
  }
  const size = Math.abs(value);
  const text = size >= 10 ** digits ? value.toFixed(0) : Number(value.toPrecision(digits)).toString();
  const fixed =
    /e/.test(text) || size === 0 ? text : value.toFixed(Math.max(0, digits - 1 - Math.floor(Math.log10(size))));
  return fixed.replace("-", "−");
}

// A ratio in percent, with its sign.
export function percent(ratio) {
  const text = (100 * ratio).toFixed(2);
  return Number(text) === 0 ? "0.00 %" : `${ratio > 0 ? "+" : "−"}${text.replace("-", "")} %`;
}

// Seconds in the unit that suits a width of `widthS`.
export function timeUnit(widthS) {
  return widthS < 1 ? { unit: "ms", factor: 1e3 } : { unit: "s", factor: 1 };
}

// A duration as text: 20 ms, 1.5 s.
export function duration(seconds, digits = 3) {
  const size = Math.abs(seconds);
  if (size >= 1) {
    return `${figure(seconds, digits)} s`;
  }
  return size >= 1e-3 || size === 0 ? `${figure(seconds * 1e3, digits)} ms` : `${figure(seconds * 1e6, digits)} µs`;
}
