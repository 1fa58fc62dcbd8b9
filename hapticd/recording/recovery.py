"""Recordings that were killed: their partial files are found, reported, and made files of.

Nothing here is a condition of recording: `hapticd record` says what lies beside its target and goes on, and `hapticd
recover` makes files of it. What cannot be read stays as it is.
"""

from __future__ import annotations

import glob
import os
import shlex
from pathlib import Path
from typing import Final, NamedTuple

from hapticd.base.errors import HapticdError
from hapticd.base.yaml_source import one_line
from hapticd.recording.reader import READING_ERRORS
from hapticd.recording.recording import recording_path
from hapticd.recording.writer import NOTES_ENDING, RecordingWriter

_DAMAGED: Final = "is damaged, and left as it is"


class Recovered(NamedTuple):
    """Of the partial files of killed recordings: the files that were made of them, and why of others none was, a line
    each."""

    files: list[Path]
    problems: list[str]


def _parts(recording: Path) -> list[Path]:
    """The partial files of recordings into this file."""
    place = Path(os.path.realpath(recording))
    return sorted(place.parent.glob(f".{glob.escape(place.name)}.*.part"))


def partial_files_beside(target: str | os.PathLike[str]) -> str | None:
    """What to say of them before a recording into `target`."""
    recording = recording_path(target)
    name, parts = os.fspath(recording), _parts(recording)
    if not parts:
        return None
    more = f" and {len(parts) - 1} more" if len(parts) > 1 else ""
    return (
        f"{one_line(name)}: {one_line(parts[0].name)}{more} beside it is of another recording: under way, or killed; "
        f"`hapticd recover {shlex.quote(name)}` makes a file of what was killed"
    )


def recover(target: str | os.PathLike[str]) -> Recovered:
    """Makes files of what recordings into `target` left that were killed: NAME.recovered.npz beside it.

    Those of processes that still record are let alone, and so is what cannot be read. Raises HapticdError for a target
    of another ending.
    """
    recording, recovered = recording_path(target), Recovered([], [])
    for part in _parts(recording):
        result = _recover(recording, part)
        if isinstance(result, Path):
            recovered.files.append(result)
        else:
            recovered.problems.append(f"{one_line(os.fspath(recording.with_name(part.name)))}: {result}")
    return recovered


def _recover(recording: Path, part: Path) -> Path | str:
    """The file that was made, or why none was."""
    if not part.with_suffix(NOTES_ENDING).exists():
        return _DAMAGED
    try:
        writer = RecordingWriter(recording, resume=part)
    except BlockingIOError:
        return "is still being recorded"
    except OSError as error:
        return f"cannot be taken up: {error.strerror}"
    except READING_ERRORS:
        return _DAMAGED
    with writer:
        if not writer.count:
            writer.discard()
            return "held no samples; removed"
        writer.target = writer.target.with_name(f"{writer.target.stem}.recovered.npz")
        about = {"ticks": writer.count, "events": writer.event_count, "ended_because": "killed"}
        try:
            writer.finish({"recording": {**writer.about, **about}})
        except HapticdError as error:
            return f"cannot be finished, and is left as it is ({error})"
        except READING_ERRORS:
            return _DAMAGED
        return writer.target
