// The bar at the top: state of the daemon, control of the forces, faults, warnings, and the stop. Space stops the forces
// unless the focus is in a text field. Escape stops them there, too, unless it cancels or closes something: then it does only
// that (the listener prevents the default).
import { make } from "./dom.js";
import { faultText, lateness } from "./status_words.js";

const BAR_HTML = `
  <div class="bar">
    <span class="brand">hapticd</span>
    <div class="forces">
      <span id="forces-state" class="pill plain" role="status">Connecting</span>
      <span id="forces-holder" class="holder"></span>
      <button id="forces-on" class="button small" type="button" hidden>Turn forces on</button>
    </div>
    <button id="facts-toggle" class="button quiet small" type="button" aria-expanded="false" aria-controls="facts">Details</button>
    <dl id="facts" class="bar-facts"></dl>
    <button id="stop" class="stop" type="button" aria-keyshortcuts="Space Escape">
      <span class="stop-word">Stop</span><span class="stop-key">space bar</span>
    </button>
  </div>
  <div id="alerts"></div>`;

const FACT_NAMES = ["Device", "Rate", "Lateness", "Missed", "Lost here", "Revision"];
const MAX_STATUS_SILENCE_S = 3; // the status comes once a second

// Whether the daemon, which sends its status every second, has stopped sending.
const silent = ({ app, heard }) => performance.now() - Math.max(heard, app.attention.since) > 1e3 * MAX_STATUS_SILENCE_S;

const number = new Intl.NumberFormat("en");

export function mount(app, element) {
  element.innerHTML = BAR_HTML;
  const part = (id) => document.getElementById(id);
  const facts = {};
  for (const name of FACT_NAMES) {
    facts[name] = make("dd", { text: "–" });
    part("facts").append(make("div", {}, make("dt", { text: name }), facts[name]));
  }
  const late = lateness();
  const bar = { app, part, facts, late, waiting: null, heard: performance.now() };

  part("facts-toggle").addEventListener("click", () => {
    const shown = element.classList.toggle("expanded");
    part("facts-toggle").setAttribute("aria-expanded", String(shown));
  });
  part("forces-on").addEventListener("click", () => app.safety.engage());
  stopBy(app, part("stop"));
  app.model.addEventListener("status", () => {
    late.add(app.model.status.histograms?.lateness_ns, app.model.status.started_ns);
    bar.heard = performance.now();
    drawFacts(bar);
    draw(bar);
  });
  app.samples.addEventListener("lost", () => drawFacts(bar));
  app.link.addEventListener("waiting", (event) => {
    bar.waiting = event.detail;
    draw(bar);
  });
  for (const name of ["open", "close"]) {
    app.link.addEventListener(name, () => {
      bar.waiting = null;
      bar.heard = performance.now();
      draw(bar);
    });
  }
  app.link.addEventListener("web", (event) => {
    if (event.detail.ended) {
      app.view.dispatchEvent(new CustomEvent("notice", { detail: { text: event.detail.ended, kind: "error" } }));
    }
  });
  app.model.addEventListener("away", () => draw(bar));
  app.model.addEventListener("back", () => draw(bar));
  app.safety.addEventListener("change", () => draw(bar));
  setInterval(() => draw(bar), 1000);
  draw(bar);
}

// ---- The stop ------------------------------------------------------------------------------------------------------

// Fields in which a space can be typed; not fields of numbers.
const TEXT_FIELDS = "input:is([type=text], [type=search], [type=password], :not([type])):not([data-number]), textarea, [contenteditable=true]";

const isModified = (event) => event.ctrlKey || event.altKey || event.metaKey;
const isFreeSpace = (event) => event.key === " " && !event.target.closest?.(TEXT_FIELDS);

function stopBy(app, button) {
  // In the capture phase, so that no other key listener can block the stop.
  addEventListener("keydown", (event) => {
    if (isFreeSpace(event) && !isModified(event)) {
      event.preventDefault(); // so that the space does not scroll, press or tick the focused element; Enter does
      if (!event.repeat) {
        app.safety.stop();
      }
    }
  }, { capture: true });
  addEventListener("keyup", (event) => {
    if (isFreeSpace(event)) {
      event.preventDefault();
    }
  }, { capture: true });
  addEventListener("keydown", (event) => {
    if (event.defaultPrevented || event.repeat || isModified(event)) {
      return;
    }
    if (event.key === "Escape") {
      app.safety.stop();
    } else if (event.key === "Enter" && event.target.matches?.("input[type=checkbox]")) {
      event.preventDefault();
      event.target.click(); // as a space usually does
    }
  });
  let pressed = false;
  button.addEventListener("pointerdown", () => {
    pressed = true; // at the press, not at the release
    app.safety.stop();
  });
  button.addEventListener("click", () => {
    if (!pressed) {
      app.safety.stop();
    }
    pressed = false;
  });
}

// ---- Display -------------------------------------------------------------------------------------------------------

function drawFacts({ app, facts, late }) {
  const { status } = app.model;
  if (status.device === undefined) {
    return;
  }
  const set = (name, text, bad = false) => {
    if (facts[name].textContent !== text) {
      facts[name].textContent = text;
    }
    facts[name].classList.toggle("bad", bad);
  };
  const { configured_rate_hz } = status.overruns;
  const slower = status.rate_hz < configured_rate_hz;
  set("Device", status.device === "sim" ? "simulated joystick" : (status.connection?.name ?? status.device));
  set("Rate", `${number.format(status.rate_hz)} Hz${slower ? ` of ${number.format(configured_rate_hz)}` : ""}`, slower);
  set("Lateness", late.text());
  set("Missed", `${number.format(status.counters.skipped)} periods`, status.counters.skipped > 0);
  set("Lost here", `${number.format(app.samples.lost)} samples`, app.samples.lost > 0);
  set("Revision", number.format(status.revision));
}

// [text, class] of the pill for forces and connection, the worst first.
function stateOf(bar) {
  const { app, waiting } = bar;
  const { safety, link, model } = app;
  if (!link.connected) {
    return waiting === null ? ["Connecting", "plain"] : ["No connection", "bad"];
  }
  if (model.away || silent(bar)) {
    return ["Daemon does not answer", "bad"];
  }
  if (safety.stopping) {
    return ["Stopping", "bad"];
  }
  const checking = model.state?.flag_names.includes("checking");
  return {
    on: checking ? ["Forces held back", "warn"] : ["Forces on", "ok"],
    off: ["Forces off", "warn"],
    faulted: ["Forces off: fault", "bad"],
    unknown: ["Connecting", "plain"],
  }[safety.forces];
}

function draw(bar) {
  const { app, part } = bar;
  const { safety } = app;
  const [word, kind] = stateOf(bar);
  const state = part("forces-state");
  if (state.textContent !== word) {
    state.textContent = word;
  }
  state.className = `pill ${kind}`;
  part("forces-holder").textContent = {
    "this page": "held by this page",
    another: "held by another page or program",
  }[safety.holder] ?? "";
  const live = ["Forces on", "Forces off", "Forces off: fault", "Forces held back"].includes(word);
  part("forces-on").hidden = !live || safety.holds || (safety.forces === "on" && safety.simulated);
  part("forces-on").disabled = safety.holder === "another";
  part("forces-on").textContent = safety.forces === "faulted" ? "Clear and turn forces on" : "Turn forces on";
  part("stop").classList.toggle("stopping", safety.stopping);
  drawAlerts(bar);
}

// Lines below the bar: why there is no connection, why forces are off, what of the scene is not displayed as specified.
function drawAlerts(bar) {
  const { app, part, waiting } = bar;
  const { safety, model, link } = app;
  const lines = [];
  if (!link.connected && waiting !== null) {
    lines.push(["bad", waiting.refused
      ? "The server of this page was started again. Open the address that it printed."
      : `The server of this page does not answer. The next try is in ${number.format(waiting.pause_s)} s.`]);
  } else if (link.connected && (model.away || silent(bar))) {
    lines.push(["bad", "The daemon does not answer. See `hapticd status`; the page continues when it answers again."]);
  } else if (link.connected) {
    for (const fault of safety.faults) {
      lines.push(["bad", faultText(fault, model)]);
    }
    lines.push(...(model.status.connection?.warnings ?? []).map((text) => ["warn", text]));
    const signs = model.status.connection?.signs;
    if (safety.forces === "on" && (signs?.state === "checking" || signs?.state === "waiting")) {
      lines.push(["warn", signs.advice ?? "The joystick's directions are checked: let go of the handle, or hold it " +
        "lightly and still if it has a hand sensor."]);
    }
    if (safety.forces === "off" && model.status.device === "hid") {
      const limit = model.config.device?.max_force_n;
      lines.push(["warn", `“Turn forces on” lets the joystick push the hand, with up to ${number.format(limit)} N. ` +
        "Hold the handle. Closing this page turns the forces off within 1 s."]);
    }
  }
  const alerts = part("alerts");
  const wanted = JSON.stringify(lines);
  if (alerts.dataset.lines !== wanted) {
    alerts.dataset.lines = wanted;
    const roleOf = (kind) => (kind === "bad" ? "alert" : "status");
    alerts.replaceChildren(...lines.map(([kind, text]) => make("p", { class: `alert ${kind}`, role: roleOf(kind), text })));
  }
}
