"""A recording that a thread makes while a block of code runs: `with daemon.record("trial.npz"): ...`."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING

from hapticd.base import arguments, wording
from hapticd.base.errors import HapticdError
from hapticd.client.base import in_background
from hapticd.client.record import Daemon, RecordSummary, ended_early, record
from hapticd.protocol.calls import MissedPeriods, TelemetryLoss

if TYPE_CHECKING:
    from hapticd.base.yaml_source import Json
    from hapticd.recording.recording import Recording


class Recorder:
    """One recording: under way in the block, finished after it."""

    def __init__(
        self,
        connect: Callable[[], AbstractContextManager[Daemon]],
        path: str | os.PathLike[str],
        overwrite: bool,
        notes: Mapping[str, object],
    ) -> None:
        """`connect` makes a client for the thread alone. Raises InvalidError for notes that JSON cannot hold."""
        self.path = arguments.path("path", path)
        self._connect = connect
        self._overwrite = arguments.flag("overwrite", overwrite)
        self._notes: dict[str, Json] = arguments.plain(("notes",), notes)
        self._stop = threading.Event()
        self._begun = threading.Event()
        """The first sample was taken, or nothing will come of it."""
        self._done: Future[RecordSummary] | None = None

    @property
    def result(self) -> RecordSummary:
        """What was recorded. Raises HapticdError while the block still runs, and where nothing was."""
        if self._done is None or not self._done.done():
            raise HapticdError(f"{self.path}: is not finished: the result is there after the block")
        return self._done.result()

    def load(self) -> Recording:
        """The recording, once the block is over."""
        from hapticd.recording.recording import load

        return load(self.result.file)

    def begin(self) -> None:
        """Returns once the first sample was taken. Raises what keeps the recording from beginning."""
        self._done = in_background("hapticd-record", self._record)
        self._done.add_done_callback(lambda _: self._begun.set())
        self._begun.wait()
        if self._done.done():
            self._done.result()

    def end(self) -> list[Warning]:
        """Records what the daemon has rendered by now, and finishes the file; returns what is to be warned of. Raises
        HapticdError where the recording ended before, or the file is not where it was to be."""
        self._stop.set()
        if self._done is None:
            raise HapticdError(f"{self.path}: was not recorded")
        result = self._done.result()
        if ended_early(result.ended_because) is not None:
            raise HapticdError(f"{result.ended_because}; {result.file} holds what came before")
        found: list[Warning] = []
        if result.lost:
            lost = wording.count(result.lost, "sample")
            found.append(TelemetryLoss(f"{result.file}: {lost} were lost on the way here"))
        if result.warning is not None:
            found.append(MissedPeriods(f"{result.file}: {result.warning}"))
        return found

    def _record(self) -> RecordSummary:
        with self._connect() as client:
            overwrite, notes, stop = self._overwrite, self._notes, self._stop
            return record(client, self.path, overwrite=overwrite, notes=notes, stop=stop, progress=self._progress)

    def _progress(self, recorded_s: float) -> None:
        if recorded_s > 0:
            self._begun.set()
