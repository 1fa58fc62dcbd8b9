// The frame of a field around its control: label, help, the daemon's problem, warnings.
import { button, make, newId } from "../dom.js";
import { shownUnit, withUnit } from "./numbers.js";

// `spec`: {definition, key, path, label, schema, required}. The control goes into `entry`; its aria-describedby is `describedBy`.
export function fieldFrame(editor, spec) {
  const ids = { control: newId("field"), problem: newId("problem"), warning: newId("warning"), help: newId("help") };
  const label = make("label", { for: ids.control, text: spec.label });
  const helpText = make("p", { class: "note field-help", id: ids.help, text: helpOf(spec), hidden: true });
  const help = button("?", "quiet small help-button", () => {
    helpText.hidden = !helpText.hidden;
    help.setAttribute("aria-expanded", String(!helpText.hidden));
  });
  help.setAttribute("aria-label", `About ${spec.label.toLowerCase()}`);
  help.setAttribute("aria-expanded", "false");
  help.setAttribute("aria-controls", ids.help);
  const entry = make("span", { class: "entry" });
  const problem = make("p", { class: "error-line", id: ids.problem, role: "alert" });
  const warning = make("p", { class: "warning-line", id: ids.warning });
  const element = make(
    "div",
    { class: "field", data: { path: spec.path.join(".") } },
    make("span", { class: "field-name" }, label, help),
    entry,
    problem,
    warning,
    helpText,
  );
  return {
    element,
    entry,
    ids,
    label,
    describedBy: `${ids.problem} ${ids.warning} ${ids.help}`,
    before: (child) => element.insertBefore(child, problem), // a slider, a table
    // `controls` are marked as invalid while there is a problem.
    showProblem(text, controls = []) {
      problem.textContent = text ? text[0].toUpperCase() + text.slice(1) : "";
      for (const control of controls) {
        text ? control.setAttribute("aria-invalid", "true") : control.removeAttribute("aria-invalid");
      }
    },
    showWarnings() {
      const text = editor.warningsAt(spec.path).join(" ");
      if (warning.textContent !== text) {
        warning.textContent = text;
      }
    },
  };
}

// Returns the help text: description, limits, default, and the daemon's key and unit.
export function helpOf({ schema, path, label }) {
  const lines = [schema.description ?? ""];
  const { minimum, maximum } = limitsOf(schema);
  if (minimum !== undefined && maximum !== undefined) {
    lines.push(`From ${withUnit(minimum, schema.unit)} to ${withUnit(maximum, schema.unit)}.`);
  }
  if (typeof schema.default === "number") {
    lines.push(`Usually ${withUnit(schema.default, schema.unit)}.`);
  }
  const unit = shownUnit(schema.unit);
  if (unit.text !== unit.si) {
    lines.push(unit.places === 0 ? `In files: ${path.at(-1)}.` : `In files: ${path.at(-1)}, in ${unit.si}.`);
  } else {
    lines.push(`In files: ${path.at(-1)}.`);
  }
  return lines.filter(Boolean).join(" ").trim() || label;
}

// Returns the limits of a number or of the components of a vector.
export function limitsOf(schema) {
  const part = schema.prefixItems?.[0] ?? schema;
  return { minimum: part.minimum, maximum: part.maximum };
}

// A problem has its limits in SI units, which is noted if the field shows another unit.
export function inShownUnit(problem, unit) {
  return problem && unit.places !== 0 && /\d/.test(problem) ? `${problem} (in ${unit.si})` : problem;
}
