// The state on the canvas as text: for screen readers, and as a line of numbers below the canvas.

const MAX_NAMED_OBJECTS = 3;

const mm = (metres) => (metres * 1000).toFixed(1);

// Returns a moment as text: "x 1.0 mm, y −2.5 mm, touching floor, 1.23 N".
export function words(moment, touching) {
  if (moment === null) {
    return "No samples yet";
  }
  const [x, y] = moment.position.map((value) => mm(value).replace("-0.0", "0.0").replace("-", "\u2212"));
  const named = touching.slice(0, MAX_NAMED_OBJECTS).join(", ");
  const more = touching.length > MAX_NAMED_OBJECTS ? ` and ${touching.length - MAX_NAMED_OBJECTS} more` : "";
  const contact = touching.length === 0 ? "touching nothing" : `touching ${named}${more}`;
  const force = Math.hypot(...moment.force).toFixed(2);
  return `x ${x} mm, y ${y} mm, ${contact}, ${force} N`;
}

const VISIBLE_INTERVAL_MS = 100;
const SPOKEN_INTERVAL_MS = 5000;

// Updates the visible text ten times a second, and a live region for screen readers at once when the touched objects
// change, otherwise at most every five seconds.
export class Description {
  #shown;
  #spoken;
  #touched = null;
  #shownAt = -Infinity;
  #spokenAt = -Infinity;
  #newest = [null, []];
  #timer = null;

  // Two elements: one is visible, one is for screen readers.
  constructor(shown, spoken) {
    this.#shown = shown;
    this.#spoken = spoken;
  }

  update(moment, touching) {
    this.#newest = [moment, touching];
    clearTimeout(this.#timer); // it may be set for a text several seconds later
    this.#speak();
  }

  #speak() {
    const now = performance.now();
    const [moment, touching] = this.#newest;
    const text = words(moment, touching);
    if (text !== this.#shown.textContent && now - this.#shownAt >= VISIBLE_INTERVAL_MS) {
      this.#shownAt = now;
      this.#shown.textContent = text;
    }
    const touched = moment === null ? null : touching.join("\n");
    if (text !== this.#spoken.textContent && (touched !== this.#touched || now - this.#spokenAt >= SPOKEN_INTERVAL_MS)) {
      this.#touched = touched;
      this.#spokenAt = now;
      this.#spoken.textContent = text;
    }
    const late = [[this.#shown, this.#shownAt + VISIBLE_INTERVAL_MS], [this.#spoken, this.#spokenAt + SPOKEN_INTERVAL_MS]]
      .filter(([element]) => element.textContent !== text)
      .map(([, at]) => at - now);
    if (late.length > 0) {
      this.#timer = setTimeout(() => this.#speak(), Math.max(0, Math.min(...late)));
    }
  }
}
