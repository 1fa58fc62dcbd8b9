// Who holds the forces, and the stop. One page at a time holds them, by the daemon's lease of 1 s, which its heartbeat
// renews: forces that a page turned on fade when it is closed, freezes or loses the connection. Whoever does not hold the
// forces watches, and may stop them, too.
//
//   begin()                at a press on the scene: takes the forces of the simulated joystick. True: this page holds them.
//   engage()               by the button: of a real device, too, and after a stop or a fault
//   stop()                 forces off, at once, whoever holds them. After it only the button turns them on
//
// The hand of the simulated joystick is moved by the page that holds the forces (`holds`).
// Events: `change`, when anything of this changed: `holder`, `forces`, `faults`, `stopping`, `problem`.
import { CallError, CONNECTION_LOST } from "./connection.js";

export const LEASE_S = 1;
const FORCES_OFF = -32003;
const LEASE_HELD = -32004;

export class Safety extends EventTarget {
  forces = "unknown"; // on, off, faulted, unknown
  faults = [];
  stopping = false; // the stop was pressed, and the daemon has not answered yet
  problem = ""; // why the last thing that was asked for was not done
  #app;
  #token = null;
  #another = false; // somebody else holds the lease
  #renewing = false;
  #asked = 0; // raised by each stop: what was begun before it is given up
  #engaging = null;
  #unsentStop = false;
  #sinceTick = 0; // telemetry of before this tick is older than an answer that is known already
  #startedNs = null; // of the daemon
  #endedAt = -Infinity; // when this page ended a lease
  #worker = new Worker(new URL("./heartbeat_worker.js", import.meta.url));

  constructor(app) {
    super();
    this.#app = app;
    this.#worker.onmessage = () => this.#beat();
    app.model.addEventListener("status", () => this.#gotStatus());
    app.model.addEventListener("state", () => this.#gotState());
    app.link.addEventListener("open", () => {
      if (this.#unsentStop) {
        this.stop();
      }
    });
    app.link.addEventListener("close", () => this.#set({ forces: "unknown" }));
  }

  get holds() {
    return this.#token !== null;
  }

  // "this page", "another" (page or program), or null.
  get holder() {
    return this.holds ? "this page" : this.#another ? "another" : null;
  }

  get simulated() {
    return this.#app.model.status.device === "sim";
  }

  #set(news) {
    Object.assign(this, news);
    this.dispatchEvent(new Event("change"));
  }

  #refuse(problem) {
    this.#set({ problem });
    this.#app.view.dispatchEvent(new CustomEvent("notice", { detail: { text: problem, kind: "error" } }));
    return false;
  }

  // ---- What the daemon says ----------------------------------------------------------------------------------------

  #gotStatus() {
    const { forces, faults, lease_s, tick, started_ns } = this.#app.model.status;
    if (started_ns !== this.#startedNs) {
      this.#startedNs = started_ns;
      this.#sinceTick = 0;
    }
    if (tick < this.#sinceTick) {
      return;
    }
    // A status that was under way when this page ended its lease still has it.
    this.#another = lease_s !== null && !this.holds && performance.now() - this.#endedAt > 1e3 * LEASE_S;
    this.#set({ forces, faults });
    this.#giveUpWhatIsOff();
  }

  // 60 times a second, where the status comes once.
  #gotState() {
    const { tick, flag_names: flags } = this.#app.model.state;
    if (tick < this.#sinceTick) {
      return;
    }
    const forces = flags.includes("fault") ? "faulted" : flags.includes("forces_on") ? "on" : "off";
    if (forces !== this.forces) {
      this.#set({ forces, faults: forces === "faulted" ? this.faults : [] });
      this.#giveUpWhatIsOff();
    }
  }

  // Somebody else stopped, or a fault did: there is nothing to hold any more.
  #giveUpWhatIsOff() {
    if (this.holds && this.#engaging === null && this.forces !== "on") {
      this.#endLease();
    }
  }

  // ---- Taking the forces -------------------------------------------------------------------------------------------

  engage({ press = false } = {}) {
    if (this.holds && this.#engaging === null) {
      return Promise.resolve(true);
    }
    if (press && this.#engaging === null) {
      const refusal = this.#refusalOfPress();
      if (refusal !== null) {
        return Promise.resolve(this.#refuse(refusal));
      }
    }
    this.#engaging ??= this.#engage(this.#asked).finally(() => {
      this.#engaging = null;
      this.dispatchEvent(new Event("change"));
    });
    return this.#engaging;
  }

  // As a press on the scene does.
  begin() {
    return this.engage({ press: true });
  }

  #refusalOfPress() {
    if (!this.simulated) {
      return "A press on the scene does not turn on the forces of a real device. The button at the top does.";
    }
    if (this.forces === "off") {
      return "Forces are off. “Turn forces on” at the top turns them on.";
    }
    // A lease that lapsed is a page that was closed: the next one goes on.
    if (this.faults.some((fault) => fault !== "lease")) {
      return "A fault keeps the forces off. The line at the top says which.";
    }
    return null;
  }

  async #engage(asked) {
    const { link } = this.#app;
    this.problem = "";
    try {
      const { token } = await link.call("lease", { duration_s: LEASE_S }, { timeout_s: LEASE_S });
      this.#token = token;
      this.#another = false;
      this.#worker.postMessage(true);
      if (asked === this.#asked) {
        this.#sinceTick = (await link.call("set_forces", { enabled: true }, { timeout_s: 2 })).tick;
      }
      if (asked !== this.#asked) {
        this.#endLease(token);
        return false;
      }
      this.#set({ forces: "on", faults: [] });
      return true;
    } catch (error) {
      return this.#notEngaged(error);
    }
  }

  #notEngaged(error) {
    if (!(error instanceof CallError)) {
      throw error;
    }
    this.#endLease();
    if (error.code === LEASE_HELD) {
      this.#another = true;
      return this.#refuse("Another page holds the forces. They are free 1 s after it is closed or gives them back.");
    }
    if (error.code === FORCES_OFF) {
      this.#set({ forces: "faulted", faults: error.data?.faults ?? this.faults });
      return this.#refuse("The cause of a fault is still there. Forces stay off.");
    }
    return this.#refuse(`Forces were not turned on: ${error.message}`);
  }

  // ---- Holding them ------------------------------------------------------------------------------------------------

  async #beat() {
    const token = this.#token;
    if (token === null || this.#renewing) {
      return; // beats that waited while the page was frozen count once
    }
    this.#renewing = true;
    try {
      await this.#app.link.call("lease", { duration_s: LEASE_S, token }, { timeout_s: LEASE_S });
    } catch (error) {
      // Without a connection it is tried again: within its second the lease can still be renewed by its token.
      if (!(error instanceof CallError)) {
        throw error;
      }
      if (error.code !== CONNECTION_LOST && this.#token === token) {
        this.#forget();
        this.#refuse("This page was held up for longer than 1 s, so the forces faded.");
      }
    } finally {
      this.#renewing = false;
    }
  }

  #forget() {
    this.#token = null;
    this.#worker.postMessage(false);
    this.dispatchEvent(new Event("change"));
  }

  // Ends the lease; if that is not heard, it lapses.
  #endLease(token = this.#token) {
    if (token !== null) {
      this.#forget();
      this.#endedAt = performance.now();
      this.#app.link.call("lease", { duration_s: 0, token }, { timeout_s: LEASE_S }).catch((error) => {
        if (!(error instanceof CallError)) {
          throw error;
        }
      });
    }
  }

  // ---- The stop ----------------------------------------------------------------------------------------------------

  // True when the daemon has turned the forces off.
  async stop() {
    this.#asked++;
    const { link } = this.#app;
    const answer = link.call("set_forces", { enabled: false }, { timeout_s: LEASE_S, urgent: true });
    // Whatever becomes of the answer: nothing is renewed any more.
    this.#worker.postMessage(false);
    const token = this.#token;
    this.#token = null;
    this.#unsentStop = false;
    this.#set({ stopping: true, problem: "" });
    try {
      const { forces, tick } = await answer;
      this.#sinceTick = tick;
      this.#endLease(token);
      this.#set({ forces, stopping: false });
      return true;
    } catch (error) {
      if (!(error instanceof CallError)) {
        throw error;
      }
      this.#unsentStop = true; // as soon as there is a connection again
      this.#set({ stopping: false });
      return this.#refuse(
        token === null
          ? "The stop did not reach the daemon. It is sent again as soon as there is a connection."
          : "The stop did not reach the daemon. The forces fade within 1 s, as this page does not renew its lease.",
      );
    }
  }
}
