// Drawing of one trace on a canvas. In wide windows, each column of pixels has a bar from its smallest to its largest sample.
// In narrow windows, samples are connected by lines, with dots if their distance is large. Gaps stay open.

const MAX_POINTS_PER_COLUMN = 2; // samples in a column of pixels above which columns are drawn
const MIN_DOT_DISTANCE_PX = 6; // pixels between samples from which on each has a dot

// The rows and columns of pixels of a window, computed once a frame for all traces. Nothing is allocated while the width
// stays the same.
export class Columns {
  #edges = new Float64Array(0); // the first row of each column, and the end
  gaps = new Uint8Array(0); // 1: samples of this column were missed or lost
  count = 0;
  raw = true;
  from = 0; // drawn rows, with one more on either side if it exists
  to = 0;

  prepare(source, left, widthS, pixels) {
    if (this.gaps.length !== pixels) {
      this.#edges = new Float64Array(pixels + 1);
      this.gaps = new Uint8Array(pixels);
    }
    this.count = pixels;
    const begin = source.rowAt(left);
    const end = source.rowAt(left + widthS);
    this.from = Math.max(source.first, begin - 1);
    this.to = Math.min(source.rows, end + 1);
    this.raw = end - begin < MAX_POINTS_PER_COLUMN * pixels;
    const step = widthS / pixels;
    // Columns keep their times while the window moves, so that a rolling picture does not flicker.
    const start = this.raw ? left : Math.round(left / step) * step;
    for (let c = 0; c <= pixels; c++) {
      this.#edges[c] = source.rowAt(start + c * step);
    }
    this.gaps.fill(0);
    if (!source.lostWithin(this.from, this.to)) {
      return;
    }
    for (let c = 0; c < pixels; c++) {
      this.gaps[c] = source.lostWithin(this.#edges[c], this.#edges[c + 1]) ? 1 : 0;
    }
    this.#widen(source);
  }

  // The columns of a gap are those from the last row before it to the first row after it.
  #widen(source) {
    let open = -1; // the first column without rows since the last one with rows
    for (let c = 0; c < this.count; c++) {
      if (this.#edges[c] === this.#edges[c + 1]) {
        open = open < 0 ? c : open;
      } else {
        if (open >= 0 && source.lostBefore(this.#edges[c])) {
          this.gaps.fill(1, open, c);
        }
        open = -1;
      }
    }
    if (open >= 0 && source.lostBefore(this.#edges[this.count])) {
      this.gaps.fill(1, open);
    }
  }

  first(c) {
    return this.#edges[c];
  }
}

// An image of the traces' size in which bars are drawn by pixels: for thousands of bars this is far faster than a canvas.
export class Raster {
  #canvas = document.createElement("canvas");
  #ctx = this.#canvas.getContext("2d", { willReadFrequently: true });
  #image = null;
  #pixels = null;
  #width = 0;
  #height = 0;
  #empty = true;

  // Begins an image of this size.
  begin(width, height) {
    if (width !== this.#width || height !== this.#height) {
      [this.#width, this.#height] = [width, height];
      this.#canvas.width = width;
      this.#canvas.height = height;
      this.#image = this.#ctx.createImageData(width, height);
      this.#pixels = new Uint32Array(this.#image.data.buffer);
    } else if (!this.#empty) {
      this.#pixels.fill(0);
    }
    this.#empty = true;
  }

  // Draws a bar one pixel wide, clipped to the image. `color`: from `pixelOf`.
  bar(x, top, height, color) {
    const width = this.#width;
    const end = Math.min(this.#height, top + height) * width;
    for (let at = Math.max(0, top) * width + x; at < end; at += width) {
      this.#pixels[at] = color;
    }
    this.#empty = false;
  }

  draw(ctx, left, top) {
    if (!this.#empty) {
      this.#ctx.putImageData(this.#image, 0, 0);
      ctx.drawImage(this.#canvas, left, top);
    }
  }
}

// Returns the colour #rrggbb as a pixel of a Raster.
export function pixelOf(hex) {
  const value = Number.parseInt(hex.slice(1), 16);
  const bytes = new Uint8Array([value >> 16, (value >> 8) & 255, value & 255, 255]);
  return new Uint32Array(bytes.buffer)[0];
}

// Fills the columns in which samples were missed or lost.
export function drawGaps(ctx, columns, box, fill) {
  ctx.fillStyle = fill;
  for (let c = 0; c < columns.count; c++) {
    if (columns.gaps[c] === 1) {
      let end = c + 1;
      while (end < columns.count && columns.gaps[end] === 1) {
        end++;
      }
      ctx.fillRect(box.left + c, box.top, Math.max(2, end - c), box.height);
      c = end;
    }
  }
}

// Columns go into `raster`, samples are drawn at once. `scale`: {low, high} in the axis' unit, `factor` from SI to it.
// `box`: {left, top, width, height}, in pixels of the canvas.
export function drawTrace(ctx, raster, source, track, columns, box, scale, factor, style) {
  if (columns.raw) {
    drawSamples(ctx, source, track, columns, box, scale, factor, style);
  } else {
    drawColumns(raster, source, track, columns, box, scale, factor, style);
  }
}

function drawColumns(raster, source, track, columns, box, scale, factor, style) {
  const { pyramid } = track;
  const perUnit = box.height / (scale.high - scale.low);
  const thick = Math.max(1, Math.round(style.width));
  let before = false; // the previous column has samples, and no sample is missing between
  let lastLow = 0;
  let lastHigh = 0;
  for (let c = 0; c < columns.count; c++) {
    const from = columns.first(c);
    pyramid.range(from, columns.first(c + 1));
    let { low, high } = pyramid;
    if (!(low <= high)) {
      before = false;
      continue;
    }
    const joined = before && source.gaps[from % source.capacity] === 0;
    if (joined && low > lastHigh) {
      low = lastHigh;
    } else if (joined && high < lastLow) {
      high = lastLow;
    }
    lastLow = pyramid.low;
    lastHigh = pyramid.high;
    const top = Math.round(box.height - (high * factor - scale.low) * perUnit - thick / 2);
    const bottom = Math.round(box.height - (low * factor - scale.low) * perUnit + thick / 2);
    raster.bar(c, top, Math.max(thick, bottom - top), style.pixel);
    before = true;
  }
}

function drawSamples(ctx, source, track, columns, box, scale, factor, style) {
  const { column } = track;
  const { time, capacity, gaps } = source;
  const perUnit = box.height / (scale.high - scale.low);
  const perSecond = box.width / style.widthS;
  const bottom = box.top + box.height;
  const dots = source.periodS * perSecond >= MIN_DOT_DISTANCE_PX;
  ctx.strokeStyle = ctx.fillStyle = style.color;
  ctx.lineWidth = style.width;
  ctx.lineJoin = "round";
  ctx.beginPath();
  for (let row = columns.from; row < columns.to; row++) {
    const at = row % capacity;
    const x = box.left + (time[at] - style.left) * perSecond;
    const y = bottom - (column[at] * factor - scale.low) * perUnit;
    if (row === columns.from || gaps[at] === 1) {
      ctx.moveTo(x, y);
      if (row + 1 === columns.to || gaps[(row + 1) % capacity] === 1) {
        ctx.lineTo(x + style.width, y); // a single sample
      }
    } else {
      ctx.lineTo(x, y);
    }
  }
  ctx.stroke();
  if (dots) {
    const size = 2 * Math.max(1.5, style.width);
    for (let row = columns.from; row < columns.to; row++) {
      const at = row % capacity;
      const x = box.left + (time[at] - style.left) * perSecond;
      const y = bottom - (column[at] * factor - scale.low) * perUnit;
      ctx.fillRect(x - size / 2, y - size / 2, size, size);
    }
  }
}

// Draws a curve {times, values} that is not a channel, such as the library's closed form: dashed, above the traces.
export function drawCurve(ctx, times, values, box, scale, factor, style) {
  const perUnit = box.height / (scale.high - scale.low);
  const perSecond = box.width / style.widthS;
  const bottom = box.top + box.height;
  ctx.strokeStyle = style.color;
  ctx.lineWidth = style.width;
  ctx.setLineDash(style.dash);
  ctx.beginPath();
  for (let i = 0; i < times.length; i++) {
    const x = box.left + (times[i] - style.left) * perSecond;
    const y = bottom - (values[i] * factor - scale.low) * perUnit;
    if (i === 0) {
      ctx.moveTo(x, y);
    } else {
      ctx.lineTo(x, y);
    }
  }
  ctx.stroke();
  ctx.setLineDash([]);
}
