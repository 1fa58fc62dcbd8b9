"""Recordings in .csv, read: the samples block by block, and what stands in the two files beside them."""

from __future__ import annotations

import csv
import io
import re
import warnings
from collections.abc import Iterable, Iterator
from itertools import chain
from pathlib import Path
from typing import IO, Any, Final

import numpy as np

from hapticd.base.core import SAMPLE_DTYPE
from hapticd.base.garbage_collector import uncollected
from hapticd.recording.event_cells import FromCells
from hapticd.recording.reading_limits import BadRecordingError, Memory, Recorded, Rows, Samples, regular, samples_of

_BLOCK: Final = 1 << 18
_EVENT_BLOCK: Final = 1 << 16
_LONGEST_LINE: Final = 1 << 16
"""Bytes; a row of ours has at most 450, the line of names 300."""
_LONGEST_EVENT: Final = 1 << 20
"""Bytes of a line of the events; the longest mark has 37 kB."""
_MOST_COLUMNS: Final = 1000
_PLACE: Final = re.compile(r"at row (\d+)(?:, column (\d+))?")


def files_beside(path: Path) -> tuple[Path, Path]:
    """The events, and the texts."""
    return path.with_name(f"{path.stem}.events.csv"), path.with_name(f"{path.stem}.about.json")


def load_csv(path: Path, file: IO[bytes], memory: Memory) -> Recorded:
    """Raises HapticdError, OSError, and what reading text raises."""
    events_path, about_path = files_beside(path)
    with regular(about_path) as (about, size):
        memory.check(2 * size, about_path.name)
        texts = memory.json(about.read(size), about_path.name)
    if not isinstance(texts, dict):
        raise BadRecordingError(f"{about_path.name}: is no map")
    samples = _samples(file, memory)
    with uncollected():
        events = list(_events(events_path, memory))
    return Recorded(samples, texts, events)


def _samples(file: IO[bytes], memory: Memory) -> Samples:
    names = _decoded(file.readline(_LONGEST_LINE), 1).strip().split(",")
    if len(names) > _MOST_COLUMNS:
        raise BadRecordingError(f"has {len(names)} columns")
    forms: dict[str, np.dtype[Any]] = {}
    for name in SAMPLE_DTYPE.names or ():
        base, shape = SAMPLE_DTYPE[name].base, SAMPLE_DTYPE[name].shape
        forms |= {f"{name}_{axis}": base for axis in "xy"} if shape else {name: base}
    missing = [name for name in forms if name not in names]
    if missing:
        raise BadRecordingError(f"its line of names lacks {missing[0]}")
    first = {name: names.index(name) for name in forms}
    # Columns that we do not know are counted, and else left out.
    cells = [(f"c{at}", forms[name] if first.get(name) == at else np.dtype("S1")) for at, name in enumerate(names)]
    dtype = np.dtype(cells)

    rows = Rows(memory)
    for line, text in _blocks(file):
        found = _parsed(text, line, dtype)

        def column(name: str, found: Samples = found) -> Any:
            if SAMPLE_DTYPE[name].shape:
                return np.stack([found[f"c{first[f'{name}_{axis}']}"] for axis in "xy"], axis=1)
            return found[f"c{first[name]}"]

        rows.append(samples_of(len(found), column))
    return rows.whole()


def _blocks(file: IO[bytes]) -> Iterator[tuple[int, list[str]]]:
    """Lines, some at a time, and the number of the first; empty ones among them."""
    line, rest = 2, b""
    while data := file.read(_BLOCK):
        whole, _, rest = (rest + data).rpartition(b"\n")
        if whole:
            lines = _decoded(whole, line).split("\n")
            yield line, lines
            line += len(lines)
        if len(rest) > _LONGEST_LINE:
            raise BadRecordingError(f"line {line} is too long")
    if rest.strip():
        yield line, [_decoded(rest, line)]


def _decoded(data: bytes, line: int) -> str:
    try:
        return data.decode("ascii")
    except UnicodeDecodeError as error:
        at = line + data.count(b"\n", 0, error.start)
        raise BadRecordingError(f"line {at} has something else than numbers") from None


def _parsed(lines: list[str], line: int, dtype: np.dtype[Any]) -> Samples:
    """Records of the lines that are not empty."""
    places = [at for at, text in enumerate(lines) if text.strip()]
    if not places:
        return np.empty(0, dtype)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # a whole number that is written as another one
            return np.loadtxt([lines[at] for at in places], dtype, delimiter=",", comments=None, ndmin=1)
    except (ValueError, OverflowError, Warning) as error:
        match = _PLACE.search(str(error))
        # What numpy says shows the cell; of a wrong number of columns it counts rows from 1.
        counted = int(match[1]) - (0 if match[2] else 1) if match else 0
        where = line + places[min(max(counted, 0), len(places) - 1)]
        if match and match[2]:
            raise BadRecordingError(f"line {where}: column {match[2]} is no number of its kind") from None
        raise BadRecordingError(f"line {where}: has another number of columns than the line of names") from None


def _events(path: Path, memory: Memory) -> Iterator[dict[str, Any]]:
    with regular(path) as (file, _):
        lines = _Lines(file, path.name)
        rows = csv.reader(lines)
        names = next(rows, [])
        if len(names) > _MOST_COLUMNS or "event" not in names:
            raise BadRecordingError(f"{path.name}: has no line of the names of events")
        cells = FromCells(names)
        while True:
            begin, stretch = rows.line_num, _stretch(rows, lines)
            if not stretch:
                return
            try:
                if any(len(row) != len(names) for row in stretch):
                    raise ValueError
                events, taken = cells.events(stretch)
            except (ValueError, RecursionError):
                raise _wrong_row(path.name, stretch, begin, names) from None
            memory.take(taken, "its events")
            yield from events


def _stretch(rows: Iterator[list[str]], lines: _Lines) -> list[list[str]]:
    """The rows up to where a new block begins, and the row there."""
    stretch, block = [], lines.blocks
    for row in rows:
        stretch.append(row)
        if lines.blocks != block:
            break
    return stretch


def _wrong_row(name: str, stretch: list[list[str]], line: int, names: list[str]) -> BadRecordingError:
    """Says which of the rows that follow `line` is none."""
    cells = FromCells(names)
    for row in stretch:
        line += 1 + sum(cell.count("\n") for cell in row)
        if len(row) != len(names):
            return BadRecordingError(f"{name}: line {line} has {len(row)} columns, not {len(names)}")
        try:
            cells.events([row])
        except (ValueError, RecursionError):
            break
    return BadRecordingError(f"{name}: line {line} is no event")


class _Lines:
    """Lines of a file of text, read in blocks."""

    def __init__(self, file: IO[bytes], name: str) -> None:
        self.blocks = 0
        """How many were begun."""
        self._lines = chain.from_iterable(self._read(file, name))

    def __iter__(self) -> Iterator[str]:
        return self._lines

    def _read(self, file: IO[bytes], name: str) -> Iterator[Iterable[str]]:
        rest = b""
        while data := file.read(_EVENT_BLOCK):
            whole, found, rest = (rest + data).rpartition(b"\n")
            self.blocks += 1
            if found:
                yield io.StringIO(_unicode(whole, name) + "\n", newline="\n")
            if len(rest) >= _LONGEST_EVENT:
                raise BadRecordingError(f"{name}: a line is too long")
        if rest:
            yield (_unicode(rest, name),)


def _unicode(data: bytes, name: str) -> str:
    try:
        return data.decode()
    except UnicodeDecodeError:
        raise BadRecordingError(f"{name}: is no Unicode") from None
