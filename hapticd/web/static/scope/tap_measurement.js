// The measurement of a triggered tap: frequency and decay from its samples, compared with those of the library.
import { duration, figure, percent } from "./elements.js";
import { fitModes, mainDirection } from "./tap_fit.js";
import { closedForm, materialAt, tapModel } from "./tap_model.js";

const MIN_SAMPLES = 8;
const MAX_SAMPLES = 4000;
const CURVE_POINTS = 400;
const ENDING_EVENTS = new Set(["contact", "groove", "puncture"]); // events that strike something else

// Returns the tap of a trigger {time, event, row}: {fit, model, material, ..., sentence, curves}; null while its samples
// still come. `world`: {scene, materials, device, undisplayable} with which it was rendered. `later`: events after it.
export function measureTap(source, trigger, world, later) {
  const { event, row, time } = trigger;
  const object = world.scene.objects[event.object];
  const at = row % source.capacity;
  const { columns } = source.store;
  const name = materialAt(object, [columns.x_m[at], columns.y_m[at]]);
  const material = world.materials[name];
  const model = tapModel(name, material, event, world.device, world.undisplayable);
  if (model.problem) {
    return {
      event,
      material: name,
      problem: model.problem,
      sentence: `Contact with ${event.object}: ${model.problem}.`,
      curves: [],
    };
  }
  if (event.amplitude_m_per_s2 * event.scale === 0) {
    return {
      event,
      material: name,
      sentence: `Contact with ${event.object} (${name}): nothing was struck.`,
      curves: [],
    };
  }
  const wanted = Math.ceil(model.endS / source.periodS);
  const rows = later.map((each) => (ENDING_EVENTS.has(each.event) ? (each.row ?? source.rowOfTick(each.tick)) : -1));
  const struck = rows.find((each) => each > row) ?? -1;
  const end = Math.min(row + Math.min(wanted, MAX_SAMPLES), struck > row ? struck : Infinity);
  if (source.rows < end) {
    return null;
  }
  return compare(source, trigger, model, name, usable(source, row, end), time);
}

// Returns the rows until the vibration ends or a sample is missing.
function usable(source, from, end) {
  const { vibration_x_n: x, vibration_y_n: y } = source.store.columns;
  let to = from + 1;
  while (to < end && source.gaps[to % source.capacity] === 0) {
    to++;
  }
  const silent = (row) => x[row % source.capacity] === 0 && y[row % source.capacity] === 0;
  while (to > from && silent(to - 1)) {
    to--;
  }
  return [from, to];
}

function compare(source, { event, time }, model, material, [from, to], onset) {
  const x = source.copy("vibration_x", from, to);
  const y = source.copy("vibration_y", from, to);
  const direction = to > from ? mainDirection(x, y) : [0, 1];
  const along = x.map((value, i) => value * direction[0] + y[i] * direction[1]);
  const fit = along.length < MIN_SAMPLES ? null : fitModes(along, source.periodS);
  const speed = event.speed_m_per_s === undefined ? "" : `, ${figure(event.speed_m_per_s, 3)} m/s`;
  const head = `Tap on ${event.object} (${material}${speed})`;
  if (fit === null) {
    const why =
      along.length < MIN_SAMPLES ? `only ${along.length} samples of it` : "no decaying sine explains its samples";
    return { event, material, model, fit, sentence: `${head}: ${why}, so nothing could be fitted.`, curves: [] };
  }
  const [mode] = fit.modes;
  const [library] = model.modes;
  const frequencyError = mode.frequencyHz / library.frequencyHz - 1;
  const decayError = library.decayPerS / mode.decayPerS - 1;
  const lowered =
    Math.abs(library.frequencyHz / model.meantHz - 1) > 1e-9 ? ` (lowered from ${figure(model.meantHz, 4)} Hz)` : "";
  const sentence =
    `${head}: measured ${figure(mode.frequencyHz, 4)} Hz, decay time ${duration(1 / mode.decayPerS, 4)}; library ` +
    `${figure(library.frequencyHz, 4)} Hz${lowered}, ${duration(1 / library.decayPerS, 4)}; difference ` +
    `${percent(frequencyError)} and ${percent(decayError)}.` +
    `${fit.modes.length > 1 ? ` ${fit.modes.length} modes rang; this is the strongest.` : ""}`;
  const lag = source.time[from % source.capacity] - onset;
  const modes = model.known ? model.modes : scaled(model.modes, along, lag, source.periodS);
  const curves = curvesOf(modes, model.endS, time, direction);
  const result = { event, material, model, fit, direction, curves, sentence, frequencyError, decayError };
  return {
    ...result,
    frequencyHz: mode.frequencyHz,
    decayS: 1 / mode.decayPerS,
    difference: rmsDifference(modes, along, lag, source.periodS),
  };
}

// With compensation the amplitude of the force is not m A: the closed form is scaled to the samples.
function scaled(modes, along, lag, periodS) {
  let [dot, square] = [0, 0];
  along.forEach((value, i) => {
    const form = closedForm(modes, lag + i * periodS);
    dot += value * form;
    square += form * form;
  });
  const factor = square > 0 ? dot / square : 1;
  return modes.map((mode) => ({ ...mode, amplitudeN: mode.amplitudeN * factor }));
}

// RMS of samples minus closed form, over the RMS of the samples.
function rmsDifference(modes, along, lag, periodS) {
  let [left, total] = [0, 0];
  along.forEach((value, i) => {
    left += (value - closedForm(modes, lag + i * periodS)) ** 2;
    total += value * value;
  });
  return Math.sqrt(left / total);
}

function curvesOf(modes, endS, onset, direction) {
  const times = Float64Array.from({ length: CURVE_POINTS + 1 }, (_, i) => onset + (i / CURVE_POINTS) * endS);
  const values = times.map((t) => closedForm(modes, t - onset));
  return ["x", "y"].map((part, k) => ({
    channel: `vibration_${part}`,
    times,
    values: values.map((value) => value * direction[k]),
  }));
}
