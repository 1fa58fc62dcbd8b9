"""The numbers by which other programs follow a session: what happened and when, and nothing of what is felt."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from typing import Final


class EventCode(IntEnum):
    """A number from 1 to 255, which a trigger line of eight bits holds.

    Those below 100 are sent by the session as marks: `text` of the mark, the number as `code` in its data. Those above
    stand for events of the daemon, of which no mark is made.
    """

    SESSION_BEGIN = 1, "the instructions were read, and the first trial follows"
    SESSION_RESUMED = 2, "the same, in a session that is continued"
    SESSION_END = 3, "no trial is left, or a stop rule ended the session"
    SESSION_ABORTED = 4, "the experimenter or an error ended the session early"
    TRIAL_ARMED = 10, "the scene of the first interval is loaded, and the forces are off"
    INTERVAL = 11, "the forces were switched on"
    FORCES_OFF = 12, "the force is zero after an interval"
    ANSWER = 13, "the answer was given; the forces are still on"
    TRIAL_END = 14, "the answer is on disk"
    TRIAL_GIVEN_UP = 15, "the attempt does not count; the trial begins again"
    BREAK_BEGIN = 20, "a break of the study"
    BREAK_END = 21, "the participant ended the break"
    PAUSE_BEGIN = 30, "the experimenter paused the session"
    PAUSE_END = 31, "the experimenter continued the session"
    CONTACT = 101, "an object was touched"
    RELEASE = 102, "it was let go"
    PUNCTURE = 103, "a membrane broke"
    FAULT = 104, "the set of latched faults changed"

    meaning: str

    def __new__(cls, number: int, meaning: str) -> EventCode:
        made = int.__new__(cls, number)
        made._value_ = number
        made.meaning = meaning
        return made

    @property
    def text(self) -> str:
        """The text of the mark, or the kind of the daemon's event."""
        return self.name.lower()


TRIAL_NUMBERS: Final = 1000
"""In a stream of plain numbers, this and the trial's follow TRIAL_ARMED, so that the trial is known."""

_OF_MARKS: Final = {int(code): code for code in EventCode if code < 100}
_OF_EVENTS: Final = {code.text: code for code in EventCode if code > 100}


def code_of(event: Mapping[str, object]) -> EventCode | None:
    """The code of an event of a daemon: of a session's mark, or of an event that has one. None: it has none.

    A mark that anybody else left has none, whatever its text is.
    """
    if event.get("event") != "mark":
        return _OF_EVENTS.get(str(event.get("event")))
    data = event.get("data")
    number = data.get("code") if isinstance(data, Mapping) else None
    code = _OF_MARKS.get(number) if type(number) is int else None
    return code if code is not None and code.text == event.get("text") else None
