// The origin of a fitted material's values (`provenance`): shown, not edited; it may be removed.
import { button, make } from "../dom.js";
import { isMap } from "./merge_patch.js";

function lines(value) {
  const { files = [], date, version, verdict, intervals, choices } = value;
  const rows = [
    ["Fitted on", date],
    ["With hapticd", version],
    ["From", files.map((file) => file.path).join(", ")],
  ];
  for (const [kind, { quality, reasons = [] }] of Object.entries(verdict ?? {})) {
    rows.push([`Fit of ${kind}`, [quality, ...reasons].join("; ")]);
  }
  for (const [name, [low, high]] of Object.entries(intervals ?? {})) {
    rows.push([name, `95 % between ${low} and ${high}`]);
  }
  for (const [name, why] of Object.entries(choices ?? {})) {
    rows.push([name, why]);
  }
  return rows;
}

export function originBlock(editor, path) {
  const value = editor.at(path);
  const rows = isMap(value) ? lines(value) : [];
  const problem = make("p", { class: "error-line", role: "alert" });
  const remove = button("Remove", "quiet small", async () => (problem.textContent = (await editor.change("origin", () => editor.patch(path, null))) ?? ""), { "aria-label": "Remove origin of the figures" });
  return make(
    "section",
    { class: "block", "aria-label": "Origin of the figures", data: { path: path.join(".") } },
    make("div", { class: "block-head" }, make("h3", { text: "Origin of the figures" }), remove),
    make("dl", { class: "facts" }, ...rows.flatMap(([name, text]) => [make("dt", { text: name }), make("dd", { text: String(text) })])),
    problem,
  );
}
