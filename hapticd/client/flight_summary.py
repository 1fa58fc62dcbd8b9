"""What a file of the flight recorder holds, in figures and in a line for people; copies it where that is asked for."""

from __future__ import annotations

import os

from hapticd.base import wording
from hapticd.base.errors import HapticdError
from hapticd.base.files import displaced
from hapticd.recording.missed_periods import missed_text
from hapticd.recording.recording import load


def summed_up(written: str, copy: str | None, overwrite: bool) -> tuple[dict[str, object], str]:
    """What is in the file, which is written to `copy`, too; as JSON, and as a line for people. Raises HapticdError."""
    recording = load(written)
    if copy is not None:
        place = recording.save(copy, overwrite)
        if place.name != os.path.basename(os.path.realpath(copy)):
            raise HapticdError(displaced(copy, place))
    file, ticks, missed = copy or written, len(recording.samples), recording.missed_periods
    found: dict[str, object] = {
        "file": file,
        "ticks": ticks,
        "duration_s": (ticks + missed) / recording.rate_hz,
        "missed_periods": missed,
        "events": len(recording.events),
    }
    line = f"{file}: {wording.count(ticks, 'tick')} in {found['duration_s']:.3f} s, {missed_text(missed, ticks)}, "
    return found, line + wording.count(len(recording.events), "event")
