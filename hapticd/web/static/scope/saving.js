// The actions of the buttons PNG and CSV.
import uPlot from "../vendor/uplot/uPlot.esm.js";
import { color } from "../theme.js";
import { CHANNEL } from "./channels.js";
import { csvParts, fileName, pause, picture, pngOf, save, snapshot } from "./export.js";

const PICTURE_TITLES = { traces: "hapticd: traces", spectrum: "hapticd: spectrum", lateness: "hapticd: lateness of the servo" };

const notice = (scope, text, kind) =>
  scope.app.view.dispatchEvent(new CustomEvent("notice", { detail: { text, kind } }));

export async function savePng(scope) {
  const now = new Date();
  const from = { traces: scope.plot, spectrum: scope.spectrum, lateness: scope.histogram }[scope.shown];
  if (from.canvas === null) {
    notice(scope, "There is no picture to save yet.", "error");
    return;
  }
  const traces = scope.shown === "traces";
  const legend = traces
    ? scope.channels.map((id) => ({
        label: CHANNEL[id].label,
        swatch: color(`${CHANNEL[id].quantity}-${CHANNEL[id].part}`),
      }))
    : [];
  const readings =
    traces && scope.cursors.shown
      ? scope.cursors
          .readings(scope.source, scope.channels)
          .map(([name, time, frequency, ...values]) =>
            [`${name}: ${time}`, frequency, ...values.map((value, k) => `${CHANNEL[scope.channels[k]].label} ${value}`)]
              .filter(Boolean)
              .join(", "),
          )
      : [];
  const lines = [...readings, scope.message.textContent].filter(Boolean);
  const paper = picture(
    from.canvas,
    uPlot.pxRatio,
    `${PICTURE_TITLES[scope.shown]}, ${now.toLocaleString("en-GB")}`,
    legend,
    lines,
  );
  save(await pngOf(paper), fileName(now, "png"));
}

export async function saveCsv(scope) {
  const { source, view, channels } = scope;
  const from = source.rowAt(view.left);
  const to = source.rowAt(view.right);
  if (to <= from) {
    notice(scope, "There is no sample in the window to save.", "error");
    return;
  }
  const taken = snapshot(source, channels, from, to, view.zero);
  const name = fileName(new Date(), "csv");
  const text = await csvParts(taken, pause);
  save(new Blob(text, { type: "text/csv" }), name);
  notice(scope, `${taken.count.toLocaleString("en")} samples saved as ${name}.`, "info");
}
