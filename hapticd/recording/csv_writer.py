"""Recordings in .csv, written: samples, one row a tick, vectors in two columns (`position_m_x`, `position_m_y`).

Events stand in a second file, `NAME.events.csv`, and the texts in a third, `NAME.about.json`; arrays have no place.
"""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from hapticd.base.partial_files import PartialFile
from hapticd.recording.event_columns import cell_of
from hapticd.recording.writer import CHECK_EVERY, RecordingWriter, Samples

_AXES = ("x", "y")
_ROW: Final = re.compile(rb"[-+0-9.eE,naif]+\n")
"""What a row of numbers is made of."""


class CsvWriter(RecordingWriter):
    """The .csv format."""

    def _write(self, samples: Samples) -> None:
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        if self.count == 0:
            self._partial.cut(0)
            writer.writerow(_names(samples.dtype))
        columns: list[list[object]] = []
        for name in samples.dtype.names or ():
            values = samples[name].reshape(len(samples), -1)
            columns += [values[:, index].tolist() for index in range(values.shape[1])]
        writer.writerows(zip(*columns, strict=True))
        self._partial.append(text.getvalue().encode())
        self._checkpoint(self.count + len(samples), samples)

    @staticmethod
    def files_of(target: Path) -> list[Path]:
        return [target.with_name(f"{target.stem}.{ending}") for ending in ("events.csv", "about.json")] + [target]

    def _finish(self, texts: Mapping[str, object], arrays: Mapping[str, npt.NDArray[Any]]) -> None:
        events, about, samples = self.files_of(self.target)
        files: dict[Path, PartialFile] = {}
        try:
            files[events] = self._written("events", self._event_lines())
            found = self._with_changes(texts)
            if found:
                files[about] = self._written("about", [json.dumps(found, indent=1) + "\n"])
            self._publish({**files, samples: self._partial})
            if not found and self._overwrite:
                self._remove(about.name)  # of the recording that was replaced
        except OSError:
            for file in files.values():
                file.discard()
            raise

    def _written(self, kind: str, texts: Iterable[str]) -> PartialFile:
        file = self._open_partial(kind)
        try:
            for text in texts:
                file.append(text.encode())
        except OSError:
            file.discard()
            raise
        return file

    def _event_lines(self) -> Iterator[str]:
        # What every event has, so that a file without events has its line of names, too.
        always = ("event", "tick", "time_ns")
        names = list(dict.fromkeys((*always, *(name for event in self.read_events() for name in event))))
        lines = _Lines()
        writer = csv.DictWriter(lines, names, lineterminator="\r\n")
        writer.writeheader()
        for event in self.read_events():
            if lines.size >= CHECK_EVERY:
                yield lines.take()
            writer.writerow({name: cell_of(name, value) for name, value in event.items()})
        yield lines.take()

    def _count_written(self, dtype: np.dtype[np.void]) -> int:
        lines = self._partial.lines()
        head = next(lines, b"")
        names = head.decode().strip().split(",")
        tick, time = names.index("tick"), names.index("time_ns")
        size = len(head)
        for line in lines:
            cells = line.split(b",")
            if len(cells) != len(names) or not _ROW.fullmatch(line):
                break
            size += len(line)
            self.count += 1
            self.last_tick, self.last_time_ns = int(cells[tick]), int(cells[time])
        return size


class _Lines:
    """What a csv.writer whose rows end in CR LF has written, with LF alone: so it quotes a CR within a text."""

    def __init__(self) -> None:
        self._rows: list[str] = []
        self.size = 0

    def write(self, row: str) -> None:
        self._rows.append(row.removesuffix("\r\n") + "\n")
        self.size += len(row)

    def take(self) -> str:
        text = "".join(self._rows)
        self._rows, self.size = [], 0
        return text


def _names(dtype: np.dtype[Any]) -> list[str]:
    names = []
    for name in dtype.names or ():
        shape = dtype[name].shape
        names += [name] if not shape else [f"{name}_{axis}" for axis in _AXES[: shape[0]]]
    return names
