// The experimenter's page: the state of the daemon, the session, the oscilloscope, the answers. It is put together as
// /static/main.js is, of the same parts where there are such, and of `app.session`:
//
//   app.session.state, .rows     what the session does (hapticd/experiment/pages/console.py), and its answers
//   app.session.goOn()           what the button says that goes on
//   app.session.command(kind)    pause, repeat, abort, note
//
// Events of app.session: `change`.
import { begin, newApp } from "/static/app.js";
import { CallError, CONNECTION_LOST } from "/static/connection.js";
import { Safety } from "/static/safety.js";

const FRAME = [["notices", "/static/notices.js"], ["status-bar", "/static/status_bar.js"]];
const PARTS = [["session", "/experiment/session_panel.js"], ["answers", "/experiment/answers_panel.js"], ["scope", "/static/scope.js"]];

class Session extends EventTarget {
  state = null;
  rows = [];
  #app;
  #asking = false;

  constructor(app) {
    super();
    this.#app = app;
    app.link.addEventListener("web", (event) => event.detail.experiment && this.#got(event.detail.experiment));
  }

  // All that is new. Where the connection is lost meanwhile, that is asked for again with the next one.
  async watch() {
    try {
      const told = await this.#app.link.call("experiment.watch", { since: this.rows.length });
      this.rows.push(...told.rows.slice(this.rows.length - told.since));
      this.#changed(told);
    } catch (error) {
      if (error.code !== CONNECTION_LOST) {
        throw error;
      }
    }
  }

  goOn() {
    return this.say("go_on", { screen: this.state.screen });
  }

  command(kind, text = "") {
    return this.say("command", { kind, text });
  }

  async say(method, params) {
    try {
      await this.#app.link.call(`experiment.${method}`, params);
    } catch (error) {
      if (!(error instanceof CallError)) {
        throw error;
      }
      this.#app.view.dispatchEvent(new CustomEvent("notice", { detail: { text: error.message, kind: "error" } }));
    }
  }

  async #got(told) {
    this.#changed(told);
    if (told.answers > this.rows.length && !this.#asking) {
      this.#asking = true;
      await this.watch().finally(() => (this.#asking = false));
    }
  }

  #changed(told) {
    this.state = told;
    if (told.doing === "over") {
      this.#app.link.end();
    }
    this.dispatchEvent(new Event("change"));
  }
}

// The stop ends the session, too, not only the forces.
class SessionSafety extends Safety {
  #session;

  constructor(app) {
    super(app);
    this.#session = app.session;
  }

  stop() {
    const stopped = super.stop();
    this.#session.command("abort", "the experimenter pressed the stop");
    return stopped;
  }
}

const app = newApp((made) => {
  made.session = new Session(made);
  return new SessionSafety(made);
});
await begin(app, FRAME, PARTS, () => Promise.all([app.model.load(), app.session.watch()]));
await app.session.watch();
const heart = new Worker("/static/heartbeat_worker.js");
heart.onmessage = () => app.link.connected && app.link.notify("experiment.beat");
heart.postMessage(true);
document.body.dataset.ready = "true";
