"""The screens of the participant's page, as JSON data.

A screen has its kind as `kind` and its number as `screen`. Messages of the page about a screen contain this number.

    read    html; go_on: label of the button, or null; least_s: time in s until the button works
    wait    html: a text while the participant waits for the experimenter
    trial   number, total, at_most, phase, surfaces, stimuli, in_places, interval; felt: whether the forces are on;
            withdraws: whether the handle must be moved out before the forces are enabled; `told`: feedback on the
            previous trial; question, null if it is not shown: kind, html, answers, low, high, step, ends,
            most_characters, left_s
    over    html: a text after the session

An answer has a label and a key, but no name. No screen contains the name of a stimulus, a factor, a level, a condition
or a cell.
"""

from __future__ import annotations

from functools import cache
from typing import Final, TypeAlias

from markdown_it import MarkdownIt

from hapticd.experiment.front import Shown

Screen: TypeAlias = "dict[str, object]"
MEASURE_BUTTON_TEXT: Final = "Done"
"""Label of the button if the motion itself is the answer."""


@cache
def _markdown() -> MarkdownIt:
    # HTML in a text is shown as text, and links that run a script are not made.
    return MarkdownIt("commonmark", {"html": False, "typographer": False}).enable("table")


def html(markdown: str) -> str:
    """Convert Markdown to HTML, without scripts."""
    return str(_markdown().render(markdown.strip()))


def read(markdown: str, go_on: str | None, least_s: float = 0.0) -> Screen:
    """Return a screen with a text and a button labelled `go_on`, if any, which works after `least_s` seconds."""
    return {"kind": "read", "html": html(markdown), "go_on": go_on, "least_s": least_s}


def wait(markdown: str) -> Screen:
    """Return a screen with a text for a participant who waits for the experimenter."""
    return {"kind": "wait", "html": html(markdown)}


def over(markdown: str) -> Screen:
    """Return the screen with a text after the session."""
    return {"kind": "over", "html": html(markdown)}


def trial(
    shown: Shown,
    *,
    interval: int,
    felt: bool,
    asks: bool,
    withdraws: bool = False,
    left_s: float | None = None,
    feedback: str = "",
) -> Screen:
    """Return the screen of a trial.

    `interval` counts from 1. `felt` is whether the forces are on, `asks` whether the question is shown, `withdraws`
    whether the handle must be moved out first. `left_s` is the time for the answer in s, `feedback` the text
    on the previous trial.
    """
    return {
        "kind": "trial",
        "number": shown.number,
        "total": shown.total,
        "at_most": shown.at_most,
        "phase": shown.phase,
        "stimuli": shown.stimuli,
        "in_places": shown.in_places,
        "interval": interval,
        "surfaces": [
            {"point_m": list(each.point_m), "normal": list(each.normal), "half_m": each.half_m}
            for each in shown.surfaces_of(interval)
        ],
        "felt": felt,
        "withdraws": withdraws,
        "told": feedback,
        "question": _question(shown, left_s) if asks else None,
    }


def _question(shown: Shown, left_s: float | None) -> dict[str, object]:
    return {
        "kind": shown.kind,
        "html": html(shown.text),
        # An answer without a key has its number as key. faults.py refuses a study in which another answer has this key.
        "answers": [
            {"label": each.label, "key": each.key or str(number)} for number, each in enumerate(shown.answers, 1)
        ],
        "low": shown.low,
        "high": shown.high,
        "step": shown.step,
        "ends": list(shown.ends),
        "most_characters": shown.most_characters,
        "left_s": left_s,
        "done": MEASURE_BUTTON_TEXT,
    }
