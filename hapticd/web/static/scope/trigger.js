// The trigger: an event (contact, rupture, groove, release), or a channel that crosses a level. Events and samples come
// separately and in any order; an event waits here until the row of its tick has come.

export const SOURCES = [
  { id: "off", label: "Off", event: null },
  { id: "contact", label: "Contact", event: "contact" },
  { id: "puncture", label: "Rupture", event: "puncture" },
  { id: "groove", label: "Groove", event: "groove" },
  { id: "release", label: "Release", event: "release" },
  { id: "level", label: "Level", event: null },
];
const MAX_WAITING_EVENTS = 4096;

// Finds the triggers. `find` returns them in the order of time.
export class Trigger {
  source = "off";
  channel = "force_y";
  level = 0.5; // SI
  rising = true;
  hysteresis = 0.05; // SI: distance from the level that the channel must have had on the other side
  #waiting = []; // events whose tick has no row yet
  #ready = []; // {time, event, row}, in the order of time
  #scanned = 0;
  #armed = false;
  #generation = -1;

  // Adds an event of telemetry.
  add(event) {
    const wanted = SOURCES.find((source) => source.id === this.source).event;
    // If an object appeared around the probe there is no onset.
    if (event.event === wanted && wanted !== null && !event.appeared) {
      this.#waiting.push(event);
      if (this.#waiting.length > MAX_WAITING_EVENTS) {
        this.#waiting.shift();
      }
    }
  }

  // Clears all triggers; the search for a level begins again at row `from`.
  restart(source, from = source.rows) {
    this.#waiting.length = this.#ready.length = 0;
    this.#scanned = from;
    this.#armed = false;
    this.#generation = source.generation;
  }

  // Returns the first trigger at `after` or later that was not returned yet: {time, event, row}; null: none.
  find(source, after) {
    if (this.#generation !== source.generation) {
      this.restart(source, source.first);
    }
    this.#match(source);
    if (this.source === "level") {
      this.#scan(source);
    }
    while (this.#ready.length > 0 && this.#ready[0].time < after) {
      this.#ready.shift();
    }
    return this.#ready.shift() ?? null;
  }

  #match(source) {
    if (this.#waiting.length === 0) {
      return;
    }
    const newest = source.newestTick;
    const late = [];
    for (const event of this.#waiting) {
      const row = event.row ?? source.rowOfTick(event.tick); // events of a recording have their row
      if (row >= source.first && row < source.rows) {
        // The onset is between two ticks, `before_tick_s` before that of the event.
        const time = source.time[row % source.capacity] - (event.before_tick_s ?? 0);
        this.#ready.push({ time, event, row });
      } else if (event.row === undefined ? event.tick > newest : event.row >= source.rows) {
        late.push(event); // its sample has not come yet; events with lost samples are dropped later
      }
    }
    this.#waiting = late;
    this.#ready.sort((a, b) => a.time - b.time);
  }

  // Finds crossings of the level in the new rows. The time is interpolated linearly between two samples.
  #scan(source) {
    const { column } = source.track(this.channel);
    const { time, capacity, gaps } = source;
    const sign = this.rising ? 1 : -1;
    const level = sign * this.level;
    for (let row = Math.max(this.#scanned, source.first); row < source.rows; row++) {
      const at = row % capacity;
      const value = sign * column[at];
      if (this.#armed && value >= level) {
        const before = (row - 1) % capacity;
        const last = sign * column[before];
        // In a gap the time is not known: the first sample after it is used.
        const share = last < level && gaps[at] === 0 ? (value - level) / (value - last) : 0;
        this.#ready.push({ time: time[at] - share * (time[at] - time[before]), event: null, row });
        this.#armed = false;
      } else if (value < level - this.hysteresis || (this.hysteresis === 0 && value < level)) {
        this.#armed = true;
      }
    }
    this.#scanned = source.rows;
  }
}

// The acquisition: `auto` shows the newest samples if there was no trigger for `patience_s`, `normal` waits for the next
// trigger, `single` takes one and holds.
export class Acquisition {
  mode = "auto";
  patienceS = 3;
  shown = null; // the trigger that is shown
  state = "rolling"; // rolling, waiting, filling (its samples still come), complete, held
  #newest = -Infinity;
  #startedAt = null;

  constructor(trigger, view) {
    this.trigger = trigger;
    this.view = view;
  }

  // Starts again: with Run, or when the trigger's settings changed.
  restart(source, from = source.rows) {
    this.trigger.restart(source, from);
    this.shown = null;
    this.#startedAt = null;
    this.view.trigger = null;
    this.view.run();
    this.state = this.trigger.source === "off" ? "rolling" : "waiting";
  }

  hold() {
    this.view.hold();
    this.state = "held";
  }

  // Searches the new data for triggers; returns whether another one is shown.
  update(source) {
    const newest = source.newest;
    this.#startedAt ??= newest;
    this.view.follow(newest);
    if (this.view.held) {
      this.state = "held";
      this.trigger.restart(source);
      return false;
    }
    if (this.trigger.source === "off") {
      this.state = "rolling";
      return false;
    }
    const end = this.shown === null ? -Infinity : this.shown.time + (1 - this.view.before) * this.view.widthS;
    if (this.shown !== null && newest < end) {
      this.state = "filling";
      return false;
    }
    if (this.shown !== null && this.mode === "single") {
      this.hold();
      return false;
    }
    return this.#next(source, newest, end);
  }

  #next(source, newest, end) {
    const found = this.trigger.find(source, end);
    if (found !== null) {
      this.shown = found;
      this.view.trigger = found.time;
      this.state = "filling";
      return true;
    }
    this.state = this.shown === null ? "waiting" : "complete";
    const since = this.shown === null ? this.#startedAt : end;
    if (this.mode === "auto" && (this.shown === null || newest > since + this.patienceS)) {
      this.view.trigger = null;
      this.shown = null;
      this.state = "waiting";
    }
    return false;
  }
}
