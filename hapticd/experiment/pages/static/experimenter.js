// The experimenter's page: the state of the daemon, the session, the oscilloscope and the answers. Like /static/main.js
// it is built of panels, which share `app.session`:
//
//   app.session.state, .rows     state of the session (hapticd/experiment/pages/console.py), and its answers
//   app.session.goOn()           press the button to continue
//   app.session.command(kind)    send a command: pause, repeat, abort, note
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

  // Requests the state and the new answers. If the connection is lost meanwhile, the next one requests them again.
  async watch() {
    try {
      const state = await this.#app.link.call("experiment.watch", { since: this.rows.length });
      this.rows.push(...state.rows.slice(this.rows.length - state.since));
      this.#changed(state);
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

  async #got(state) {
    this.#changed(state);
    if (state.answers > this.rows.length && !this.#asking) {
      this.#asking = true;
      await this.watch().finally(() => (this.#asking = false));
    }
  }

  #changed(state) {
    this.state = state;
    if (state.doing === "over") {
      this.#app.link.end();
    }
    this.dispatchEvent(new Event("change"));
  }
}

// The stop button, which also ends the session.
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
