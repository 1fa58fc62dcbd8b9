"""What a file of the flight recorder holds, in figures and in a line for people; copies it where that is asked for."""

from __future__ import annotations

import os
import time

from hapticd.base import wording
from hapticd.base.errors import HapticdError
from hapticd.client.blocking import Client
from hapticd.recording.missed_periods import missed_text
from hapticd.recording.recording import load


def written_flight(client: Client) -> str:
    """Has the flight recorder write its file: its name on the daemon's machine, once it is whole.

    Raises HapticdError where it cannot be written.
    """
    file = client.dump_flight()["file"]
    # The file's name appears when it is whole; where it does not come, the status says why.
    while not os.path.exists(file):
        flight = client.get_status()["flight"]
        if flight is None or (flight["under_way"] == 0 and flight["problem"] is not None):
            problem = "its log says why" if flight is None else flight["problem"]
            raise HapticdError(f"the flight recorder did not write {file}: {problem}")
        if flight["under_way"] == 0:
            break  # by a daemon on another machine, where its sockets are forwarded to this one
        time.sleep(0.05)
    return file


def summed_up(written: str, copy: str | None, overwrite: bool) -> tuple[dict[str, object], str]:
    """What is in the file, which is written to `copy`, too; as JSON, and as a line for people. Raises HapticdError."""
    recording = load(written)
    if copy is not None:
        recording.save(copy, overwrite)
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
