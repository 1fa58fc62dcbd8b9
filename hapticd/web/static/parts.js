// Loads and mounts the parts of the page, each once. A part that fails shows the error in its place and does not affect the
// others, above all the stop. It is mounted again when its button is pressed or the connection is restored.
import { button, make } from "./dom.js";

export class Parts {
  #app;
  #load;
  #failed = new Map(); // path by id
  #last = Promise.resolve();

  constructor(app, load = (path) => import(path)) {
    this.#app = app;
    this.#load = load;
  }

  // `parts`: [[id of its element, path of its module], ...], mounted one after the other, after those of calls before.
  mount(parts) {
    return this.#queue(() => parts);
  }

  // Mounts the parts that failed. Mounted parts are left alone, so that no listener is added twice.
  mountFailed() {
    return this.#queue(() => [...this.#failed]);
  }

  get failed() {
    return [...this.#failed.keys()];
  }

  #queue(parts) {
    this.#last = this.#last.then(async () => {
      for (const [id, path] of parts()) {
        await this.#mountOne(id, path);
      }
    });
    return this.#last;
  }

  async #mountOne(id, path) {
    const element = document.getElementById(id);
    element.querySelector(":scope > .part-failed")?.remove();
    const before = [...element.childNodes];
    try {
      const part = await this.#load(path);
      await part.mount(this.#app, element);
      this.#failed.delete(id);
    } catch (error) {
      console.error(error);
      this.#failed.set(id, path);
      const again = button("Try again", "small", () => this.mountFailed());
      const text = `This part of the page failed: ${error.message}`;
      element.replaceChildren(...before, make("div", { class: "part-failed", role: "alert" }, make("p", { text }), again));
    }
  }
}
