// The WebSocket to `hapticd web`: calls with answers, notifications, telemetry. hapticd/web/page.py describes the messages.
//
// A lost connection is tried again after 0.25 s, then after twice the pause each time, at most 5 s; subscriptions are
// restored. If no message came for 3 s, a request is sent; without an answer the socket is closed.
import { decode, encode } from "./vendor/msgpack/index.mjs";

const MIN_RETRY_PAUSE_S = 0.25;
const MAX_RETRY_PAUSE_S = 5;
const MAX_SILENCE_S = 3;
const MAX_WAITING_CALLS = 256; // calls that wait for an answer
const MAX_UNSENT_BYTES = 1 << 20; // bytes that the browser has not sent yet
const MAX_UNSENT_NOTIFICATION_BYTES = 16 << 10; // unsent bytes above which notifications are dropped

export const CONNECTION_LOST = 0; // code of a CallError without an answer; the other codes are those of docs/protocol.md

export class CallError extends Error {
  constructor(error) {
    super(error.message);
    this.code = error.code;
    this.data = error.data;
  }
}

// Events: `open` and `close`; `waiting` {pause_s, refused} before the next try; and an event for each topic of telemetry,
// with the message in `detail`.
export class Link extends EventTarget {
  heardAt = 0; // performance.now() of the last message
  #silentS = 0; // seconds, counted while this page ran, without a message
  dropped = 0; // notifications that were not sent because earlier ones were still waiting
  #url;
  #socket = null;
  #lastId = 0;
  #waiting = new Map();
  #topics = null;
  #pause_s = MIN_RETRY_PAUSE_S;
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

  // Resolves with the first connection, and reconnects whenever it is lost.
  open() {
    const opened = new Promise((resolve) => this.addEventListener("open", resolve, { once: true }));
    this.#connect();
    return opened;
  }

  // Stops reconnecting.
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
      this.#pause_s = MIN_RETRY_PAUSE_S;
      this.heardAt = performance.now();
      this.#silentS = 0;
      this.#watch = setInterval(() => this.#askIfSilent(), 1000);
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
      return; // an old socket that was replaced
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
    this.#pause_s = Math.min(2 * pause_s, MAX_RETRY_PAUSE_S);
    clearTimeout(this.#retry);
    this.#retry = setTimeout(() => this.#connect(), 1e3 * pause_s);
    // A WebSocket does not report why it was refused, a request does: 403 means another process, which needs a new address.
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

  // Called once a second. Time in which the page itself was blocked, as while it loads, does not count: messages may wait.
  #askIfSilent() {
    this.#silentS++;
    if (this.#silentS === MAX_SILENCE_S) {
      this.call("web.hello", {}, { timeout_s: 2 * MAX_SILENCE_S }).catch((error) => {
        if (error.code !== CONNECTION_LOST) {
          throw error;
        }
      });
    } else if (this.#silentS >= 2 * MAX_SILENCE_S) {
      const socket = this.#socket;
      socket.close(); // takes long if the network is lost
      this.#closed(socket);
    }
  }

  // Subscribes to these topics, and to no others. The subscription is restored after a lost connection.
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

  // Calls a method of docs/protocol.md or of hapticd/web and resolves with its result; rejects with CallError. `urgent`: it
  // is sent regardless of how many other calls wait.
  call(method, params = {}, { timeout_s = 120, urgent = false } = {}) {
    return new Promise((resolve, reject) => {
      const refuse = (message) => reject(new CallError({ code: CONNECTION_LOST, message }));
      if (this.#socket === null) {
        refuse("no connection to hapticd web");
        return;
      }
      if (!urgent && (this.#waiting.size >= MAX_WAITING_CALLS || this.#socket.bufferedAmount > MAX_UNSENT_BYTES)) {
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

  // Sends a notification, which is not answered. Returns false if it was not sent because earlier data still waits.
  notify(method, params = {}) {
    if (this.#socket === null || this.#socket.bufferedAmount > MAX_UNSENT_NOTIFICATION_BYTES) {
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
      return; // its call has already failed
    }
    if (message.error) {
      waiting.reject(new CallError(message.error));
    } else {
      waiting.resolve(message.result);
    }
  }
}
