// A form that takes a new name, hidden until it is opened.
import { make, newId } from "../dom.js";

export class RenameForm {
  element;
  #input;

  // `rename` is called with the new name.
  constructor(rename) {
    const id = newId("rename");
    this.#input = make("input", { type: "text", id, maxlength: 64 });
    const submit = (event) => {
      event.preventDefault();
      rename(this.#input.value.trim());
    };
    const keydown = (event) => {
      if (event.key === "Escape") {
        event.preventDefault(); // or it would stop the forces
        this.close();
      }
    };
    this.element = make(
      "form",
      { class: "row", hidden: true, on: { submit, keydown } },
      make("label", { for: id, text: "New name" }),
      this.#input,
      make("button", { class: "button small", text: "Rename" }),
    );
  }

  open(name) {
    this.element.hidden = false;
    this.#input.value = name;
    this.#input.focus();
    this.#input.select();
  }

  close() {
    this.element.hidden = true;
  }
}
