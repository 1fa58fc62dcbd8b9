"""Recordings that were killed: their partial files are found, reported, and made files of.

Nothing here is a condition of recording: `hapticd record` says what lies beside its target and goes on, and `hapticd
recover` makes files of it. What cannot be read stays as it is, and nobody is shown what is in it.
"""

from __future__ import annotations

import os
import shlex
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from hapticd.base.errors import HapticdError
from hapticd.base.partial_files import partial_files_of, resolved
from hapticd.base.yaml_source import one_line
from hapticd.recording.formats import writer_class
from hapticd.recording.writer import RecordingWriter

_MOST_TORN: Final = 1 << 22
"""Bytes at the end that a killed process may have written in part; more than that is damage, and is not cut off."""
_NAMED: Final = 3
"""Files of others that are named."""
_WRONG: Final = (ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError, struct.error)
"""What reading a damaged partial file raises."""
_DAMAGED_NOTES: Final = "is damaged in its notes, and left as it is"


@dataclass(frozen=True, slots=True)
class Recovered:
    """What became of what lay there."""

    files: list[Path] = field(default_factory=list)
    """Made of it."""
    problems: list[str] = field(default_factory=list)
    """What was not made a file of, and why, a line each."""


def partial_files_beside(target: str | os.PathLike[str]) -> Iterator[str]:
    """What to say before a recording into `target`, a line each."""
    name = os.fspath(target)
    partial = partial_files_of(resolved(target))
    if partial.stems:
        parts = _listed([f"{stem}.part" for stem in partial.stems])
        yield (
            f"{one_line(name)}: {parts} beside it is of another recording: under way, or killed; "
            f"`hapticd recover {shlex.quote(name)}` makes a file of what was killed"
        )
    if partial.others:
        yield _of_others(name, partial.others)


def _of_others(name: str, others: list[str]) -> str:
    return f"{one_line(name)}: {_listed(others)} beside it is no part of ours, and left as it is"


def _listed(names: list[str]) -> str:
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return ", ".join(map(one_line, names[:_NAMED])) + more


def recover(target: str | os.PathLike[str]) -> Recovered:
    """Makes files of what recordings into `target` left that were killed: NAME.recovered.ENDING beside it.

    Those of processes that still record are let alone, and so is what cannot be read. Raises HapticdError for a target
    of another ending.
    """
    open_with, name = writer_class(target), os.fspath(target)
    partial, recovered = partial_files_of(resolved(target)), Recovered()
    for stem in partial.stems:
        result = _recover(open_with, target, stem)
        if isinstance(result, Path):
            recovered.files.append(result)
        else:
            file = one_line(os.path.join(os.path.dirname(name), f"{stem}.part"))
            recovered.problems.append(f"{file}: {result}")
    if partial.others:
        recovered.problems.append(_of_others(name, partial.others))
    return recovered


def _recover(open_with: type[RecordingWriter], target: str | os.PathLike[str], stem: str) -> Path | str:
    """The file that was made, or why none was."""
    try:
        writer = open_with(target, resume=stem)
    except BlockingIOError:
        return "is still being recorded"
    except OSError as error:
        return f"cannot be taken up: {error.strerror}"
    except _WRONG:
        return _DAMAGED_NOTES
    with writer:
        if writer.torn_bytes > _MOST_TORN or (writer.torn_bytes and not writer.count):
            return f"is damaged in its last {writer.torn_bytes:,} bytes, and left as it is"
        if not writer.count:
            writer.discard()
            return "held no samples; removed"
        writer.target = writer.target.with_name(f"{writer.target.stem}.recovered{writer.target.suffix}")
        about = {"ticks": writer.count, "events": writer.event_count, "ended_because": "killed"}
        try:
            writer.finish({"recording": {**writer.about, **about}})
        except HapticdError as error:
            return f"cannot be finished, and is left as it is ({error})"
        except _WRONG:
            return _DAMAGED_NOTES
        writer.discard()
        return writer.target
