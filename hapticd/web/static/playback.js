// The playback of a recording: its samples around one moment, in a store like that of samples.js.
//
// app.playback   the playback of the page. While it is `active`, scope and scene show its `store`, `scene` and `state` in
//                place of app.samples, app.model.scene and app.model.state.
//   active       a recording is open
//   store        SampleStore: rows, first, columns, ticks, rateHz, capacity as in samples.js. The newest row
//                (rows - 1) is the moment: a module that draws the newest samples draws the recorded moment.
//                Rows are those of the file: row 0 is its first sample; time_s counts from there.
//                Events: `added` {count} while it plays; `restart` after a jump, before all rows are replaced.
//   state        the sample at the moment, as in the topic `state`; null without one
//   scene, materials   the scene and the materials of that sample
//   facts        name, rows, rate_hz, duration_s, notes, events (of telemetry, each with its `row`); see
//                hapticd/web/playback.py
//   row, timeS   the moment, as row and in s
//   playing, speed     speed: 1 is real time
//   spanS        time before the moment that is fetched after a jump, in s; the scope may raise it to its width
//
// app.view gets the event `playback`, {active, moved, playing, store, state, touching}, when a recording is opened or closed
// (then `active` is false, `store` and `state` are null), when the moment jumped (`moved`), and when playing begins or ends;
// and the event `moment` with the same members with every frame while it plays. `touching`: ids of the touched objects.
import { SampleStore } from "./samples.js";

const MAX_ROWS_PER_CALL = 20000; // as hapticd/web/playback.py allows
const STORED_S = 60;
const FETCH_AHEAD_S = 0.5; // fetched before it is played

// The rows from `from` to before `to` of an answer of web.playback_rows.
function slice(batch, from, to) {
  const size = batch.data.byteLength / batch.count;
  const data = batch.data.subarray(from * size, to * size);
  const firstTick = Number(new DataView(data.buffer, data.byteOffset, 8).getBigUint64(0, true));
  return { first_tick: firstTick, dropped: 0, dtype: batch.dtype, data };
}

export class Playback {
  active = false;
  store = null;
  facts = null;
  scene = { objects: {} };
  materials = {};
  playing = false;
  speed = 1;
  spanS = 10;
  #link;
  #view;
  #ahead = []; // answers with the rows that come next
  #fetching = null; // number of the jump whose rows are being fetched
  #jumping = false;
  #jump = 0; // counts jumps: an answer to an older one is dropped
  #revision = null; // revision of the scene that was fetched
  #exact = 0; // the moment while it plays, in rows, with its fraction
  #lastFrame = 0;

  constructor(link, view) {
    this.#link = link;
    this.#view = view;
    link.addEventListener("close", () => this.#closed());
  }

  get row() {
    return this.store === null ? 0 : Math.max(0, this.store.rows - 1);
  }

  get timeS() {
    return this.active && this.store.capacity ? this.store.columns.time_s[this.row % this.store.capacity] : 0;
  }

  get state() {
    if (!this.active || this.store.rows === this.store.first) {
      return null;
    }
    const { columns, capacity, ticks } = this.store;
    const place = this.row % capacity;
    const pair = (x, y) => [columns[x][place], columns[y][place]];
    return {
      tick: ticks[place],
      time_ns: Math.round(columns.time_s[place] * 1e9),
      position_m: pair("x_m", "y_m"),
      velocity_m_per_s: pair("vx_m_per_s", "vy_m_per_s"),
      contact_force_n: pair("contact_x_n", "contact_y_n"),
      vibration_force_n: pair("vibration_x_n", "vibration_y_n"),
      force_n: pair("force_x_n", "force_y_n"),
      flags: columns.flags[place],
    };
  }

  // Opens a recording, {name} in the folder or {upload, name}, and goes to its first tenth of a second.
  async open(params) {
    this.pause();
    let facts;
    try {
      facts = await this.#link.call("web.playback_open", params);
    } catch (error) {
      this.#closed(); // hapticd web has closed the recording that was open
      throw error;
    }
    this.facts = facts;
    this.store = new SampleStore(STORED_S);
    this.store.setRate(facts.rate_hz);
    this.store.events = facts.events;
    this.active = true;
    this.#revision = null;
    await this.seek(Math.min(facts.rows - 1, Math.round(facts.rate_hz / 10)));
    return facts;
  }

  async close() {
    if (this.active) {
      this.#closed();
      await this.#link.call("web.playback_close");
    }
  }

  #closed() {
    if (!this.active) {
      return;
    }
    this.#jump += 1;
    this.active = this.playing = false;
    this.store = this.facts = null;
    this.#ahead = [];
    this.#dispatch(false);
  }

  // Goes to a row of the file. Of many calls, as from a slider, only the last takes effect.
  async seek(row) {
    const jump = ++this.#jump;
    const to = Math.max(0, Math.min(this.facts.rows - 1, Math.round(row)));
    const from = Math.max(0, to + 1 - Math.round(Math.min(this.spanS, STORED_S) * this.facts.rate_hz));
    const batches = [];
    this.#ahead = [];
    this.#jumping = true;
    try {
      // The newest rows first: they are shown, and the next jump may cancel the others.
      for (let end = to + 1; end > from;) {
        const first = Math.max(from, end - MAX_ROWS_PER_CALL);
        const batch = await this.#link.call("web.playback_rows", { first, count: end - first });
        if (jump !== this.#jump) {
          return;
        }
        batches.unshift(batch);
        end = first;
        if (batches.length === 1 || end === from) {
          this.#show(batches, first);
        }
      }
      await this.#fetchScene(to);
    } finally {
      if (jump === this.#jump) {
        this.#exact = to;
        this.#jumping = false;
      }
    }
    if (jump === this.#jump) {
      this.#dispatch(true);
    }
  }

  #show(batches, first) {
    this.store.clear(first, BigInt(this.facts.start_ns));
    for (const batch of batches) {
      this.store.add(slice(batch, 0, batch.count));
    }
  }

  async #fetchScene(row) {
    const { scene, materials, revision } = await this.#link.call("web.playback_scene", { row });
    if (this.#revision !== revision && this.active) {
      this.scene = scene;
      this.materials = materials;
      this.#revision = revision;
    }
  }

  play(speed = this.speed) {
    this.speed = speed;
    if (!this.active || this.playing) {
      return;
    }
    this.playing = true;
    this.#exact = this.row;
    this.#lastFrame = performance.now();
    this.#dispatch(false);
    requestAnimationFrame((now) => this.#frame(now));
  }

  pause() {
    if (this.playing) {
      this.playing = false;
      this.#dispatch(false);
    }
  }

  #frame(now) {
    if (!this.playing) {
      return;
    }
    // A page that was hidden continues where it was.
    const elapsedS = Math.min(0.1, Math.max(0, (now - this.#lastFrame) / 1000));
    this.#lastFrame = now;
    this.#exact += elapsedS * this.speed * this.facts.rate_hz;
    if (!this.#jumping) {
      this.#advance(Math.min(this.facts.rows, Math.floor(this.#exact) + 1));
      if (this.store.rows >= this.facts.rows) {
        this.pause();
        return;
      }
      this.#dispatch(false, "moment");
      this.#exact = Math.min(this.#exact, this.store.rows); // waits for rows that have not come yet
    }
    requestAnimationFrame((next) => this.#frame(next));
  }

  // Adds the rows before `to` that have come, and requests the next ones.
  #advance(to) {
    const { store } = this;
    while (this.#ahead.length > 0 && store.rows < to) {
      const batch = this.#ahead[0];
      const end = Math.min(batch.count, to - batch.first);
      store.add(slice(batch, store.rows - batch.first, end));
      if (end === batch.count) {
        this.#ahead.shift();
      }
    }
    const last = this.#ahead.at(-1);
    const next = last === undefined ? store.rows : last.first + last.count;
    if (this.#fetching !== this.#jump && next < this.facts.rows && next - store.rows < FETCH_AHEAD_S * this.facts.rate_hz) {
      this.#fetchAhead(next);
    }
  }

  async #fetchAhead(first) {
    const jump = this.#jump;
    this.#fetching = jump;
    const count = Math.min(
      MAX_ROWS_PER_CALL,
      this.facts.rows - first,
      Math.max(1, Math.round(FETCH_AHEAD_S * this.facts.rate_hz)),
    );
    try {
      const [batch] = await Promise.all([
        this.#link.call("web.playback_rows", { first, count }),
        this.#fetchScene(this.row),
      ]);
      if (jump === this.#jump) {
        this.#ahead.push(batch);
      }
    } catch (error) {
      this.pause();
      this.#view.dispatchEvent(new CustomEvent("notice", { detail: { text: error.message, kind: "error" } }));
    } finally {
      if (this.#fetching === jump) {
        this.#fetching = null;
      }
    }
  }

  #touching() {
    const touched = new Set();
    for (const event of this.facts?.events ?? []) {
      if (event.row > this.row) {
        break;
      }
      if (event.event === "contact") {
        touched.add(event.object);
      } else if (event.event === "release" || event.event === "puncture") {
        touched.delete(event.object);
      }
    }
    return [...touched];
  }

  #dispatch(moved, event = "playback") {
    const { active, playing, store, state } = this;
    const detail = { active, moved, playing, store, state, touching: this.#touching() };
    this.#view.dispatchEvent(new CustomEvent(event, { detail }));
  }
}
