// The question of a trial: buttons and keys, a slider, a number, an order, a text.
//
//   ask(element, question, stimuli, answer)   shows a question and calls `answer(value)` with the participant's answer.
//                                             Returns {keys, enter}: actions by key name; action of Enter, or null
import { button, make } from "/static/dom.js";

const NAMED = { ArrowLeft: "left", ArrowRight: "right", ArrowUp: "up", ArrowDown: "down", " ": "space", Enter: "enter" };

// Returns the name of a key as in a study's YAML.
export const keyName = (event) => NAMED[event.key] ?? event.key;

const withKey = (label, key, action) => {
  const made = button(label, "", action);
  made.append(make("kbd", { text: key }));
  return made;
};

function choice(element, { answers }, _, answer) {
  const keys = new Map();
  const buttons = answers.map(({ label, key }, index) => {
    keys.set(key, () => answer(index));
    return withKey(label, key, () => answer(index));
  });
  element.append(make("div", { class: "answers" }, ...buttons));
  return { keys, enter: null };
}

function measure(element, { done }, _, answer) {
  element.append(withKey(done, "Enter", () => answer(null)));
  return { keys: new Map(), enter: () => answer(null) };
}

function slider(element, { low, high, step, ends }, _, answer) {
  const input = make("input", { type: "range", min: low, max: high, step: step ?? "any", value: (low + high) / 2, "aria-label": "Your answer" });
  const value = make("output", { text: "Move the slider." });
  const go = withKey("Answer", "Enter", () => send());
  go.disabled = true; // until the slider was moved
  const send = () => go.disabled || answer(Number(input.value));
  input.addEventListener("input", () => {
    go.disabled = false;
    value.textContent = `${+Number(input.value).toPrecision(3)}`;
  });
  element.append(make("div", { class: "scale" }, make("span", { text: ends[0] ?? low }), input, make("span", { text: ends[1] ?? high }), value), go);
  return { keys: new Map(), enter: send };
}

function number(element, { low, high }, _, answer) {
  const input = make("input", { type: "number", min: low, max: high, step: "any", "aria-label": "Your answer" });
  const send = () => input.value !== "" && answer(Number(input.value));
  element.append(input, withKey("Answer", "Enter", send));
  input.focus();
  return { keys: new Map(), enter: send };
}

function text(element, { most_characters }, _, answer) {
  const input = make("textarea", { maxlength: most_characters, "aria-label": "Your answer" });
  element.append(input, button("Answer", "primary", () => answer(input.value)));
  input.focus();
  return { keys: new Map(), enter: null };
}

function ranking(element, _, stimuli, answer) {
  const order = [];
  const chosen = make("p", { class: "left", text: "Press the surfaces in their order." });
  const keys = new Map();
  const buttons = Array.from({ length: stimuli }, (__, index) => {
    const pick = () => {
      order.push(index + 1);
      buttons[index].disabled = true;
      keys.delete(String(index + 1));
      chosen.textContent = order.join(" > ");
      again.disabled = false;
      if (order.length === stimuli) {
        go.disabled = false;
      }
    };
    keys.set(String(index + 1), pick);
    return withKey(`Surface ${index + 1}`, String(index + 1), pick);
  });
  const again = button("Start over", "", () => {
    order.length = 0;
    chosen.textContent = "";
    again.disabled = go.disabled = true;
    buttons.forEach((each, index) => {
      each.disabled = false;
      keys.set(String(index + 1), () => each.click());
    });
  });
  const send = () => go.disabled || answer(order.join(" "));
  const go = withKey("Answer", "Enter", send);
  again.disabled = go.disabled = true;
  element.append(make("div", { class: "ranking" }, ...buttons), chosen, make("div", { class: "answers" }, again, go));
  return { keys, enter: send };
}

const KINDS = { choice, measure, slider, number, text, ranking };

export const ask = (element, question, stimuli, answer) => KINDS[question.kind](element, question, stimuli, answer);
