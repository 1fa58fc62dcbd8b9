// The spectrum of one trace, in the window or between the cursors.
import { color } from "../theme.js";
import { CHANNEL } from "./channels.js";
import { duration, figure } from "./elements.js";
import { axis, figureIn, readable } from "./plot.js";
import { addPower, decibels, parts, summarize } from "./spectrum.js";

const MIN_SAMPLES = 16;
const RANGE_DB = 100;
const MIN_INTERVAL_MS = 250; // shortest time between two spectra while the picture runs
const REFERENCE_UNITS = { force: "N", position: "m", velocity: "m/s" }; // 0 dB: an RMS of 1 of it

// Returns the rows [from, to) for the spectrum of the times left..right: the part without a gap that contains the trigger, a
// time or null; the longest part if the trigger is not between `left` and `right`.
export function unbroken(source, left, right, trigger = null) {
  const from = source.rowAt(left);
  const to = source.rowAt(right);
  if (to - from < 1) {
    return [from, from];
  }
  const around = trigger === null || trigger < left ? to : source.rowAt(trigger);
  return around < to ? source.stretchAround(around, from, to) : source.longestStretch(from, to);
}

export class SpectrumView {
  #uplot = null;
  #host;
  #showText;
  #job = null; // the computation under way: one transform a frame
  #begunAt = -Infinity;
  #stale = true; // the data changed since the last computation began
  result = null; // result of the last computation: {id, power, ...}

  constructor(host, showText) {
    this.#host = host;
    this.#showText = showText;
  }

  get canvas() {
    return this.#uplot?.ctx.canvas ?? null;
  }

  configure() {
    this.#uplot?.destroy();
    this.#uplot = null;
    this.#show();
  }

  // The section or the trace changed: cancels the computation under way.
  restart() {
    this.#job = null;
    this.#begunAt = -Infinity;
    this.#stale = true;
  }

  // Called once a frame while the view is visible. `moved`: the data changed. Returns whether it needs another frame.
  step(source, id, left, right, trigger, moved) {
    this.#stale ||= moved;
    if (this.#job === null && this.#stale && performance.now() - this.#begunAt >= MIN_INTERVAL_MS) {
      this.#begin(source, id, left, right, trigger);
    }
    const job = this.#job;
    if (job !== null) {
      job.power = addPower(job.samples, job.begins[job.done++], job.length, job.power);
      if (job.done === job.begins.length) {
        job.power.forEach((value, k) => (job.power[k] = value / job.done));
        this.result = { ...job, ...summarize(job.power, job.rateHz, job.length) };
        this.#job = null;
        this.#show();
      }
    }
    return this.#job !== null || this.#stale;
  }

  #begin(source, id, left, right, trigger) {
    this.#begunAt = performance.now();
    this.#stale = false;
    const [from, to] = unbroken(source, left, right, trigger);
    if (to - from < MIN_SAMPLES) {
      this.result = null;
      this.#show();
      return;
    }
    const samples = source.copy(id, from, to);
    const cut = from > source.rowAt(left) || to < source.rowAt(right) ? right - left : null;
    const triggered = trigger !== null && left <= trigger && trigger < right;
    const job = { id, samples, rateHz: 1 / source.periodS, ...parts(to - from), done: 0, power: null, cut, triggered };
    this.#job = { ...job, from, to };
  }

  #show() {
    if (this.#host.clientWidth === 0) {
      return;
    }
    if (this.result === null) {
      this.#uplot?.destroy();
      this.#uplot = null;
      this.#showText(`A spectrum needs at least ${MIN_SAMPLES} samples without a gap.`);
      return;
    }
    const { id, power, lineHz, rateHz, length } = this.result;
    const { scale } = CHANNEL[id];
    this.#uplot ??= this.#make();
    const level = Float64Array.from(power, (value) => decibels(value));
    const frequency = Float64Array.from(power, (_, k) => Math.max(k * lineHz, 1e-9));
    let top = -Infinity;
    for (let k = 1; k < level.length; k++) {
      top = Math.max(top, level[k]);
    }
    top = 10 * Math.ceil((top + 3) / 10);
    this.#uplot.batch((u) => {
      u.axes[1].label = `Level, dB re 1 ${REFERENCE_UNITS[scale]}`;
      u.setData([frequency, level], false);
      u.setScale("x", { min: Math.max(lineHz, rateHz / length), max: rateHz / 2 });
      u.setScale("level", { min: top - RANGE_DB, max: top });
    });
    this.#showText(this.#sentence());
  }

  #sentence() {
    const { id, samples, rateHz, peakHz, peakDb, centroidHz, resolutionHz, begins, length } = this.result;
    const unit = REFERENCE_UNITS[CHANNEL[id].scale];
    const mean = begins.length > 1 ? `, mean of ${begins.length} parts of ${duration(length / rateHz)}` : "";
    const made =
      `${samples.length.toLocaleString("en")} samples (${duration(samples.length / rateHz)}), Hann window, ` +
      `resolution ${figure(resolutionHz, 3)} Hz${mean}.${this.#cutSentence()}`;
    if (Number.isNaN(peakHz)) {
      return `${CHANNEL[id].label}: nothing moves. ${made}`;
    }
    const peak = `Peak ${figure(peakHz, 5)} Hz at ${figure(peakDb, 3)} dB re 1 ${unit} RMS.`;
    return `${peak} Centroid ${figure(centroidHz, 4)} Hz. ${made}`;
  }

  // Returns a text on the part of the window that the spectrum covers, if gaps limit it.
  #cutSentence() {
    const { samples, rateHz, cut, triggered } = this.result;
    if (cut === null) {
      return "";
    }
    const which = triggered ? "the stretch that contains the trigger" : "the longest stretch";
    const milliseconds = (seconds) => `${figure(1e3 * seconds, 4)} ms`;
    const over = `computed over ${milliseconds(samples.length / rateHz)} of ${milliseconds(cut)}`;
    return ` Samples are missing: ${over}, ${which} without a gap.`;
  }

  #make() {
    const fixed = { auto: false, range: (_, low, high) => [low, high] };
    const shown = new Set(this.#host.clientWidth < 500 ? [1] : [1, 2, 5]);
    const first = (value) => Number(value.toExponential()[0]);
    return figureIn(
      this.#host,
      {
        padding: [8, 16, 0, 0],
        scales: { x: { ...fixed, time: false, distr: 3 }, level: fixed },
        axes: [
          axis({
            scale: "x",
            size: 26,
            label: "Frequency, Hz",
            filter: (_, at) => at,
            values: (_, at) => at.map((value) => (value !== null && shown.has(first(value)) ? readable(value) : null)),
          }),
          axis({ scale: "level", size: 46, label: "", values: (_, at) => at.map(readable) }),
        ],
        series: [{}, { scale: "level", stroke: () => color("accent"), width: 1.25, points: { show: false } }],
      },
      [[1], [null]],
    );
  }
}
