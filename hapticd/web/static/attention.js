// Whether anybody looks: a page that has been hidden for 10 s does not ask for samples and states any more, and does so
// again when it is shown. What goes on without being seen (sound) says `hold("sound")`, and `release("sound")` at its end.
const HIDDEN_S = 10;
const ALWAYS = ["event", "change", "status"];
const ALL = ["samples", "state", ...ALWAYS];

export class Attention {
  resting = false;
  since = Infinity; // performance.now() from which on telemetry is due
  #held = new Set();
  #timer = null;
  #app;

  constructor(app, hidden_s = HIDDEN_S) {
    this.#app = app;
    this.hidden_s = hidden_s;
    document.addEventListener("visibilitychange", () => this.#look());
  }

  async begin() {
    await this.#app.link.subscribe(ALL);
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
        this.#app.samples.expectGap(); // what was left out meanwhile is no loss
      }
      this.#app.link.subscribe(resting ? ALWAYS : ALL);
    }
  }
}
