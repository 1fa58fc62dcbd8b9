"""The public class Recording, `hapticd.load`, and the files of a new recording.

A recording is always written to a .npz. For a target of another format, this file is exported at the end.

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
    """Content of a recording written by `hapticd record`, `hapticd simulate` or the flight recorder."""

    path: str
    samples: Samples
    """Records of `hapticd.SAMPLE_DTYPE`, one per tick, shape (n,)."""
    events: list[dict[str, Any]] = field(repr=False)
    """Events with the same members as in telemetry."""
    texts: Mapping[str, Any] = field(repr=False)
    """Other content of the file, by name (scene, materials, config, changes, status, recording, flight)."""
    truth: npt.NDArray[np.float64] | None = field(default=None, repr=False)
    """Exact x and y of the simulated handle in m, and its velocities in m/s, shape (n, 4); None if not simulated."""

    def __repr__(self) -> str:
        return f"<hapticd.Recording {self.path}: {len(self.samples):,} ticks, {len(self.events):,} events>"

    @property
    def marks(self) -> list[dict[str, Any]]:
        """The events of the kind `mark`, in order, with `tick`, `time_ns`, `text` and `data`."""
        return [event for event in self.events if event.get("event") == "mark"]

    @property
    def scene(self) -> dict[str, Any]:
        """The scene at the start; empty if the file lacks it."""
        return self._map("scene")

    @property
    def materials(self) -> dict[str, Any]:
        """All materials at the start, by name."""
        return self._map("materials")

    @property
    def config(self) -> dict[str, Any]:
        """The configuration's keys `servo` and `device`, with their values."""
        return self._map("config")

    @property
    def status(self) -> dict[str, Any]:
        """The daemon's status at the start, or when the flight recorder wrote the file; empty without a daemon."""
        return self._map("status")

    @property
    def changes(self) -> list[dict[str, Any]]:
        """Changes and actions of commands, in order. The first entry has the scene's revision at the start."""
        changes = self.texts.get("changes")
        return [change for change in changes if isinstance(change, dict)] if isinstance(changes, list) else []

    @property
    def notes(self) -> dict[str, Json]:
        """Notes of the user, from `--note` as texts, from `daemon.record(path, trial=3)` with their types."""
        notes = self._about.get("notes")
        return dict(notes) if isinstance(notes, dict) else {}

    @property
    def started(self) -> Moment | None:
        """Times of the daemon's clocks when the recording began; None for a simulation, or if they were not read."""
        return moment_of(self._about.get("started"))

    @property
    def ended(self) -> Moment | None:
        """Times of the daemon's clocks when the recording ended; None if they were not read."""
        return moment_of(self._about.get("ended"))

    @property
    def ended_because(self) -> str | None:
        """Why the recording ended early, such as "stopped" or "killed"; None if it was completed."""
        reason = self._about.get("ended_because", self._about.get("ended"))
        return reason if isinstance(reason, str) else None

    @property
    def rate_hz(self) -> float:
        """Servo rate at the start. Raises HapticdError if the file lacks it."""
        servo = self.config.get("servo")
        configured = servo.get("rate_hz") if isinstance(servo, dict) else None
        first = self.changes[0].get("rate_hz") if self.changes else None
        found = first or self.status.get("rate_hz") or configured
        if isinstance(found, bool) or not isinstance(found, int | float) or not found > 0:
            raise HapticdError(f"{self.path}: holds no servo rate")
        return float(found)

    @cached_property
    def missed_periods(self) -> int:
        """Number of servo periods without a tick, between the first sample and the last."""
        counted = self._about.get("missed_periods")
        if type(counted) is int:
            return counted
        return missed_periods(self.samples, rates_of(self.samples, self.changes, self.rate_hz))

    def utc(self) -> npt.NDArray[np.datetime64]:
        """Return the UTC date and time of each sample, shape (n,), computed from the daemon's clocks.

        Uses the clocks at the start, else those at the end. Raises HapticdError if the file lacks both.
        """
        if self._utc_offset_ns is None:
            raise HapticdError(f"{self.path}: holds no time of day")
        times: npt.NDArray[np.int64] = self.samples["time_ns"].astype(np.int64) + self._utc_offset_ns
        return times.view("M8[ns]")

    def to_pandas(self) -> DataFrame:
        """Return the samples as a DataFrame with one row per tick.

        Each field is a column, a vector two (`force_n_x`, `force_n_y`). The index, `time_s`, is the time since the
        first sample in s; `frame.set_index(recording.utc())` replaces it by the time of day. Raises HapticdError if
        pandas is not installed.
        """
        return frame_of(self.samples)

    def save(self, path: str | os.PathLike[str], overwrite: bool = False) -> Path:
        """Write the recording to a file: a .npz, or an export (.csv or .mcap), which does not hold `truth`.

        Returns `path`. Raises HapticdError if the file cannot be written, or exists and `overwrite` is False.
        """
        target = Path(path)
        check_saved(target, overwrite)
        if target.suffix.lower() != ".npz":
            export(self.samples, self.events, self.texts, self._utc_offset_ns or 0, target, overwrite)
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
    def _utc_offset_ns(self) -> int | None:
        """UTC in ns since 1970, minus the clock of the samples; None if the file lacks the time of day."""
        moment = self.started or self.ended
        return None if moment is None else moment.realtime_ns - moment.monotonic_ns

    @property
    def _about(self) -> dict[str, Any]:
        return self._map("recording")

    def _map(self, name: str) -> dict[str, Any]:
        found = self.texts.get(name)
        return found if isinstance(found, dict) else {}


def check_saved(target: str | os.PathLike[str], overwrite: bool) -> None:
    """Raise HapticdError if a recording cannot be saved as `target`.

    Reasons: an unknown ending, an existing file without `overwrite`, a target that is not a regular file.
    """
    path = Path(target)
    for file in (path,) if path.suffix.lower() == ".npz" else reversed(files_of(path)):
        check_new(file, overwrite)


def load(path: str | os.PathLike[str]) -> Recording:
    """Read a recording: the .npz of `hapticd record` or `hapticd simulate`, or a flight file.

    Its samples are mapped into memory, so that the file may be larger than the memory. Raises HapticdError if the file
    is not a recording.
    """
    return Recording(os.fspath(arguments.path("path", path)), *read(path))


# ---- Files of a new recording ----------------------------------------------------------------------------------------


def recording_path(target: str | os.PathLike[str]) -> Path:
    """Return the path of the .npz that recording to `target` writes. Raises HapticdError for an unknown ending."""
    path = Path(target)
    if path.suffix.lower() == ".npz":
        return path
    files_of(path)
    return path.with_suffix(".npz")


def check_target(target: str | os.PathLike[str], overwrite: bool) -> None:
    """Raise HapticdError if a new recording cannot be written to `target` or, for an export, to its .npz."""
    check_saved(target, overwrite)
    check_new(recording_path(target), overwrite)


@contextmanager
def recording_into(target: str | os.PathLike[str], overwrite: bool = False) -> Iterator[RecordingWriter]:
    """Open the writer of a recording, whose `finish` must be called in the `with` block.

    Raises HapticdError before anything is written, as `check_target` does. At the end of the block, raises HapticdError
    if another program has created the target meanwhile, or if the export failed. This error names the file that holds
    the recording.
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
            why = error if isinstance(error, HapticdError) else f"{target}: not enough memory"
            raise HapticdError(f"{why}; the recording is in {recording}") from None
