"""Event codes: numbers that report the events of a session to other programs. They do not reveal the stimuli."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from typing import Final


class EventCode(IntEnum):
    """A code of an event, from 1 to 255: it fits a trigger port of eight bits.

    The session sends codes below 100 as marks. The text of a mark is `text`, its data has the number as `code`. Codes
    above 100 stand for the daemon's own events.
    """

    SESSION_BEGIN = 1, "the participant has read the instructions; the first trial follows"
    SESSION_RESUMED = 2, "the session continues: the participant has read the instructions; the next trial follows"
    SESSION_END = 3, "all trials are done, or a stop rule ended the session"
    SESSION_ABORTED = 4, "the experimenter or an error ended the session early"
    TRIAL_ARMED = 10, "the scene of the first interval is loaded, and the forces are off"
    INTERVAL = 11, "the forces were switched on"
    FORCES_OFF = 12, "the force is zero after an interval"
    ANSWER = 13, "the answer was given; the forces are still on"
    TRIAL_END = 14, "the answer is on disk"
    TRIAL_GIVEN_UP = 15, "the attempt does not count; the trial begins again"
    BREAK_BEGIN = 20, "a break of the study"
    BREAK_END = 21, "the participant or the experimenter ended the break"
    PAUSE_BEGIN = 30, "the experimenter paused the session"
    PAUSE_END = 31, "the experimenter continued the session"
    CONTACT = 101, "an object was touched"
    RELEASE = 102, "an object was released"
    PUNCTURE = 103, "a membrane ruptured"
    FAULT = 104, "the set of latched faults changed"

    meaning: str

    def __new__(cls, number: int, meaning: str) -> EventCode:
        """Make an event code from its number and its meaning."""
        made = int.__new__(cls, number)
        made._value_ = number
        made.meaning = meaning
        return made

    @property
    def text(self) -> str:
        """Text of the mark that carries the code, or name of the daemon's event."""
        return self.name.lower()


TRIAL_NUMBER_OFFSET: Final = 1000
"""In a stream of plain numbers, the code TRIAL_ARMED is followed by this number plus the index of the trial."""

_CODES_OF_MARKS: Final = {int(code): code for code in EventCode if code < 100}
_CODES_OF_EVENTS: Final = {code.text: code for code in EventCode if code > 100}


def code_of(event: Mapping[str, object]) -> EventCode | None:
    """Return the event code of an event of the daemon, or None.

    A mark has a code only if its text and the `code` in its data belong together.
    """
    if event.get("event") != "mark":
        return _CODES_OF_EVENTS.get(str(event.get("event")))
    data = event.get("data")
    number = data.get("code") if isinstance(data, Mapping) else None
    code = _CODES_OF_MARKS.get(number) if type(number) is int else None
    return code if code is not None and code.text == event.get("text") else None
