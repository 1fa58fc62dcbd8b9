// What pages share that are put together of parts (main.js says what `app` has): the page of `hapticd web`, and the
// experimenter's of a session.
import { Attention } from "./attention.js";
import { Link } from "./connection.js";
import { Model } from "./model.js";
import { Parts } from "./parts.js";
import { Playback } from "./playback.js";
import { SampleStore } from "./samples.js";
import { Timing } from "./timing.js";

// `newSafety(app)` makes who holds the forces; it may put more into `app`.
export function newApp(newSafety) {
  const link = new Link(new URL("/socket", location.href));
  const app = { link, samples: new SampleStore(60), model: new Model(link), view: new EventTarget() };
  globalThis.hapticd = app; // for tests, and for whoever is curious in the console
  app.playback = new Playback(link, app.view);
  app.safety = newSafety(app);
  app.timing = new Timing(app);
  app.attention = new Attention(app);
  app.model.addEventListener("status", () => app.samples.setRate(app.model.rateHz));
  link.addEventListener("samples", (event) => app.samples.add(event.detail));
  app.parts = new Parts(app);
  return app;
}

// `frame` needs no daemon and comes first, `parts` after everything is here. `load` is what is asked for at the beginning and
// after a lost connection.
export async function begin(app, frame, parts, load = () => app.model.load()) {
  await app.parts.mount(frame);
  await app.link.open();
  app.link.addEventListener("open", () => load().then(() => app.parts.mountFailed()));
  await app.model.load();
  await app.attention.begin();
  await app.parts.mount(parts);
}
