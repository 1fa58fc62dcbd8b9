// Colours of style.css for what is drawn on a canvas: `color("contact")` is the value of --contact, light or dark as the
// page is. `onTheme(call)` calls when that changes, so that a picture is drawn again.
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
