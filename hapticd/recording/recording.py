"""A recording as its reader sees it, `hapticd.load`, and where one goes that is written: into a .npz. A target of
another form is exported at the end, from the .npz beside it.

recording = hapticd.load("tap.npz")          # of `hapticd record`, `simulate` or the flight recorder
recording.samples["force_n"]                 # (n, 2), numpy
recording.marks[0]["text"]
recording.to_pandas()
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from hapticd.base import arguments
from hapticd.base.clock import Moment, moment_of
from hapticd.base.errors import HapticdError
from hapticd.base.files import check_new, displaced
from hapticd.recording.export import export, files_of, frame_of
from hapticd.recording.missed_periods import missed_periods, rates_of
from hapticd.recording.reader import read
from hapticd.recording.writer import RecordingWriter, Samples

if TYPE_CHECKING:
    from pandas import DataFrame

    from hapticd.base.yaml_source import Json


@dataclass(frozen=True, eq=False)
class Recording:
    """What a file of `hapticd record`, `hapticd simulate` or the flight recorder holds."""

    path: str
    samples: Samples
    """(n,) records of `hapticd.SAMPLE_DTYPE`, one a tick."""
    events: list[dict[str, Any]] = field(repr=False)
    """As in telemetry, whatever the form of the file."""
    texts: Mapping[str, Any] = field(repr=False)
    """What stands beside them, by name, as the file has it."""
    truth: npt.NDArray[np.float64] | None = field(default=None, repr=False)
    """(n, 4), of a simulation in a .npz: the handle's own x, y in m, and its velocity along x, y in m/s."""

    def __repr__(self) -> str:
        return f"<hapticd.Recording {self.path}: {len(self.samples):,} ticks, {len(self.events):,} events>"

    @property
    def marks(self) -> list[dict[str, Any]]:
        """The events `mark`, in their order: `tick`, `time_ns`, `text` and `data` of each."""
        return [event for event in self.events if event.get("event") == "mark"]

    @property
    def scene(self) -> dict[str, Any]:
        """The scene at the start; empty where the file does not have it."""
        return self._map("scene")

    @property
    def materials(self) -> dict[str, Any]:
        """All materials at the start, by name."""
        return self._map("materials")

    @property
    def config(self) -> dict[str, Any]:
        """`servo` and `device` of the configuration."""
        return self._map("config")

    @property
    def status(self) -> dict[str, Any]:
        """The result of get_status at the start (of a flight recorder's file, when it was written); empty where no
        daemon was recorded."""
        return self._map("status")

    @property
    def changes(self) -> list[dict[str, Any]]:
        """What commands changed on the way; the first entry has the revision at the start."""
        changes = self.texts.get("changes")
        return [change for change in changes if isinstance(change, dict)] if isinstance(changes, list) else []

    @property
    def notes(self) -> dict[str, Json]:
        """What `--note` said, as texts, or `daemon.record(path, trial=3)`, with its types."""
        notes = self._about.get("notes")
        return dict(notes) if isinstance(notes, dict) else {}

    @property
    def started(self) -> Moment | None:
        """The daemon's clocks when the recording began; None of a simulation, or where nobody asked."""
        return moment_of(self._about.get("started"))

    @property
    def ended(self) -> Moment | None:
        """The daemon's clocks when it ended."""
        return moment_of(self._about.get("ended"))

    @property
    def ended_because(self) -> str | None:
        """Why it ended early; None where it did not."""
        reason = self._about.get("ended_because", self._about.get("ended"))
        return reason if isinstance(reason, str) else None

    @property
    def rate_hz(self) -> float:
        """Ticks a second at the start."""
        servo = self.config.get("servo")
        configured = servo.get("rate_hz") if isinstance(servo, dict) else None
        first = self.changes[0].get("rate_hz") if self.changes else None
        found = first or self.status.get("rate_hz") or configured
        if isinstance(found, bool) or not isinstance(found, int | float) or not found > 0:
            raise HapticdError(f"{self.path}: does not say at which rate it was recorded")
        return float(found)

    @cached_property
    def missed_periods(self) -> int:
        """Periods in which the servo rendered no tick though one was due, between the first sample and the last."""
        counted = self._about.get("missed_periods")
        if type(counted) is int:
            return counted
        return missed_periods(self.samples, rates_of(self.samples, self.changes, self.rate_hz))

    def utc(self) -> npt.NDArray[np.datetime64]:
        """(n,): the time of day of each sample, UTC, by the clocks at the start. Raises HapticdError where the file
        does not have them."""
        moment = self.started or self.ended
        if moment is None:
            raise HapticdError(f"{self.path}: does not say the time of day")
        times = self.samples["time_ns"].astype(np.int64) + (moment.realtime_ns - moment.monotonic_ns)
        return times.view("M8[ns]")

    def to_pandas(self) -> DataFrame:
        """The samples as a DataFrame: one row a tick, a column for each field, of a vector two (`force_n_x`,
        `force_n_y`). The index, `time_s`, is the time since the first sample in s.

        `frame.set_index(recording.utc())` has the time of day instead. Raises HapticdError where pandas is missing.
        """
        return frame_of(self.samples)

    def save(self, path: str | os.PathLike[str], overwrite: bool = False) -> Path:
        """Writes it into another file: a .npz, or an export for other programs, .csv or .mcap, by its ending; `truth`
        is in .npz alone. Returns `path`. Raises HapticdError."""
        target = Path(path)
        check_saved(target, overwrite)
        if target.suffix.lower() != ".npz":
            export(self.samples, self.events, self.texts, target, overwrite)
            return target
        with RecordingWriter(target, overwrite) as writer:
            last = {name: self.texts[name] for name in ("recording", "flight") if name in self.texts}
            first = {name: text for name, text in self.texts.items() if name != "changes" and name not in last}
            writer.write_all(first, self.changes, self.samples, self.events)
            writer.finish(last, {} if self.truth is None else {"truth": self.truth})
        if writer.displaced:
            raise HapticdError(displaced(path, writer.target))
        return target

    @property
    def _about(self) -> dict[str, Any]:
        return self._map("recording")

    def _map(self, name: str) -> dict[str, Any]:
        found = self.texts.get(name)
        return found if isinstance(found, dict) else {}


def check_saved(target: str | os.PathLike[str], overwrite: bool) -> None:
    """Raises HapticdError for a target of another ending, and where one of its files is no regular file, or, without
    `overwrite`, is there already."""
    path = Path(target)
    for file in (path,) if path.suffix.lower() == ".npz" else reversed(files_of(path)):
        check_new(file, overwrite)


def load(path: str | os.PathLike[str]) -> Recording:
    """Reads a recording: the .npz of `hapticd record`, `hapticd simulate` or `hapticd flight`.

    Its samples are mapped into memory: they take none until they are used, and the file may be larger than the memory.
    Raises HapticdError (one line) where the file is none.
    """
    return Recording(os.fspath(arguments.path("path", path)), *read(path))


# ---- Where one goes --------------------------------------------------------------------------------------------------


def recording_path(target: str | os.PathLike[str]) -> Path:
    """The .npz of a recording into `target`. Raises HapticdError for an ending of another form."""
    path = Path(target)
    if path.suffix.lower() == ".npz":
        return path
    files_of(path)
    return path.with_suffix(".npz")


def check_target(target: str | os.PathLike[str], overwrite: bool) -> None:
    """As `check_saved`, also for the .npz of an export. Raises HapticdError."""
    check_saved(target, overwrite)
    check_new(recording_path(target), overwrite)


@contextmanager
def recording_into(target: str | os.PathLike[str], overwrite: bool = False) -> Iterator[RecordingWriter]:
    """The writer of a recording, which is to be finished in the block.

    Raises HapticdError: as `check_target` does before anything is written, and at the end where another file had
    appeared at the target, which says where the recording is.
    """
    check_target(target, overwrite)
    recording = recording_path(target)
    with RecordingWriter(recording, overwrite) as writer:
        yield writer
    if writer.displaced:
        raise HapticdError(displaced(recording, writer.target))
    if recording != Path(target):
        try:
            load(recording).save(target, overwrite)
        except (HapticdError, MemoryError) as error:
            why = error if isinstance(error, HapticdError) else f"{target}: takes more memory than there is"
            raise HapticdError(f"{why}; the recording is in {recording}") from None
