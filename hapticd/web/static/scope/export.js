// Exports: a PNG of the picture with its legend, a CSV of all samples in the window.
import { color } from "../theme.js";
import { CHANNEL } from "./channels.js";

const LINES_PER_CHUNK = 5000; // the page continues to draw between them

// Returns copies of the rows from..to - 1 of some channels, which new samples cannot overwrite while they are written.
export function snapshot(source, ids, from, to, zero) {
  const count = to - from;
  const ticks = new Float64Array(count);
  const time = new Float64Array(count);
  for (let row = from; row < to; row++) {
    ticks[row - from] = source.store.ticks[row % source.capacity];
    time[row - from] = source.time[row % source.capacity] - zero;
  }
  return { count, columns: [ticks, time, ...ids.map((id) => source.copy(id, from, to))], headings: headings(ids) };
}

const headings = (ids) => ["tick", "time_s", ...ids.map((id) => CHANNEL[id].heading)];

// Returns the lines of a CSV file as parts of a Blob. Numbers have enough digits, at most 17, to be read back exactly.
export async function csvParts({ count, columns, headings: names }, pause) {
  const found = [`${names.join(",")}\n`];
  const row = new Array(columns.length);
  for (let begin = 0; begin < count; begin += LINES_PER_CHUNK) {
    let text = "";
    for (let i = begin; i < Math.min(count, begin + LINES_PER_CHUNK); i++) {
      for (let c = 0; c < columns.length; c++) {
        row[c] = columns[c][i];
      }
      text += `${row.join(",")}\n`;
    }
    found.push(text);
    await pause();
  }
  return found;
}

export const pause = () => new Promise((resume) => setTimeout(resume, 0));

// Draws the PNG: a title, the canvas, the legend and lines of text below it.
export function picture(canvas, ratio, title, legend, lines) {
  const paper = document.createElement("canvas");
  const ctx = paper.getContext("2d");
  const size = 13 * ratio;
  const font = (weight) => `${weight} ${size}px system-ui, sans-serif`;
  const margin = 12 * ratio;
  const lineHeight = 1.5 * size;
  const width = canvas.width + 2 * margin;
  ctx.font = font("normal");
  const wrapped = lines.flatMap((line) => wrap(ctx, line, width - 2 * margin));
  const entries = arrange(ctx, legend, width - 2 * margin, size);
  const legendHeight = entries.rows * lineHeight;
  paper.width = width;
  paper.height = canvas.height + 3 * margin + lineHeight + legendHeight + wrapped.length * lineHeight;
  ctx.fillStyle = color("surface");
  ctx.fillRect(0, 0, paper.width, paper.height);
  ctx.textBaseline = "middle";
  ctx.fillStyle = color("text");
  ctx.font = font("bold");
  ctx.fillText(title, margin, margin + lineHeight / 2);
  ctx.drawImage(canvas, margin, margin + lineHeight);
  ctx.font = font("normal");
  let top = 2 * margin + lineHeight + canvas.height;
  for (const { x, row, label, swatch } of entries.placed) {
    const y = top + (row + 0.5) * lineHeight;
    ctx.fillStyle = swatch;
    ctx.fillRect(margin + x, y - 0.3 * size, 0.9 * size, 0.6 * size);
    ctx.fillStyle = color("text");
    ctx.fillText(label, margin + x + 1.3 * size, y);
  }
  top += legendHeight;
  wrapped.forEach((line, k) => ctx.fillText(line, margin, top + (k + 0.5) * lineHeight));
  return paper;
}

function wrap(ctx, text, width) {
  const lines = [];
  let line = "";
  for (const word of text.split(" ")) {
    const longer = line === "" ? word : `${line} ${word}`;
    if (line !== "" && ctx.measureText(longer).width > width) {
      lines.push(line);
      line = word;
    } else {
      line = longer;
    }
  }
  return line === "" ? lines : [...lines, line];
}

function arrange(ctx, legend, width, size) {
  let [x, row] = [0, 0];
  const placed = legend.map(({ label, swatch }) => {
    const wide = ctx.measureText(label).width + 3 * size;
    if (x > 0 && x + wide > width) {
      [x, row] = [0, row + 1];
    }
    const entry = { x, row, label, swatch };
    x += wide;
    return entry;
  });
  return { placed, rows: legend.length === 0 ? 0 : row + 1 };
}

export const pngOf = (canvas) => new Promise((done) => canvas.toBlob(done, "image/png"));

// Lets the browser save a file.
export function save(blob, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}

// hapticd-20261123-120102.csv
export function fileName(now, ending) {
  const two = (value) => String(value).padStart(2, "0");
  const date = `${now.getFullYear()}${two(now.getMonth() + 1)}${two(now.getDate())}`;
  return `hapticd-${date}-${two(now.getHours())}${two(now.getMinutes())}${two(now.getSeconds())}.${ending}`;
}
