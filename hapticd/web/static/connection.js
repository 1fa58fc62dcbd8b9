// The WebSocket to `hapticd web`: calls with answers, notifications, telemetry. hapticd/web/page.py has the messages.
//
// Where the connection is lost, it is tried again after 0.25 s, then each time after twice as long, 5 s at most; what was
// subscribed to is subscribed to again. A socket that has said nothing for 3 s is asked; without an answer it is given up.
import { decode, encode } from "./vendor/msgpack/index.mjs";

const FIRST_PAUSE_S = 0.25;
const LONGEST_PAUSE_S = 5;
const SILENCE_S = 3;
const MOST_WAITING = 256; // calls without an answer yet
const MOST_UNSENT = 1 << 20; // bytes that the browser has not sent yet; notifications are dropped far earlier
const MOST_UNSENT_NOTIFICATIONS = 16 << 10;

export const CONNECTION_LOST = 0; // CallError's code where no answer came; the others are those of docs/protocol.md

export class CallError extends Error {
  constructor(error) {
    super(error.message);
    this.code = error.code;
    this.data = error.data;
  }
}

// Events: `open`, `close`, each time; `waiting` {pause_s, refused} before another try; and each topic of telemetry by
// its name, the message in `detail`.
export class Link extends EventTarget {
  heardAt = 0; // performance.now() of the last message
  #silentS = 0; // seconds, counted while this page ran, without a message
  dropped = 0; // notifications that were not sent, because those before them were not sent yet
  #url;
  #socket = null;
  #lastId = 0;
  #waiting = new Map();
  #topics = null;
  #pause_s = FIRST_PAUSE_S;
  #retry = null;
  #watch = null;
  #ended = false;

  constructor(url) {
    super();
    this.#url = new URL(url);
    this.#url.protocol = this.#url.protocol === "https:" ? "wss:" : "ws:";
    globalThis.addEventListener("online", () => this.#tryNow());
    document.addEventListener("visibilitychange", () => document.hidden || this.#tryNow());
  }

  // Resolves with the first connection, and goes on connecting afterwards whenever it is lost.
  open() {
    const opened = new Promise((resolve) => this.addEventListener("open", resolve, { once: true }));
    this.#connect();
    return opened;
  }

  // From now on a connection that is lost is not looked for any more.
  end() {
    this.#ended = true;
    clearTimeout(this.#retry);
    this.#retry = null;
  }

  get connected() {
    return this.#socket !== null;
  }

  #connect() {
    this.#retry = null;
    const socket = new WebSocket(this.#url);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      this.#socket = socket;
      this.#pause_s = FIRST_PAUSE_S;
      this.heardAt = performance.now();
      this.#silentS = 0;
      this.#watch = setInterval(() => this.#askWhereSilent(), 1000);
      if (this.#topics !== null) {
        this.#subscribe();
      }
      this.dispatchEvent(new Event("open"));
    };
    socket.onmessage = (event) => this.#received(event.data);
    socket.onclose = () => this.#closed(socket);
  }

  #closed(socket) {
    if (this.#socket !== null && this.#socket !== socket) {
      return; // it was given up before, and another one took its place
    }
    clearInterval(this.#watch);
    const was = this.#socket;
    this.#socket = null;
    for (const { reject } of [...this.#waiting.values()]) {
      reject(new CallError({ code: CONNECTION_LOST, message: "the connection to hapticd web was lost" }));
    }
    if (was !== null) {
      this.dispatchEvent(new Event("close"));
    }
    this.#tryLater();
  }

  async #tryLater() {
    if (this.#ended) {
      return;
    }
    const pause_s = this.#pause_s;
    this.#pause_s = Math.min(2 * pause_s, LONGEST_PAUSE_S);
    clearTimeout(this.#retry);
    this.#retry = setTimeout(() => this.#connect(), 1e3 * pause_s);
    // A WebSocket does not tell why it was refused. A request does: 403 is another process, which wants its own link.
    const answer = await fetch("/", { method: "HEAD" }).catch(() => null);
    if (this.#socket === null) {
      this.dispatchEvent(new CustomEvent("waiting", { detail: { pause_s, refused: answer?.status === 403 } }));
    }
  }

  #tryNow() {
    if (this.#retry !== null && this.#socket === null) {
      clearTimeout(this.#retry);
      this.#connect();
    }
  }

  // Once a second. A page that was held up itself, as while it loads, has messages waiting: that is no silence.
  #askWhereSilent() {
    this.#silentS++;
    if (this.#silentS === SILENCE_S) {
      this.call("web.hello", {}, { timeout_s: 2 * SILENCE_S }).catch((error) => {
        if (error.code !== CONNECTION_LOST) {
          throw error;
        }
      });
    } else if (this.#silentS >= 2 * SILENCE_S) {
      const socket = this.#socket;
      socket.close(); // takes its time where the network is gone
      this.#closed(socket);
    }
  }

  // From now on telemetry of these topics comes, and of no others; over a lost connection, too.
  subscribe(topics) {
    this.#topics = [...topics];
    return this.connected ? this.#subscribe() : Promise.resolve();
  }

  #subscribe() {
    return this.call("web.subscribe", { topics: this.#topics }).catch((error) => {
      if (error.code !== CONNECTION_LOST) {
        throw error;
      }
    });
  }

  // The result of a method, by the names of docs/protocol.md or hapticd/web/page.py. Rejects with CallError. `urgent`: it
  // is sent however many others wait.
  call(method, params = {}, { timeout_s = 120, urgent = false } = {}) {
    return new Promise((resolve, reject) => {
      const refuse = (message) => reject(new CallError({ code: CONNECTION_LOST, message }));
      if (this.#socket === null) {
        refuse("no connection to hapticd web");
        return;
      }
      if (!urgent && (this.#waiting.size >= MOST_WAITING || this.#socket.bufferedAmount > MOST_UNSENT)) {
        refuse("hapticd web does not keep up with this page's requests");
        return;
      }
      const id = ++this.#lastId;
      const end = (settle) => (value) => {
        clearTimeout(timer);
        this.#waiting.delete(id);
        settle(value);
      };
      const waiting = { resolve: end(resolve), reject: end(reject) };
      const late = { code: CONNECTION_LOST, message: `${method}: no answer within ${timeout_s} s` };
      const timer = setTimeout(() => waiting.reject(new CallError(late)), 1e3 * timeout_s);
      this.#waiting.set(id, waiting);
      this.#socket.send(encode({ jsonrpc: "2.0", id, method, params }));
    });
  }

  // Without an answer: for what is sent many times a second. False: it was not sent, because what was sent before it still
  // waits; the next one will say it.
  notify(method, params = {}) {
    if (this.#socket === null || this.#socket.bufferedAmount > MOST_UNSENT_NOTIFICATIONS) {
      this.dropped++;
      return false;
    }
    this.#socket.send(encode({ jsonrpc: "2.0", method, params }));
    return true;
  }

  #received(data) {
    this.heardAt = performance.now();
    this.#silentS = 0;
    const message = decode(new Uint8Array(data));
    if (Array.isArray(message)) {
      this.dispatchEvent(new CustomEvent(message[0], { detail: message[1] }));
      return;
    }
    const waiting = this.#waiting.get(message.id);
    if (waiting === undefined) {
      return; // it came after its time
    }
    if (message.error) {
      waiting.reject(new CallError(message.error));
    } else {
      waiting.resolve(message.result);
    }
  }
}
