// Colours of style.css for canvases: `color("contact")` is the value of --contact in the current theme, light or dark.
// `onTheme(call)` calls a function when the theme changes, to draw again.
const dark = matchMedia("(prefers-color-scheme: dark)");
let known = new Map();

export function color(name) {
  if (!known.has(name)) {
    const value = getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
    if (value === "") {
      throw new Error(`style.css has no colour --${name}`);
    }
    known.set(name, value);
  }
  return known.get(name);
}

const calls = new Set();

export function onTheme(call) {
  calls.add(call);
  return () => calls.delete(call);
}

dark.addEventListener("change", () => {
  known = new Map();
  for (const call of calls) {
    call();
  }
});
