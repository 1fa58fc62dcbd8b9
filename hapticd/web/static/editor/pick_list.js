// A list of which one entry is selected, by the pointer or by the arrow keys, Home and End.
import { make } from "../dom.js";

export class PickList {
  element;
  #pick;
  #prefix;
  #names = [];
  #picked = null;
  #shown = null;

  // `prefix`: prefix of the entries' ids. `pick` is called with the name of a selected entry.
  constructor(label, prefix, pick) {
    this.#prefix = prefix;
    this.#pick = pick;
    const on = { keydown: (event) => this.#key(event) };
    this.element = make("div", { class: "pick-list", role: "listbox", "aria-label": label, tabindex: 0, on });
  }

  // `entries`: [name, note] each, in their order; `empty`: the text of an empty list.
  show(entries, picked, empty) {
    const key = JSON.stringify([entries, picked]);
    if (this.#shown === key) {
      return;
    }
    this.#shown = key;
    this.#names = entries.map(([name]) => name);
    this.#picked = picked;
    const options = entries.map(([name, note], index) => this.#option(name, note, index));
    this.element.replaceChildren(...(options.length ? options : [make("p", { class: "empty", text: empty })]));
    const selected = options[this.#names.indexOf(picked)];
    if (selected) {
      this.element.setAttribute("aria-activedescendant", selected.id);
      this.#scrollTo(selected);
    } else {
      this.element.removeAttribute("aria-activedescendant");
    }
  }

  #option(name, note, index) {
    const attributes = { role: "option", id: `${this.#prefix}-option-${index}`, "aria-selected": String(name === this.#picked) };
    const on = { click: () => this.#pick(name) };
    const beside = note ? make("span", { class: "in-scene", text: note }) : null;
    return make("div", { class: "option", ...attributes, data: { name }, on }, make("span", { text: name }), beside);
  }

  #key(event) {
    const at = this.#names.indexOf(this.#picked);
    const to = { ArrowDown: at + 1, ArrowUp: at - 1, Home: 0, End: this.#names.length - 1 }[event.key];
    if (to !== undefined && this.#names[to] !== undefined) {
      event.preventDefault();
      this.#pick(this.#names[to]);
    }
  }

  // Scrolls only the list, not the page.
  #scrollTo(option) {
    const list = this.element;
    const [top, bottom] = [option.offsetTop - list.offsetTop, option.offsetTop - list.offsetTop + option.offsetHeight];
    list.scrollTop = Math.min(Math.max(list.scrollTop, bottom - list.clientHeight), top);
  }
}
