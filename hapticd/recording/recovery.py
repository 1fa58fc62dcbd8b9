"""Recovery of recordings whose process was killed, from their partial files.

`hapticd record` warns of partial files next to its target; `hapticd record --recover` makes recordings of them.
"""

from __future__ import annotations

import glob
import os
import shlex
from pathlib import Path
from typing import Final, NamedTuple

from hapticd.base.errors import HapticdError
from hapticd.base.yaml_source import printable
from hapticd.recording.reader import READING_ERRORS
from hapticd.recording.recording import recording_path
from hapticd.recording.writer import NOTES_ENDING, RecordingWriter

_DAMAGED_TEXT: Final = "damaged; left unchanged"
"""Why a damaged partial file was not recovered, in the output of `hapticd record --recover`."""


class Recovered(NamedTuple):
    """Paths of recovered recordings, and a line of text for each partial file that could not be recovered."""

    files: list[Path]
    problems: list[str]


def _partial_files(recording: Path) -> list[Path]:
    """Return the partial files of recordings to this path, sorted."""
    path = Path(os.path.realpath(recording))
    return sorted(path.parent.glob(f".{glob.escape(path.name)}.*.part"))


def partial_files_warning(target: str | os.PathLike[str]) -> str | None:
    """Return a warning about partial files of other recordings to `target`; None without such files."""
    recording = recording_path(target)
    name, parts = os.fspath(recording), _partial_files(recording)
    if not parts:
        return None
    more = f" and {len(parts) - 1} more" if len(parts) > 1 else ""
    return (
        f"{printable(name)}: {printable(parts[0].name)}{more} in its folder: another recording is running, or was "
        f"killed; `hapticd record --recover {shlex.quote(name)}` recovers killed ones"
    )


def recover(target: str | os.PathLike[str]) -> Recovered:
    """Make a recording NAME.recovered.npz of each partial file that a killed process left for `target`.

    Partial files of running processes, and unreadable ones, stay unchanged. Raises HapticdError for an unknown ending.
    """
    recording, recovered = recording_path(target), Recovered([], [])
    for part in _partial_files(recording):
        result = _recover(recording, part)
        if isinstance(result, Path):
            recovered.files.append(result)
        else:
            recovered.problems.append(f"{printable(os.fspath(recording.with_name(part.name)))}: {result}")
    return recovered


def _recover(recording: Path, part: Path) -> Path | str:
    """Make a recording of a partial file. Return the path of the recording, or the reason of the failure."""
    if not part.with_suffix(NOTES_ENDING).exists():
        return _DAMAGED_TEXT
    try:
        writer = RecordingWriter(recording, resume=part)
    except BlockingIOError:
        return "its recording is still running"
    except OSError as error:
        return f"cannot be read: {error.strerror}"
    except READING_ERRORS:
        return _DAMAGED_TEXT
    with writer:
        if not writer.count:
            writer.discard()
            return "held no samples; removed"
        writer.target = writer.target.with_name(f"{writer.target.stem}.recovered.npz")
        about = {"ticks": writer.count, "events": writer.event_count, "ended_because": "killed"}
        try:
            writer.finish({"recording": {**writer.about, **about}})
        except HapticdError as error:
            return f"cannot be finished, left unchanged ({error})"
        except READING_ERRORS:
            return _DAMAGED_TEXT
        return writer.target
