// Visibility of the page: 10 s after it was hidden it unsubscribes from samples and states, until it is shown again. A
// function that works on a hidden page (sound) calls `hold("sound")`, and `release("sound")` at its end.
const UNSUBSCRIBE_AFTER_S = 10;
const TOPICS_WHEN_HIDDEN = ["event", "change", "status"];
const TOPICS_WHEN_SHOWN = ["samples", "state", ...TOPICS_WHEN_HIDDEN];

export class Attention {
  resting = false;
  since = Infinity; // performance.now() since which samples are subscribed to
  #held = new Set();
  #timer = null;
  #app;

  constructor(app, hidden_s = UNSUBSCRIBE_AFTER_S) {
    this.#app = app;
    this.hidden_s = hidden_s;
    document.addEventListener("visibilitychange", () => this.#look());
  }

  async begin() {
    await this.#app.link.subscribe(TOPICS_WHEN_SHOWN);
    this.since = performance.now();
  }

  hold(name) {
    this.#held.add(name);
    this.#look();
  }

  release(name) {
    this.#held.delete(name);
    this.#look();
  }

  #look() {
    clearTimeout(this.#timer);
    if (!document.hidden || this.#held.size > 0) {
      this.#rest(false);
    } else {
      this.#timer = setTimeout(() => this.#rest(true), 1e3 * this.hidden_s);
    }
  }

  #rest(resting) {
    if (resting !== this.resting) {
      this.resting = resting;
      if (!resting) {
        this.#app.samples.expectGap(); // the samples left out meanwhile do not count as lost
      }
      this.#app.link.subscribe(resting ? TOPICS_WHEN_HIDDEN : TOPICS_WHEN_SHOWN);
    }
  }
}
