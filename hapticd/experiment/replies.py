"""Converts typed texts and slider values to the answers that are stored."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

from hapticd.experiment.front import Shown
from hapticd.experiment.keys import POSITION_MEANINGS


def typed_reply(shown: Shown, text: str) -> str | float:
    """Convert `text` to the answer to a question of kind ranking, slider, number or text.

    Raises ValueError, with a message for the participant, if the answer is invalid.
    """
    return _REPLY_PARSERS[shown.kind](shown, text)


def _number(shown: Shown, text: str) -> float:
    low, high = shown.low, shown.high
    wanted = f"a number from {low:g} to {high:g}" if low is not None and high is not None else "a number"
    try:
        value = float(text)
    except ValueError:
        raise ValueError(f"{text}: must be {wanted}") from None
    if not math.isfinite(value) or (low is not None and value < low) or (high is not None and value > high):
        raise ValueError(f"{text}: must be {wanted}")
    return value


def _ranking(shown: Shown, text: str) -> str:
    """Convert the numbers of stimuli in a typed order, such as "2 1 3", to an answer such as second>first>third."""
    words = text.replace(">", " ").replace(",", " ").split()
    wanted = [str(number) for number in range(1, shown.stimuli + 1)]
    if sorted(words) != wanted:
        raise ValueError(f"{text}: must name each of {', '.join(wanted)} once, such as {' '.join(reversed(wanted))}")
    return ">".join(POSITION_MEANINGS[int(word) - 1] for word in words)


def _text(shown: Shown, text: str) -> str:
    most = shown.most_characters
    if most is not None and len(text) > most:
        raise ValueError(f"the text has {len(text)} characters, must have at most {most}")
    return text


_REPLY_PARSERS: Final[dict[str, Callable[[Shown, str], str | float]]] = {
    "ranking": _ranking,
    "slider": _number,
    "number": _number,
    "text": _text,
}
"""Functions that convert a typed text to an answer, by kind of question."""
