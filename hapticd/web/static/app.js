// What the page of `hapticd web` and the experimenter's page of a session share. main.js describes `app`.
import { Attention } from "./attention.js";
import { Link } from "./connection.js";
import { Model } from "./model.js";
import { Parts } from "./parts.js";
import { Playback } from "./playback.js";
import { SampleStore } from "./samples.js";
import { Timing } from "./timing.js";

// `newSafety(app)` makes the object that controls the forces; it may add members to `app`.
export function newApp(newSafety) {
  const link = new Link(new URL("/socket", location.href));
  const app = { link, samples: new SampleStore(60), model: new Model(link), view: new EventTarget() };
  globalThis.hapticd = app; // for tests, and for the browser's console
  app.playback = new Playback(link, app.view);
  app.safety = newSafety(app);
  app.timing = new Timing(app);
  app.attention = new Attention(app);
  app.model.addEventListener("status", () => app.samples.setRate(app.model.rateHz));
  link.addEventListener("samples", (event) => app.samples.add(event.detail));
  app.parts = new Parts(app);
  return app;
}

// The parts of `frame` need no daemon and are mounted first, those of `parts` once `load` has resolved. `load` is called at
// the beginning and after a lost connection.
export async function begin(app, frame, parts, load = () => app.model.load()) {
  await app.parts.mount(frame);
  await app.link.open();
  app.link.addEventListener("open", () => load().then(() => app.parts.mountFailed()));
  await app.model.load();
  await app.attention.begin();
  await app.parts.mount(parts);
}
