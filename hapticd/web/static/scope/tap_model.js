// The library's closed form of a tap: F(t) = m A exp(-B t) sin(w t) from the onset to five decay times.

const END_DECAY_TIMES = 5; // duration of a mode, in decay times

function modeOf({ frequency_hz, decay_time_s, angular_frequency_rad_per_s, decay_rate_per_s }) {
  return {
    frequencyHz: frequency_hz ?? angular_frequency_rad_per_s / (2 * Math.PI),
    decayPerS: decay_rate_per_s ?? 1 / decay_time_s,
  };
}

// Interpolates linearly between the table's points, and returns the outermost values beyond them.
function modeAt({ speeds_m_per_s: speeds, frequencies_hz, decay_times_s }, speed) {
  const after = speeds.findIndex((each) => each >= speed);
  const at = (values) => {
    if (after <= 0) {
      return after === 0 ? values[0] : values.at(-1);
    }
    const share = (speed - speeds[after - 1]) / (speeds[after] - speeds[after - 1]);
    return values[after - 1] + share * (values[after] - values[after - 1]);
  };
  return { frequencyHz: at(frequencies_hz), decayPerS: 1 / at(decay_times_s) };
}

// Returns the first maximum of exp(-B t) sin(w t).
function peakOf({ frequencyHz, decayPerS }) {
  const w = 2 * Math.PI * frequencyHz;
  const time = Math.atan2(w, decayPerS) / w;
  return Math.exp(-decayPerS * time) * Math.sin(w * time);
}

// Returns the name of the material at a point of an object: that of a wall's patch, or else that of the object.
export function materialAt(object, position) {
  if (object?.kind === "wall" && object.patches) {
    const length = Math.hypot(...object.normal);
    const [nx, ny] = object.normal.map((part) => part / length);
    const arc = (position[0] - object.point_m[0]) * ny - (position[1] - object.point_m[1]) * nx;
    const patch = object.patches.find(({ from_m, to_m }) => arc >= from_m && arc < to_m);
    return patch ? patch.material : object.material;
  }
  return object?.material ?? null;
}

// Returns the expected tap of a material at an event: {modes: [{frequencyHz, decayPerS, amplitudeN}], endS, meantHz, known},
// or {problem}. `known`: whether the amplitude is known. With compensation the amplitude depends on the handle; for a
// recording it may be unknown. `undisplayable`, from the status: modes above the limit of the rate are lowered with the same
// first peak, or silent.
export function tapModel(name, material, event, device, undisplayable) {
  const tap = material?.tap;
  if (!tap) {
    return { problem: `${name ?? "what was touched"} has no tap: nothing rings` };
  }
  if (tap.waveform) {
    return { problem: `the tap of ${name} is a waveform: it has no frequency` };
  }
  const mode = tap.mode_table ? modeAt(tap.mode_table, event.true_speed_m_per_s ?? event.speed_m_per_s) : modeOf(tap);
  const shown = displayed(name, "tap", mode, undisplayable);
  if (shown === null) {
    return { problem: `the tap of ${name} is silent: ${mode.frequencyHz.toFixed(0)} Hz are above 0.4 of the rate` };
  }
  const known = event.amplitude_m_per_s2 !== undefined && device !== null && (device.compensation ?? "off") === "off";
  const force = known ? event.amplitude_m_per_s2 * event.scale * device.effective_mass_kg : 1;
  const coefficient = tap.attack === "first_peak" ? force / peakOf(mode) : force;
  const modes = [{ ...shown, amplitudeN: (coefficient * peakOf(mode)) / peakOf(shown) }];
  if (tap.second) {
    const second = displayed(name, "second", modeOf(tap.second), undisplayable);
    if (second !== null) {
      const own = modeOf(tap.second);
      modes.push({ ...second, amplitudeN: (tap.second.ratio * coefficient * peakOf(own)) / peakOf(second) });
    }
  }
  const endS = Math.max(...modes.map(({ decayPerS }) => END_DECAY_TIMES / decayPerS));
  return { modes, endS, meantHz: mode.frequencyHz, known };
}

function displayed(name, use, mode, undisplayable) {
  const entry = (undisplayable ?? []).find((each) => each.material === name && each.mode === use);
  if (entry === undefined) {
    return mode;
  }
  return entry.shown_hz === null ? null : { ...mode, frequencyHz: entry.shown_hz };
}

// Returns the closed form at t seconds from the onset, in N.
export function closedForm(modes, t) {
  let sum = 0;
  if (t >= 0) {
    for (const { frequencyHz, decayPerS, amplitudeN } of modes) {
      if (t * decayPerS <= END_DECAY_TIMES) {
        sum += amplitudeN * Math.exp(-decayPerS * t) * Math.sin(2 * Math.PI * frequencyHz * t);
      }
    }
  }
  return sum;
}
