"""Writing a flight file, summarizing it as JSON and as a line of text, and copying it."""

from __future__ import annotations

import os
import time

from hapticd.base import wording
from hapticd.base.errors import HapticdError
from hapticd.client.blocking import Client
from hapticd.recording.missed_periods import missed_text
from hapticd.recording.recording import load


def written_flight(client: Client) -> str:
    """Have the flight recorder write a file, wait until it is complete, and return its path on the daemon's machine.

    Raises HapticdError if the file cannot be written.
    """
    file = client.dump_flight()["file"]
    # The file appears when it is complete. If it does not appear, the status has the reason.
    while not os.path.exists(file):
        flight = client.get_status()["flight"]
        if flight is None or (flight["under_way"] == 0 and flight["problem"] is not None):
            problem = "the log of the daemon has the reason" if flight is None else flight["problem"]
            raise HapticdError(f"the flight recorder did not write {file}: {problem}")
        if flight["under_way"] == 0:
            break  # written on another machine, from which the sockets are forwarded
        time.sleep(0.05)
    return file


def copy_flight(written: str, file: str, overwrite: bool) -> tuple[dict[str, object], str]:
    """Copy a flight file to `file`, and return a summary of the recording, as JSON and as a line of text.

    Raises HapticdError if a file cannot be read or written, or if the flight file is on another machine.
    """
    if not os.path.exists(written):
        raise HapticdError(f"{written} is on the daemon's machine: copy it from there")
    recording = load(written)
    recording.save(file, overwrite)
    ticks, missed = len(recording.samples), recording.missed_periods
    summary: dict[str, object] = {
        "file": file,
        "ticks": ticks,
        "duration_s": (ticks + missed) / recording.rate_hz,
        "missed_periods": missed,
        "events": len(recording.events),
    }
    line = f"{file}: {wording.count(ticks, 'tick')} in {summary['duration_s']:.3f} s, {missed_text(missed, ticks)}, "
    return summary, line + wording.count(len(recording.events), "event")
