"""What recordings left that were killed: finding it, saying it, and making files of it.

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
from hapticd.base.partial_files import left_of, resolved
from hapticd.base.yaml_source import one_line
from hapticd.recording.writer import form_of

_MOST_TORN: Final = 1 << 22
"""Bytes at the end that a killed process may have written in part; more than that is damage, and is not cut off."""
_NAMED: Final = 3
"""Files of others that are named."""
_WRONG: Final = (ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError, struct.error)
"""What reading a part raises that was damaged."""


@dataclass(frozen=True, slots=True)
class Recovered:
    """What became of what lay there."""

    files: list[Path] = field(default_factory=list)
    """Made of it."""
    told: list[str] = field(default_factory=list)
    """What was not made a file of, and why, a line each."""


def left_behind(target: str | os.PathLike[str]) -> Iterator[str]:
    """What to say before a recording into `target`, a line each."""
    name = os.fspath(target)
    left = left_of(resolved(target))
    if left.stems:
        parts = _listed([f"{stem}.part" for stem in left.stems])
        yield (
            f"{one_line(name)}: {parts} beside it is of another recording: under way, or killed; "
            f"`hapticd recover {shlex.quote(name)}` makes a file of what was killed"
        )
    if left.others:
        yield _of_others(name, left.others)


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
    form = form_of(target)
    name, place = os.fspath(target), resolved(target)
    left = left_of(place)
    found = Recovered()
    for stem in left.stems:
        part = one_line(os.path.join(os.path.dirname(name), f"{stem}.part"))
        try:
            sink = form(target, left=stem)
        except BlockingIOError:
            found.told.append(f"{part}: is still being recorded")
            continue
        except OSError as error:
            found.told.append(f"{part}: cannot be taken up: {error.strerror}")
            continue
        except _WRONG:
            found.told.append(f"{part}: is damaged in its notes, and left as it is")
            continue
        with sink:
            if sink.torn > _MOST_TORN or (sink.torn and not sink.count):
                found.told.append(f"{part}: is damaged in its last {sink.torn:,} bytes, and left as it is")
                continue
            if not sink.count:
                sink.discard()
                found.told.append(f"{part}: held no samples; removed")
                continue
            sink.target = place.with_name(f"{place.stem}.recovered{place.suffix}")
            about = {"ticks": sink.count, "events": sink.event_count, "ended_because": "killed"}
            try:
                sink.finish({"recording": {**sink.about, **about}})
            except HapticdError as error:
                found.told.append(f"{part}: cannot be finished, and is left as it is ({error})")
                continue
            except _WRONG:
                found.told.append(f"{part}: is damaged in its notes, and left as it is")
                continue
            sink.discard()
            found.files.append(sink.target)
    if left.others:
        found.told.append(_of_others(name, left.others))
    return found
