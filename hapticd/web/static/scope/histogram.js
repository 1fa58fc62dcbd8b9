// The lateness of the servo's ticks: the histogram of the status, with logarithmic axes, p50, p99 and the maximum.
import uPlot from "../vendor/uplot/uPlot.esm.js";
import { color } from "../theme.js";
import { duration } from "./elements.js";
import { axis, figureIn } from "./plot.js";

// Returns the quantile `share`, in ns, interpolated within a bin on the logarithmic axis, and at most the maximum. `edges`
// has one entry less than `counts`; see docs/reference/status.md.
export function quantile({ edges, counts, max }, share) {
  const total = counts.reduce((sum, count) => sum + count, 0);
  if (total === 0) {
    return NaN;
  }
  let below = 0;
  for (let k = 0; k < counts.length; k++) {
    if (below + counts[k] >= share * total && counts[k] > 0) {
      const low = k === 0 ? edges[0] / 2 : edges[k - 1];
      const high = k < edges.length ? edges[k] : Math.max(max, low);
      return Math.min(max, low * (high / low) ** ((share * total - below) / counts[k]));
    }
    below += counts[k];
  }
  return max;
}

export class HistogramView {
  #uplot = null;
  #host;
  #showText;
  #histogram = null;

  constructor(host, showText) {
    this.#host = host;
    this.#showText = showText;
  }

  get canvas() {
    return this.#uplot?.ctx.canvas ?? null;
  }

  // Draws the newest histogram in the host's size and the page's colours.
  configure(histogram) {
    this.#uplot?.destroy();
    this.#uplot = null;
    this.draw(histogram);
  }

  // Sets the histogram of the status; null: none yet.
  draw(histogram) {
    this.#histogram = histogram;
    if (histogram === null || this.#host.clientWidth === 0) {
      this.#showText("No status came yet.");
      return;
    }
    const { edges, counts, max } = histogram;
    const used = counts.findLastIndex((count) => count > 0);
    const low = edges[0] / 2 / 1e3;
    const high = (edges[Math.min(edges.length - 1, used + 1)] * 1.2) / 1e3;
    const largest = Math.max(10, ...counts);
    this.#uplot ??= this.#make();
    this.#uplot.batch((u) => {
      u.setScale("x", { min: low, max: high });
      u.setScale("ticks", { min: 0.8, max: largest * 2 });
    });
    const [p50, p99] = [quantile(histogram, 0.5), quantile(histogram, 0.99)];
    const total = counts.reduce((sum, count) => sum + count, 0);
    const late = (ns) => duration(ns * 1e-9);
    this.#showText(
      `Lateness of ${total.toLocaleString("en")} ticks since the daemon started: half below ${late(p50)} (p50), ` +
        `99 of 100 below ${late(p99)} (p99), latest ${late(max)}.`,
    );
  }

  #make() {
    const log = { auto: false, distr: 3, range: (_, low, high) => [low, high] };
    const powers = (_, at) =>
      at.map((value) => (value === null || Math.log10(value) % 1 !== 0 ? null : value.toLocaleString("en")));
    return figureIn(
      this.#host,
      {
        padding: [8, 12, 0, 0],
        scales: { x: { ...log, time: false }, ticks: log },
        axes: [
          axis({ scale: "x", size: 26, label: "Lateness, µs", values: powers }),
          axis({ scale: "ticks", size: 72, label: "Ticks", values: powers }),
        ],
        series: [{}, { scale: "ticks", paths: () => null, points: { show: false } }],
        hooks: { draw: [(u) => this.#bars(u)] },
      },
      [[1], [null]],
    );
  }

  #bars(u) {
    if (this.#histogram === null) {
      return;
    }
    const { edges, counts, max } = this.#histogram;
    const { top, height } = u.bbox;
    u.ctx.fillStyle = color("accent");
    counts.forEach((count, k) => {
      if (count > 0) {
        const low = k === 0 ? edges[0] / 2 : edges[k - 1];
        const high = k < edges.length ? edges[k] : Math.max(max, low * 1.2);
        const [left, right] = [u.valToPos(low / 1e3, "x", true), u.valToPos(high / 1e3, "x", true)];
        const y = u.valToPos(count, "ticks", true);
        u.ctx.fillRect(
          Math.round(left) + 1,
          y,
          Math.max(1, Math.round(right) - Math.round(left) - 1),
          top + height - y,
        );
      }
    });
    [quantile(this.#histogram, 0.5), quantile(this.#histogram, 0.99)].forEach((value, k) => {
      const x = Math.round(u.valToPos(value / 1e3, "x", true));
      u.ctx.fillStyle = color("text");
      u.ctx.fillRect(x, top, uPlot.pxRatio, height);
      u.ctx.font = `${12 * uPlot.pxRatio}px system-ui, sans-serif`;
      u.ctx.textAlign = k === 0 ? "right" : "left";
      u.ctx.textBaseline = "top";
      u.ctx.fillText(k === 0 ? "p50" : "p99", x + (k === 0 ? -4 : 5) * uPlot.pxRatio, top + 2);
    });
  }
}
