// The moment that is drawn: the newest sample, or that of a recording. Positions come from the samples, not from the 60
// states a second.

const FLAG_SATURATED = 8;
const MAX_VIBRATION_AGE_S = 0.1; // older vibration is not drawn, even if nothing was drawn since

// Returns the moment of a row of a SampleStore.
export function momentAt(samples, row) {
  const at = row % samples.capacity;
  const c = samples.columns;
  return {
    tick: samples.ticks[at],
    position: [c.x_m[at], c.y_m[at]],
    velocity: [c.vx_m_per_s[at], c.vy_m_per_s[at]],
    contact: [c.contact_x_n[at], c.contact_y_n[at]],
    vibration: [c.vibration_x_n[at], c.vibration_y_n[at]],
    force: [c.force_x_n[at], c.force_y_n[at]],
    flags: c.flags[at],
  };
}

// Returns the moment of a map of the topic `state` or of a recording.
export function momentOf(state) {
  return {
    tick: state.tick,
    position: state.position_m,
    velocity: state.velocity_m_per_s,
    contact: state.contact_force_n,
    vibration: state.vibration_force_n,
    force: state.force_n,
    flags: state.flags,
  };
}

export const isSaturated = (moment) => (moment.flags & FLAG_SATURATED) !== 0;

// Returns the largest vibration of the rows [from, to), so that vibration shorter than a frame is visible.
export function largestVibration(samples, from, to) {
  const { vibration_x_n: x, vibration_y_n: y } = samples.columns;
  let largest = 0;
  let found = [0, 0];
  for (let row = Math.max(from, samples.first); row < to; row++) {
    const at = row % samples.capacity;
    const size = x[at] * x[at] + y[at] * y[at];
    if (size > largest) {
      largest = size;
      found = [x[at], y[at]];
    }
  }
  return found;
}

// Returns the positions at a tick and at the tick before it; null if their rows were removed or have not come yet.
export function positionsAround(samples, tick) {
  if (samples.capacity === 0 || samples.rows - samples.first < 2) {
    return null;
  }
  const newest = samples.rows - 1;
  let row = newest - (samples.ticks[newest % samples.capacity] - tick);
  row = Math.min(newest, Math.max(samples.first + 1, row));
  // Lost samples make the guess too low, because ticks only rise.
  while (row < newest && samples.ticks[row % samples.capacity] < tick) {
    row++;
  }
  if (samples.ticks[row % samples.capacity] !== tick) {
    return null;
  }
  return [momentAt(samples, row - 1).position, momentAt(samples, row).position];
}

export class Moments {
  #app;
  #drawn = 0; // rows before this one were searched for the largest vibration
  playback = null; // a moment of a recording; null: live

  constructor(app) {
    this.#app = app;
  }

  get newest() {
    if (this.playback !== null) {
      return this.playback;
    }
    const { samples, model } = this.#app;
    const sampled = samples.rows > 0 ? momentAt(samples, samples.rows - 1) : null;
    const state = model.state;
    if (state !== null && (sampled === null || state.tick > sampled.tick)) {
      return momentOf(state);
    }
    return sampled;
  }

  // Returns the largest vibration since the last call.
  vibration() {
    const { samples } = this.#app;
    if (this.playback !== null) {
      return this.playback.vibration;
    }
    const from = Math.max(this.#drawn, samples.rows - Math.ceil(MAX_VIBRATION_AGE_S * samples.rateHz));
    const found = samples.capacity === 0 ? [0, 0] : largestVibration(samples, from, samples.rows);
    this.#drawn = samples.rows;
    return found;
  }
}
