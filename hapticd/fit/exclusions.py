"""What of a set of recordings is left out of a fit, and why: the rest is fitted where it is enough."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Final, TypeVar

from hapticd.analysis.statistics import FitError, MistakenError
from hapticd.base.yaml_source import Json
from hapticd.fit.recording import Recording
from hapticd.fit.verdict import Doubts

_T = TypeVar("_T")
RECORDING: Final = "recording"
PART: Final = "part"
TOLD: Final = 3
"""So many reasons are in a refusal."""


@dataclass(frozen=True, slots=True)
class Left:
    """A recording, a part of one, or one event of it, that was not used."""

    recording: str
    reason: str
    what: str = RECORDING
    """RECORDING for all of it, PART for some of it, or the event: `tap`."""
    time_s: float | None = None
    """Of the event, from the first sample."""

    def __str__(self) -> str:
        if self.what == RECORDING:
            return f"{self.recording}: left out: {self.reason}"
        if self.time_s is None:
            return f"{self.recording}: a {self.what} is left out: {self.reason}"
        return f"{self.recording}: the {self.what} at {self.time_s:.4g} s is left out: {self.reason}"

    def to_dict(self) -> dict[str, Json]:
        return {"recording": self.recording, "reason": self.reason, "what": self.what, "time_s": self.time_s}


class Strict(FitError):
    """Something would be left out, and nothing may be."""


class LeftOut:
    """Collects what is left out. With `strict` the first one raises Strict instead."""

    def __init__(self, strict: bool = False) -> None:
        self.items: list[Left] = []
        self.unused: set[str] = set()
        """Names of recordings all of whose events were left out."""
        self._strict = strict

    def add(self, recording: str, reason: str, what: str = RECORDING, time_s: float | None = None) -> None:
        left = Left(recording, reason.removeprefix(f"{recording}: "), what, time_s)
        if self._strict:
            raise Strict(f"{left}; --strict refuses that")
        self.items.append(left)

    def apart(self) -> LeftOut:
        """For a fit that may not be taken: what was left out before it, and never strict."""
        other = LeftOut()
        other.items, other.unused = list(self.items), set(self.unused)
        return other

    def take(self, other: LeftOut) -> None:
        """What the fit left out that is taken, after `apart`."""
        for left in other.items[len(self.items) :]:
            self.add(left.recording, left.reason, left.what, left.time_s)
        self.unused |= other.unused

    def each(self, recordings: Iterable[Recording], fitted: Callable[[Recording], _T]) -> list[_T]:
        """What `fitted` makes of every recording; one that it refuses is left out with its reason.

        MistakenError goes on: whoever mistakes the unit of one recording mistakes that of all.
        """
        found = []
        for recording in recordings:
            try:
                found.append(fitted(recording))
            except (Strict, MistakenError):
                raise
            except FitError as error:
                self.add(recording.name, str(error))
        return found

    @property
    def recordings(self) -> set[str]:
        """Names of those of which nothing was used."""
        return self.unused | {left.recording for left in self.items if left.what == RECORDING}

    def refused(self, few: str) -> FitError:
        """That too little is left: `few` says what, and reasons follow; of a single recording its own alone."""
        whole = [left for left in self.items if left.what == RECORDING]
        if len(self.items) == len(whole) == 1:
            return FitError(f"{whole[0].recording}: {whole[0].reason}")
        return FitError(f"{few}{self.told()}")

    def told(self) -> str:
        """The first reasons in brackets; empty where nothing is left out."""
        if not self.items:
            return ""
        more = f"; and {len(self.items) - TOLD} more" if len(self.items) > TOLD else ""
        return f" ({'; '.join(map(str, self.items[:TOLD]))}{more})"

    def lines(self) -> list[str]:
        """One for each."""
        return [str(left) for left in self.items]


def weigh(left: LeftOut, recordings: Sequence[Recording], doubts: Doubts) -> None:
    """Tells what is left out, before everything else, and doubts where that is a large part of the recordings."""
    doubts.told[:0] = left.lines()
    gone, every = left.recordings, {recording.name for recording in recordings} | left.recordings
    count = max(len(every), len(recordings))
    doubts.at_most("part left out", len(gone) / count, f"{len(gone)} of {count} recordings are left out")


def most_are_left_out(left: LeftOut, used: int, what: str) -> str:
    """Where more of the events were left out than were used, what to tell of it; otherwise empty."""
    events = sum(each.what == what for each in left.items)
    return f"{events} of {events + used} {what}s are left out" if events > used else ""
