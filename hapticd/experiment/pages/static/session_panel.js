// The panel of the session's state, with the experimenter's buttons. It reads `app.session` (experimenter.js).
import { button, make } from "/static/dom.js";

const DOING = {
  begins: "The participant reads the instructions.",
  reads: "The participant reads.",
  armed: "The next trial is ready. The forces are off.",
  withdraws: "The stylus is behind a surface. The forces are enabled once it is out.",
  felt: "The participant feels and answers.",
  rests: "A break.",
  paused: "Paused. The forces are off.",
  over: "The session is over.",
};

const BUTTON_LOCK_MS = 700; // a press so soon after a new screen was meant for the screen before
const percent = (part, total) => (total === 0 ? "–" : `${Math.round((100 * part) / total)} %`);

export function mount(app, element) {
  const { session } = app;
  const doing = make("p", { class: "doing", role: "status" });
  const here = make("p", {});
  const progress = make("progress", { "aria-label": "Completed trials" });
  const facts = make("dl", { class: "facts" });
  const log = make("div", { class: "log", role: "log" });
  const go = button("Begin", "primary go", () => session.goOn(), { id: "session-go-on" });
  go.addEventListener("keydown", (event) => event.repeat && event.preventDefault());
  const wait = make("p", { class: "wait", id: "session-wait" });
  let [screen, timer, worksAt] = [null, null, 0];
  // Enables the button at `worksAt`. During a break a line shows the remaining time.
  const unlock = () => {
    clearTimeout(timer);
    const { state } = session;
    const ms = worksAt - performance.now();
    go.disabled = ms > 0 || state.goes_on === null;
    const rests = ms > 0 && state.left_s > 0;
    wait.textContent = rests ? `The break lasts at least ${+state.least_s.toPrecision(4)} s: ${Math.ceil(ms / 1e3)} s left.` : "";
    if (ms > 0) {
      timer = setTimeout(unlock, Math.min(ms, 200));
    }
  };
  const auto = make("input", { type: "checkbox", id: "session-auto", on: { change: () => session.say("auto", { on: auto.checked }) } });
  const commands = ["pause", "repeat", "abort"].map((kind) =>
    button({ pause: "Pause", repeat: "Repeat the trial", abort: "End the session" }[kind], kind === "abort" ? "danger" : "", () => session.command(kind), { id: `session-${kind}` }),
  );
  const note = make("input", { type: "text", id: "session-note", maxlength: 10000, placeholder: "A note, saved with the trial", "aria-label": "Note" });
  const form = make("form", { class: "note-form" }, note, make("button", { class: "button", type: "submit", text: "Note" }));
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    if (note.value.trim() !== "") {
      session.command("note", note.value);
      note.value = "";
    }
  });
  const label = make("label", { class: "check", for: "session-auto" }, auto, "Trials begin automatically");
  const left = make("div", {}, doing, here, make("div", { class: "row" }, go, label), wait, make("div", { class: "row" }, ...commands), form, log);
  element.replaceChildren(make("div", { class: "session" }, left, make("div", { class: "stack" }, progress, facts)));

  session.addEventListener("change", () => {
    const { state } = session;
    doing.textContent = DOING[state.doing];
    const missing = Object.entries(state.here).filter(([, is]) => !is).map(([who]) => who);
    here.replaceChildren(make("span", {
      class: `pill ${missing.length > 0 ? "warn" : "ok"}`,
      text: missing.includes("participant") ? "The participant's page is not open" : "The participant's page is open",
    }));
    go.textContent = state.goes_on ?? "Continue";
    if (state.screen !== screen) {
      screen = state.screen;
      worksAt = performance.now() + BUTTON_LOCK_MS;
    }
    worksAt = Math.max(worksAt, performance.now() + 1e3 * state.left_s);
    unlock();
    auto.checked = state.auto;
    for (const each of commands) {
      each.disabled = state.doing === "over";
    }
    progress.max = state.total;
    progress.value = state.done;
    const correct = session.rows.filter((row) => row.correct === true).length;
    const judged = session.rows.filter((row) => row.correct !== null).length;
    const done = `${state.done} of ${state.at_most ? "at most " : ""}${state.total} trials`;
    const rows = { Study: state.title, Participant: `${state.participant}, session ${state.session}`, Done: done };
    if (state.trial !== null && state.doing !== "over") {
      const { trial } = state;
      Object.assign(rows, { Phase: state.phase, Condition: trial.condition, Stimuli: trial.stimuli.join(" · ") });
      if (trial.level !== null) {
        rows.Level = `${+trial.level.toPrecision(6)}`;
      }
      Object.assign(rows, { Asked: state.asked, Correct: trial.correct ?? "–", Attempt: trial.attempt });
    }
    if (judged > 0) {
      rows["So far"] = `${correct} of ${judged} correct (${percent(correct, judged)})`;
    }
    facts.replaceChildren(...Object.entries(rows).flatMap(([name, text]) => [make("dt", { text: name }), make("dd", { text })]));
    const wanted = JSON.stringify(state.lines);
    if (log.dataset.lines !== wanted) {
      log.dataset.lines = wanted;
      log.replaceChildren(...state.lines.map((text) => make("p", { text })));
      log.scrollTop = log.scrollHeight;
    }
  });
}
