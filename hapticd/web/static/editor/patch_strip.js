// The patches of a wall as a strip over the hand's reach, with a scale in mm.
import { make, svg } from "../dom.js";

const TINTS = 6;

export function patchStrip(wall, reach) {
  const ends = wall.patches.flatMap(({ from_m: from, to_m: to }) => [from, to]);
  const low = Math.min(-reach, ...ends);
  const high = Math.max(reach, ...ends);
  const percent = (at) => `${((100 * (at - low)) / (high - low)).toFixed(3)}%`;
  const names = [...new Set(wall.patches.map(({ material }) => material))];
  const parts = wall.patches.map(({ from_m: from, to_m: to, material }) => {
    const width = `${Math.max((100 * (to - from)) / (high - low), 0).toFixed(3)}%`;
    const text = `${material}, ${millimetres(from)} to ${millimetres(to)} mm`;
    return svg("rect", { x: percent(from), y: 0, width, height: 20, class: `tint-${names.indexOf(material) % TINTS}` }, svg("title", {}, text));
  });
  const marks = [low, 0, high].map((at, index) => svg("text", { x: percent(at), y: 34, "text-anchor": ["start", "middle", "end"][index] }, `${millimetres(at)} mm`));
  const label = wall.patches.length ? `Patches: ${wall.patches.map((each) => `${each.material} from ${millimetres(each.from_m)} to ${millimetres(each.to_m)} mm`).join("; ")}` : "No patches";
  const legend = make("p", { class: "note legend" }, ...[...names.entries()].map(([index, name]) => make("span", { class: `key tint-${index % TINTS}`, text: name })), make("span", { class: "key tint-none", text: `${wall.material} elsewhere` }));
  return make("div", { class: "patch-strip" }, svg("svg", { role: "img", "aria-label": label, width: "100%", height: 38 }, svg("rect", { x: 0, y: 0, width: "100%", height: 20, class: "tint-none" }), ...parts, ...marks), legend);
}

const millimetres = (value) => Number((1000 * value).toFixed(3));
