// The panel of the answers, the newest first. It reads `app.session` (experimenter.js).
import { make } from "/static/dom.js";

const VERDICTS = new Map([[true, ["right", "right"]], [false, ["wrong", "wrong"]], [null, ["", ""]]]);
const textOf = (answer) => (typeof answer === "number" ? `${+answer.toPrecision(4)}` : (answer ?? "none"));

export function mount(app, element) {
  const { session } = app;
  const body = make("tbody", {});
  const head = make("tr", {}, ...["Trial", "Stimuli", "Answer", "", "s"].map((text) => make("th", { text, scope: "col", class: text === "s" ? "number" : "" })));
  element.replaceChildren(
    make("h2", { class: "answers-head", text: "Answers" }),
    make("div", { class: "answers-body", tabindex: "0" }, make("table", { class: "table" }, make("thead", {}, head), body)),
  );
  let drawn = 0;
  session.addEventListener("change", () => {
    for (; drawn < session.rows.length; drawn++) {
      const row = session.rows[drawn];
      const [word, kind] = VERDICTS.get(row.correct);
      body.prepend(make("tr", {},
        make("td", { text: row.trial + 1 }),
        make("td", { text: row.stimuli.join(" · "), title: row.condition }),
        make("td", { text: textOf(row.answer) }),
        make("td", { text: word, class: kind }),
        make("td", { text: row.response_s.toFixed(1), class: "number" }),
      ));
    }
  });
}
