// The picture: axes by uPlot, traces by trace_drawing.js. It is drawn completely whenever something in it changed.
import uPlot from "../vendor/uplot/uPlot.esm.js";
import { color } from "../theme.js";
import { CHANNEL, SCALES } from "./channels.js";
import { timeUnit } from "./elements.js";
import { Columns, Raster, drawCurve, drawGaps, drawTrace, pixelOf } from "./trace_drawing.js";
import { VerticalScale } from "./vertical_scale.js";

const MIN_RANGES = { force: 0.02, position: 0.05, velocity: 0.002 }; // the smallest range of an automatic scale
const AXIS_FONT = "12px system-ui, sans-serif";

// Returns the options of a uPlot axis in the page's colours.
export function axis(more) {
  return {
    stroke: () => color("muted"),
    font: AXIS_FONT,
    labelFont: AXIS_FONT,
    labelSize: 18,
    labelGap: 0,
    gap: 4,
    ticks: { stroke: () => color("border"), width: 1, size: 4 },
    grid: { stroke: () => color("grid"), width: 1 },
    ...more,
  };
}

// Makes a uPlot figure in the host's size, without uPlot's legend, cursor and selection.
export function figureIn(host, options, data) {
  return new uPlot(
    {
      width: Math.max(120, host.clientWidth),
      height: Math.max(80, host.clientHeight),
      legend: { show: false },
      cursor: { show: false },
      select: { show: false },
      ...options,
    },
    data,
    host,
  );
}

export const readable = (value) => String(Number(value.toPrecision(6))).replace("-", "−");

export class Plot {
  scales = Object.fromEntries(Object.keys(SCALES).map((id) => [id, new VerticalScale(MIN_RANGES[id])]));
  box = { left: 0, top: 0, width: 0, height: 0 }; // area of the traces, in pixels of the canvas
  columns = new Columns();
  #raster = new Raster();
  #uplot = null;
  #host;
  #channels = [];
  #colors = [];
  #frame = null; // the frame that is being drawn: {source, view, curves, level}
  #time = { unit: "s", factor: 1 };

  constructor(host) {
    this.#host = host;
  }

  get canvas() {
    return this.#uplot.ctx.canvas;
  }

  // Sets the channels to draw, in the host's size. Must also be called when the size or the colours changed.
  configure(ids) {
    this.#channels = ids.map((id) => CHANNEL[id]);
    this.#colors = this.#channels.map(({ quantity, part }) => color(`${quantity}-${part}`));
    const used = Object.keys(SCALES).filter((id) => this.#channels.some((channel) => channel.scale === id));
    const shown = used.length > 0 ? used : ["force"];
    this.#uplot?.destroy();
    this.#uplot = figureIn(this.#host, this.#options(shown), [[0], ...shown.map(() => [null])]);
    const { left, top, width, height } = this.#uplot.bbox;
    Object.assign(this.box, {
      left,
      top,
      width: Math.max(1, Math.round(width)),
      height: Math.max(1, Math.round(height)),
    });
  }

  #options(shown) {
    const fixed = { auto: false, range: (_, low, high) => [low, high] };
    return {
      padding: [8, shown.some((id) => SCALES[id].side === 1) ? 0 : 12, 0, 0],
      scales: { x: { ...fixed, time: false }, ...Object.fromEntries(shown.map((id) => [id, fixed])) },
      axes: [
        axis({
          scale: "x",
          size: 26,
          label: "Time",
          space: 60,
          values: (_, at) => at.map((t) => readable(t * this.#time.factor)),
        }),
        ...shown.map((id, k) =>
          axis({
            scale: id,
            side: SCALES[id].side,
            size: 46,
            space: 28,
            label: `${SCALES[id].label}, ${SCALES[id].unit}`,
            grid: { show: k === 0, stroke: () => color("grid"), width: 1 },
            values: (_, at) => at.map(readable),
          }),
        ),
      ],
      series: [{}, ...shown.map((id) => ({ scale: id, paths: () => null, points: { show: false } }))],
      hooks: { drawClear: [(u) => this.#under(u.ctx)], draw: [(u) => this.#over(u.ctx)] },
    };
  }

  // Draws `view` of `source`. `curves`: {channel, times, values}. `level`: {channel, value}, or null. `settled`: the
  // picture does not move.
  draw(source, view, curves, level, settled) {
    this.#frame = { source, view, curves, level };
    const { left, widthS } = view;
    this.columns.prepare(source, left, widthS, this.box.width);
    for (const id of Object.keys(SCALES)) {
      this.#fit(id, source, settled);
    }
    const zero = view.zero;
    this.#time = timeUnit(widthS);
    this.#uplot.batch((u) => {
      u.axes[0].label = `Time from ${view.trigger === null ? "the newest sample" : "the trigger"}, ${this.#time.unit}`;
      u.setScale("x", { min: left - zero, max: left - zero + widthS });
      for (const id of Object.keys(SCALES)) {
        if (u.scales[id] !== undefined) {
          u.setScale(id, { min: this.scales[id].low, max: this.scales[id].high });
        }
      }
    });
  }

  #fit(id, source, settled) {
    let low = Infinity;
    let high = -Infinity;
    for (const channel of this.#channels) {
      if (channel.scale === id) {
        const { pyramid } = source.track(channel.id);
        pyramid.range(this.columns.from, this.columns.to);
        low = Math.min(low, pyramid.low * channel.factor);
        high = Math.max(high, pyramid.high * channel.factor);
      }
    }
    this.scales[id].fit(low, high, performance.now(), settled);
  }

  #under(ctx) {
    if (this.#frame !== null) {
      drawGaps(ctx, this.columns, this.box, color("gap"));
    }
  }

  #over(ctx) {
    if (this.#frame === null) {
      return;
    }
    const { source, view, curves, level } = this.#frame;
    const { box } = this;
    ctx.save();
    ctx.beginPath();
    ctx.rect(box.left, box.top, box.width, box.height);
    ctx.clip();
    const ratio = uPlot.pxRatio;
    this.#marks(ctx, view, level, ratio);
    this.#raster.begin(box.width, box.height);
    const style = { color: "", pixel: 0, width: 1.25 * ratio, left: view.left, widthS: view.widthS, dash: [] };
    this.#channels.forEach((channel, k) => {
      style.color = this.#colors[k];
      style.pixel = pixelOf(style.color);
      const { scale, factor } = channel;
      drawTrace(
        ctx,
        this.#raster,
        source,
        source.track(channel.id),
        this.columns,
        box,
        this.scales[scale],
        factor,
        style,
      );
    });
    this.#raster.draw(ctx, box.left, box.top);
    for (const { channel, times, values } of curves) {
      const { scale, factor } = CHANNEL[channel];
      const curve = { ...style, color: color("text"), width: 1.5 * ratio, dash: [5 * ratio, 4 * ratio] };
      drawCurve(ctx, times, values, box, this.scales[scale], factor, curve);
    }
    ctx.restore();
  }

  // Draws the time and the level of the trigger.
  #marks(ctx, view, level, ratio) {
    const { box } = this;
    ctx.fillStyle = color("muted");
    if (view.trigger !== null) {
      const x = Math.round(box.left + ((view.trigger - view.left) / view.widthS) * box.width);
      for (let y = box.top; y < box.top + box.height; y += 6 * ratio) {
        ctx.fillRect(x, y, ratio, 3 * ratio);
      }
      ctx.beginPath();
      ctx.moveTo(x - 5 * ratio, box.top);
      ctx.lineTo(x + 6 * ratio, box.top);
      ctx.lineTo(x + ratio / 2, box.top + 8 * ratio);
      ctx.fill();
    }
    if (level !== null && this.#channels.some(({ scale }) => scale === CHANNEL[level.channel].scale)) {
      const { scale, factor } = CHANNEL[level.channel];
      const { low, high } = this.scales[scale];
      const y = Math.round(box.top + box.height * (1 - (level.value * factor - low) / (high - low)));
      for (let x = box.left; x < box.left + box.width; x += 8 * ratio) {
        ctx.fillRect(x, y, 4 * ratio, ratio);
      }
    }
  }

  // Returns the area of the traces in CSS pixels, from the host's corner.
  get cssBox() {
    const ratio = uPlot.pxRatio;
    const { left, top, width, height } = this.box;
    return { left: left / ratio, top: top / ratio, width: width / ratio, height: height / ratio };
  }

  destroy() {
    this.#uplot?.destroy();
  }
}
