// Notices of all modules: `app.view.dispatchEvent(new CustomEvent("notice", {detail: {text, kind}}))`, kind `info` or
// `error`. An error stays until it is closed, an info for 6 s. The same text is shown once.
import { button, make } from "./dom.js";

const INFO_SHOWN_S = 6;
const MAX_NOTICES = 4;

export function mount(app, element) {
  function show({ text, kind = "info" }) {
    for (const each of [...element.children]) {
      if (each.dataset.text === text) {
        each.remove();
      }
    }
    const close = button("Close", "quiet small", () => line.remove());
    const line = make("div", { class: `notice ${kind === "error" ? "bad" : ""}`, data: { text } }, make("p", { text }), close);
    element.append(line);
    while (element.children.length > MAX_NOTICES) {
      element.firstElementChild.remove();
    }
    if (kind !== "error") {
      setTimeout(() => line.remove(), 1e3 * INFO_SHOWN_S);
    }
  }

  app.view.addEventListener("notice", (event) => show(event.detail));
}
