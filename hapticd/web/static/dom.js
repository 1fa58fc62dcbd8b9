// Functions that make elements in one line, and unique ids.

let last = 0;
export const newId = (name) => `${name}-${++last}`;

// An element. Attributes that are false or null are left out; `on`: listeners by event; `data`: data attributes.
export function make(tag, attributes = {}, ...children) {
  const { on = {}, data = {}, text, ...rest } = attributes;
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(rest)) {
    if (value !== false && value !== null && value !== undefined) {
      element.setAttribute(name, value === true ? "" : value);
    }
  }
  for (const [name, value] of Object.entries(data)) {
    element.dataset[name] = value;
  }
  for (const [name, listener] of Object.entries(on)) {
    element.addEventListener(name, listener);
  }
  if (text !== undefined) {
    element.textContent = text;
  }
  element.append(...children.filter((child) => child !== null));
  return element;
}

export function button(text, classes, action, attributes = {}) {
  return make("button", { type: "button", class: `button ${classes}`, text, on: { click: action }, ...attributes });
}

// A label that opens the browser's choice of a file, and its hidden input; `chosen` is called with the file.
export function fileChooser(id, text, accept, chosen, attributes = {}) {
  const change = () => {
    const [file] = input.files;
    input.value = "";
    if (file !== undefined) {
      chosen(file);
    }
  };
  const input = make("input", { id, class: "visually-hidden", type: "file", accept, on: { change }, ...attributes });
  return [make("label", { for: id, class: "button file-button" }, text), input];
}

// Fills a <select> with [value, text] pairs, but only if they changed, so that an open list stays open.
export function fill(select, pairs, chosen) {
  const key = JSON.stringify(pairs);
  if (select.dataset.pairs !== key) {
    select.dataset.pairs = key;
    select.replaceChildren(...pairs.map(([value, text]) => make("option", { value, text })));
  }
  if (select.value !== chosen) {
    select.value = chosen;
  }
}

export function svg(tag, attributes, ...children) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) {
    element.setAttribute(name, value);
  }
  element.append(...children);
  return element;
}
