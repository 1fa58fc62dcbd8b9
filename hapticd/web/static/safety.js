// Control of the forces, and the stop. One page at a time controls them, by the daemon's lease of 1 s, which its heartbeat
// renews: forces that a page turned on fade when it is closed, freezes or loses the connection. Other pages only watch, but
// every page can stop the forces.
//
//   begin()                at a press on the scene: takes control of the simulated joystick's forces. True: this page has it
//   engage()               by the button: also with a real device, and after a stop or a fault
//   stop()                 turns forces off at once, also those of another page. Then only the button turns them on
//
// The page that controls the forces (`holds`) moves the hand of the simulated joystick.
// Event: `change`, when `holder`, `forces`, `faults`, `stopping` or `problem` changed.
import { CallError, CONNECTION_LOST } from "./connection.js";

export const LEASE_S = 1;
const FORCES_OFF_CODE = -32003;
const LEASE_HELD_CODE = -32004;

export class Safety extends EventTarget {
  forces = "unknown"; // on, off, faulted, unknown
  faults = [];
  stopping = false; // the stop was pressed, and the daemon has not answered yet
  problem = ""; // why the last action failed
  #app;
  #token = null;
  #another = false; // another page or program holds the lease
  #renewing = false;
  #asked = 0; // number of stops: a stop cancels what was begun before it
  #engaging = null;
  #unsentStop = false;
  #sinceTick = 0; // telemetry from before this tick is older than the last answer
  #startedNs = null; // start time of the daemon
  #endedAt = -Infinity; // time at which this page ended a lease
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

  // ---- State of the daemon -----------------------------------------------------------------------------------------

  #gotStatus() {
    const { forces, faults, lease_s, tick, started_ns } = this.#app.model.status;
    if (started_ns !== this.#startedNs) {
      this.#startedNs = started_ns;
      this.#sinceTick = 0;
    }
    if (tick < this.#sinceTick) {
      return;
    }
    // A status that was sent before this page ended its lease still contains the lease.
    this.#another = lease_s !== null && !this.holds && performance.now() - this.#endedAt > 1e3 * LEASE_S;
    this.#set({ forces, faults });
    this.#endLeaseIfOff();
  }

  // Called 60 times a second; the status comes only once a second.
  #gotState() {
    const { tick, flag_names: flags } = this.#app.model.state;
    if (tick < this.#sinceTick) {
      return;
    }
    const forces = flags.includes("fault") ? "faulted" : flags.includes("forces_on") ? "on" : "off";
    if (forces !== this.forces) {
      this.#set({ forces, faults: forces === "faulted" ? this.faults : [] });
      this.#endLeaseIfOff();
    }
  }

  // Another page or a fault turned the forces off: this page ends its lease.
  #endLeaseIfOff() {
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

  // Called at a press on the scene.
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
    // A lapsed lease belonged to a page that was closed: this page may continue.
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
    if (error.code === LEASE_HELD_CODE) {
      this.#another = true;
      return this.#refuse("Another page holds the forces. They are free 1 s after it is closed or gives them back.");
    }
    if (error.code === FORCES_OFF_CODE) {
      this.#set({ forces: "faulted", faults: error.data?.faults ?? this.faults });
      return this.#refuse("The cause of a fault is still there. Forces stay off.");
    }
    return this.#refuse(`Forces were not turned on: ${error.message}`);
  }

  // ---- Renewing the lease ------------------------------------------------------------------------------------------

  async #beat() {
    const token = this.#token;
    if (token === null || this.#renewing) {
      return; // beats that waited while the page was frozen count once
    }
    this.#renewing = true;
    try {
      await this.#app.link.call("lease", { duration_s: LEASE_S, token }, { timeout_s: LEASE_S });
    } catch (error) {
      // Tried again without a connection: until the lease lapses after a second, its token can still renew it.
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

  // Ends the lease; if the message is lost, the lease lapses.
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

  // Returns true once the daemon has turned the forces off.
  async stop() {
    this.#asked++;
    const { link } = this.#app;
    const answer = link.call("set_forces", { enabled: false }, { timeout_s: LEASE_S, urgent: true });
    // Regardless of the answer, the lease is not renewed any more.
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
      this.#unsentStop = true; // sent once the connection is restored
      this.#set({ stopping: false });
      return this.#refuse(
        token === null
          ? "The stop did not reach the daemon. It is sent again as soon as there is a connection."
          : "The stop did not reach the daemon. The forces fade within 1 s, as this page does not renew its lease.",
      );
    }
  }
}
