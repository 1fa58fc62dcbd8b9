// The participant's page: shows the newest screen, sends the answers, and moves the hand of a simulated joystick.
// The screens are in hapticd/experiment/pages/screens.py, the methods of this page in participant_page.py.
import { CallError, CONNECTION_LOST, Link } from "/static/connection.js";
import { button, make } from "/static/dom.js";
import { Hand } from "/static/scene_view/hand.js";
import { Noise } from "./noise.js";
import { Picture, extent } from "./picture.js";
import { ask, keyName } from "./questions.js";

const part = (id) => document.getElementById(id);
const link = new Link(new URL("/socket", location.href));
const picture = new Picture(part("picture"));
const hand = new Hand((message) => link.notify("stream_target", message));
new Noise(part("noise"));

let screen = { screen: -1, kind: "wait" };
let moves = false; // whether this page moves the hand
let keys = new Map();
let enter = null;
let leftTimer = null;
let unsentStop = false; // whether to send the stop again with the next connection
let pressedAt = null; // the newest event of a pointer that is pressed on the picture

globalThis.participant = { get screen() { return screen; }, picture, hand, link }; // for tests

// ---- Messages to the server --------------------------------------------------------------------------------------------

let lasting = ""; // notice of the server, which it also removes
const notice = (text) => (part("notice").textContent = text || lasting);

async function say(method, params = {}) {
  try {
    await link.call(method, params);
    notice("");
  } catch (error) {
    if (!(error instanceof CallError)) {
      throw error;
    }
    notice(error.message);
  }
}

const once = (number, action) => () => {
  if (screen.screen === number) {
    action();
  }
};

function stop() {
  hand.allow(false);
  // Both at once, so that the forces are switched off without waiting for the session.
  const off = link.call("set_forces", { enabled: false }, { urgent: true, timeout_s: 1 });
  const over = link.call("participant.stop", {}, { urgent: true, timeout_s: 1 });
  unsentStop = true;
  return Promise.all([off, over]).then(
    () => {
      unsentStop = false;
      notice("Stopped. The forces are off.");
    },
    () => notice("The stop was not confirmed. Let go of the handle. The stop is sent again."),
  );
}

// ---- Screens -----------------------------------------------------------------------------------------------------------

function show(next) {
  if (next.screen === screen.screen) {
    return;
  }
  screen = next;
  [keys, enter] = [new Map(), null];
  clearInterval(leftTimer);
  notice("");
  const trial = next.kind === "trial";
  document.querySelector("main").classList.toggle("reading", !trial);
  const which = next.phase === "test" ? "Trial" : "Practice, trial";
  part("progress").textContent = trial ? `${which} ${next.number} of ${next.at_most ? "at most " : ""}${next.total}` : "";
  const element = part("screen");
  element.replaceChildren();
  (trial ? showTrial : showText)(element, next);
  const free = moves && trial && (next.felt || next.withdraws);
  hand.allow(free);
  if (pressedAt !== null && free) {
    grasp(); // the pointer was pressed before the forces were enabled
  }
  if (next.kind === "over") {
    link.end();
  }
  document.body.dataset.screen = next.screen;
  document.body.dataset.kind = next.kind;
}

// Returns an element of HTML that the server made of Markdown, without scripts.
function textOf(html) {
  const text = make("div", { class: "text" });
  text.innerHTML = html;
  return text;
}

function showText(element, { html, go_on, least_s, screen: number }) {
  element.append(textOf(html));
  if (!go_on) {
    return;
  }
  const goOn = once(number, () => go.disabled || say("participant.go_on", { screen: number }));
  const go = button(go_on, "primary", goOn, { id: "go-on" });
  go.append(make("kbd", { text: "Enter" }));
  enter = goOn;
  element.append(go);
  if (least_s > 0) {
    go.disabled = true;
    countDown(element, least_s, (left) => `The button works in ${left} s.`, () => (go.disabled = false));
  }
}

function showTrial(element, trial) {
  picture.show(trial.surfaces, trial.felt);
  hand.limits = trial.surfaces.length > 0 ? extent(trial.surfaces) : null;
  if (trial.told) {
    element.append(make("p", { class: "emphasis", text: trial.told }));
  }
  if (moves && (trial.felt || trial.withdraws)) {
    element.append(make("p", { class: "left", text: "Hold the mouse button down on the picture to move the stylus." }));
  }
  if (!trial.felt) {
    const text = trial.withdraws
      ? "Please move the stylus to where it touches nothing. Then the trial begins."
      : "The next trial is ready. Please wait for the experimenter.";
    element.append(make("p", { class: "left", text }));
    return;
  }
  if (!trial.in_places && trial.stimuli > 1) {
    element.append(make("p", { class: "emphasis", text: `${trial.interval} of ${trial.stimuli}` }));
  }
  if (trial.question === null) {
    const goOn = once(trial.screen, () => say("participant.go_on", { screen: trial.screen }));
    enter = goOn;
    const go = button("Next", "primary", goOn, { id: "go-on" });
    go.append(make("kbd", { text: "Enter" }));
    element.append(go);
    return;
  }
  element.append(textOf(trial.question.html));
  const answer = (value) => once(trial.screen, () => say("participant.answer", { screen: trial.screen, answer: value }))();
  ({ keys, enter } = ask(element, trial.question, trial.stimuli, answer));
  if (trial.question.left_s !== null) {
    countDown(element, trial.question.left_s, (left) => `${left} s left`, () => {});
  }
}

function countDown(element, seconds, text, then) {
  const ends = performance.now() + 1e3 * seconds;
  const line = make("p", { class: "left" });
  element.append(line);
  const tick = () => {
    const left = Math.max(0, Math.ceil((ends - performance.now()) / 1e3));
    line.textContent = left > 0 ? text(left) : "";
    if (left === 0) {
      clearInterval(leftTimer);
      then();
    }
  };
  tick();
  leftTimer = setInterval(tick, 200);
}

// ---- Keys, pointer, connection -----------------------------------------------------------------------------------------

const TYPED = "textarea, input[type=number]";

function pressed(event) {
  if (event.repeat || event.ctrlKey || event.altKey || event.metaKey) {
    return;
  }
  if (event.key === "Escape") {
    event.preventDefault();
    stop();
    return;
  }
  const typing = event.target.matches?.(TYPED);
  const action = typing ? undefined : keys.get(keyName(event));
  if (action !== undefined) {
    event.preventDefault();
    action();
  } else if (event.key === "Enter" && enter !== null && event.target.tagName !== "TEXTAREA" && !event.target.closest?.("#screen button")) {
    event.preventDefault();
    enter();
  } else if (event.key === " " && !typing) {
    event.preventDefault(); // the space bar stops, as on the other pages
    stop();
  }
}

function placeOf(event) {
  const box = part("picture").getBoundingClientRect();
  return picture.transform.toM([event.clientX - box.left, event.clientY - box.top]);
}

const grasp = () => hand.take("pointer", picture.stylus, placeOf(pressedAt));

function followPointer(canvas) {
  canvas.addEventListener("pointerdown", (event) => {
    if (moves && picture.stylus !== null && event.button === 0 && pressedAt === null) {
      canvas.setPointerCapture(event.pointerId);
      pressedAt = event;
      grasp();
    }
  });
  const letGo = () => {
    pressedAt = null;
    hand.release("pointer");
  };
  canvas.addEventListener("pointermove", (event) => {
    if (event.pointerId !== pressedAt?.pointerId) {
      return;
    }
    if ((event.buttons & 1) === 0) {
      letGo(); // the button was released outside of the page
      return;
    }
    pressedAt = event;
    hand.aimAt("pointer", placeOf(event));
  });
  for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) {
    canvas.addEventListener(name, (event) => event.pointerId === pressedAt?.pointerId && letGo());
  }
}

async function opened() {
  if (unsentStop) {
    stop();
  }
  let answer;
  try {
    answer = await link.call("participant.screen");
  } catch (error) {
    if (error.code === CONNECTION_LOST) {
      return; // the next connection requests the screen again
    }
    throw error;
  }
  moves = answer.hand;
  lasting = answer.notice;
  part("picture").classList.toggle("hand", moves);
  screen = { screen: -1 };
  show(answer.screen);
  link.notify("participant.beat");
}

async function begin() {
  addEventListener("keydown", pressed, { capture: true });
  addEventListener("keyup", (event) => {
    if (event.key === " " && !event.target.matches?.(TYPED)) {
      event.preventDefault(); // otherwise the space bar would press the focused button
    }
  }, { capture: true });
  part("stop").addEventListener("click", stop);
  followPointer(part("picture"));
  link.addEventListener("web", (event) => {
    if (event.detail.screen) {
      show(event.detail.screen);
    } else if (event.detail.notice !== undefined) {
      lasting = event.detail.notice;
      notice("");
    } else if (event.detail.ended) {
      link.end();
      hand.allow(false);
      screen.kind === "over" || notice(event.detail.ended);
    }
  });
  link.addEventListener("stylus", (event) => picture.moved(event.detail));
  link.addEventListener("close", () => screen.kind === "over" || notice("No connection. Let go of the handle: the forces fade within a few seconds. The page reconnects automatically."));
  const heart = new Worker("/static/heartbeat_worker.js");
  heart.onmessage = () => link.connected && link.notify("participant.beat");
  await link.open();
  await opened();
  link.addEventListener("open", opened);
  heart.postMessage(true);
  document.body.dataset.ready = "true";
}

begin();
