// Two cursors, which are dragged or moved by keys, and the table of their readings: time, value, difference, and the
// frequency whose period is the distance between them. The table's first row is the legend of the traces.
import { make } from "../dom.js";
import { CHANNEL } from "./channels.js";
import { figure, timeUnit } from "./elements.js";

const CURSOR_NAMES = ["A", "B"];
const INITIAL_POSITIONS = [0.25, 0.75]; // initial positions, as fractions of the width
const READING_DIGITS = 5;

// Returns the value of the sample nearest to a time, or NaN if none is within a period.
export function valueAt(source, id, time) {
  const row = nearestRow(source, time);
  return row < 0 ? NaN : source.track(id).column[row % source.capacity] * CHANNEL[id].factor;
}

function nearestRow(source, time) {
  const after = source.rowAt(time);
  let best = -1;
  let nearest = 1.01 * source.periodS;
  for (let row = Math.max(source.first, after - 1); row < Math.min(source.rows, after + 1); row++) {
    const away = Math.abs(source.time[row % source.capacity] - time);
    if (away < nearest) {
      [best, nearest] = [row, away];
    }
  }
  return best;
}

// Event: `move`, when a cursor was moved, or the cursors were shown or hidden.
export class Cursors extends EventTarget {
  shown = false;
  times = [0, 0]; // from the axis' zero, s
  #handles;
  #view;
  #source = null;
  #plot;

  constructor(host, view, plot) {
    super();
    this.#view = view;
    this.#plot = plot;
    this.#handles = CURSOR_NAMES.map((name, k) => this.#handle(name, k));
    this.area = make("div", { class: "scope-cursors", hidden: true }, ...this.#handles);
    host.append(this.area);
  }

  #handle(name, k) {
    const handle = make(
      "div",
      {
        class: "scope-cursor",
        role: "slider",
        tabindex: "0",
        "aria-label": `Cursor ${name}`,
        on: { keydown: (event) => this.#key(event, k), pointerdown: (event) => {
          handle.setPointerCapture(event.pointerId);
          event.stopPropagation();
        }, pointermove: (event) => {
          if (handle.hasPointerCapture(event.pointerId)) {
            this.#drag(event, k);
          }
        } },
      },
      make("span", { class: "scope-cursor-name", "aria-hidden": "true" }, name),
    );
    return handle;
  }

  show(shown) {
    this.shown = shown;
    this.area.hidden = !shown;
    if (shown) {
      const { left, widthS, zero } = this.#view;
      this.times = INITIAL_POSITIONS.map((share) => left - zero + share * widthS);
    }
    this.dispatchEvent(new Event("move"));
  }

  #drag(event, k) {
    const box = this.area.getBoundingClientRect();
    this.#moveTo(k, (event.clientX - box.left) / box.width);
  }

  #key(event, k) {
    const pixel = 1 / Math.max(1, this.area.clientWidth);
    const share = (this.times[k] + this.#view.zero - this.#view.left) / this.#view.widthS;
    const to = {
      ArrowLeft: share - pixel * (event.shiftKey ? 10 : 1),
      ArrowDown: share - pixel * (event.shiftKey ? 10 : 1),
      ArrowRight: share + pixel * (event.shiftKey ? 10 : 1),
      ArrowUp: share + pixel * (event.shiftKey ? 10 : 1),
      PageDown: share - 0.1,
      PageUp: share + 0.1,
      Home: 0,
      End: 1,
    }[event.key];
    if (to !== undefined) {
      event.preventDefault();
      event.stopPropagation();
      this.#moveTo(k, to);
    }
  }

  #moveTo(k, share) {
    const { left, widthS, zero } = this.#view;
    let time = left + Math.min(1, Math.max(0, share)) * widthS;
    // If the distance of samples is at least 4 pixels, a cursor snaps to a sample.
    const source = this.#source;
    if (source !== null && (source.periodS / widthS) * this.area.clientWidth >= 4) {
      const row = nearestRow(source, time);
      time = row < 0 ? time : source.time[row % source.capacity];
    }
    this.times[k] = time - zero;
    this.dispatchEvent(new Event("move"));
  }

  // Moves the cursors to their positions in the current window.
  place(source) {
    this.#source = source;
    if (!this.shown) {
      return;
    }
    const box = this.#plot.cssBox;
    for (const name of ["left", "top", "width", "height"]) {
      this.area.style[name] = `${box[name]}px`;
    }
    const { left, widthS, zero } = this.#view;
    const { unit, factor } = timeUnit(widthS);
    this.#handles.forEach((handle, k) => {
      const share = (this.times[k] + zero - left) / widthS;
      handle.style.transform = `translateX(${Math.min(1, Math.max(0, share)) * box.width}px)`;
      handle.classList.toggle("outside", share < 0 || share > 1);
      handle.setAttribute("aria-valuemin", String((left - zero) * factor));
      handle.setAttribute("aria-valuemax", String((left - zero + widthS) * factor));
      handle.setAttribute("aria-valuenow", String(this.times[k] * factor));
      handle.setAttribute("aria-valuetext", `${figure(this.times[k] * factor, READING_DIGITS)} ${unit}`);
    });
  }

  // Returns the section between the cursors, in the store's time.
  get stretch() {
    const { zero } = this.#view;
    return [Math.min(...this.times) + zero, Math.max(...this.times) + zero];
  }

  // Returns the readings: rows of [name, time, frequency, value of each channel], as text.
  readings(source, ids) {
    const { unit, factor } = timeUnit(this.#view.widthS);
    const [a, b] = this.times;
    const of = (time) => ids.map((id) => valueAt(source, id, time + this.#view.zero));
    const [atA, atB] = [of(a), of(b)];
    const text = (values) => values.map((value, k) => `${figure(value, READING_DIGITS)} ${CHANNEL[ids[k]].unit}`);
    const time = (value) => `${figure(value * factor, READING_DIGITS)} ${unit}`;
    return [
      ["A", time(a), "", ...text(atA)],
      ["B", time(b), "", ...text(atB)],
      [
        "B − A",
        time(b - a),
        `${figure(1 / Math.abs(b - a), READING_DIGITS)} Hz`,
        ...text(atB.map((value, k) => value - atA[k])),
      ],
    ];
  }
}

// Legend and readings as a table.
export class Legend {
  #table = make("table", { class: "table scope-legend" });
  #cells = [];
  #text = [];
  #ids = [];

  constructor(host) {
    host.append(this.#table);
  }

  configure(ids, withCursors) {
    this.#ids = ids;
    const heads = ids.map((id) =>
      make("th", { scope: "col" }, make("span", { class: `scope-swatch trace-${id}` }), CHANNEL[id].label),
    );
    const times = withCursors
      ? [make("th", { scope: "col" }, "Time"), make("th", { scope: "col" }, "1/(B − A)")]
      : [];
    const first = withCursors ? [make("th", { scope: "col" }, "Cursor")] : [];
    this.#cells = [];
    const rows = [];
    for (let k = 0; withCursors && k < 3; k++) {
      const cells = Array.from({ length: ids.length + 2 }, () => make("td", { class: "number" }, "–"));
      this.#cells.push([make("th", { scope: "row" }), ...cells]);
      rows.push(make("tr", {}, ...this.#cells[k]));
    }
    this.#text = this.#cells.map((cells) => cells.map(() => null));
    const caption = make("caption", { class: "visually-hidden" }, withCursors ? "Cursor readings" : "Traces");
    const head = make("thead", {}, make("tr", {}, ...first, ...times, ...heads));
    this.#table.replaceChildren(caption, head, make("tbody", {}, ...rows));
  }

  update(cursors, source) {
    if (this.#cells.length === 0 || source.rows === 0) {
      return;
    }
    cursors.readings(source, this.#ids).forEach((row, k) =>
      row.forEach((text, column) => {
        if (this.#text[k][column] !== text) {
          this.#text[k][column] = text;
          this.#cells[k][column].textContent = text;
        }
      }),
    );
  }
}
