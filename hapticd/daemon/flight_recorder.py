"""The flight recorder: keeps the last seconds of samples and events, and writes them on a fault or on request.

The telemetry thread passes all samples and events to the recorder. Samples are kept in a circular array of fixed size
(1.1 MB a second at 10 kHz). flight_scene.py keeps their scene, so that a file suffices to render them again. A separate
thread writes a copy of the array, so that no other thread waits for the disk. The file of a fault is written
FAULT_AFTERMATH_S after the fault, so that it shows the consequences.
"""

from __future__ import annotations

import logging
import os
import queue
import re
import threading
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from hapticd.base import clock
from hapticd.base.clock import Moment
from hapticd.base.core import SAMPLE_DTYPE
from hapticd.base.errors import HapticdError
from hapticd.daemon.flight_scene import FlightScene, History
from hapticd.protocol.changes import Change
from hapticd.recording.missed_periods import MAX_LISTED_GAPS, gaps_of, missed_periods, rates_of
from hapticd.system.repeated_lines import MIN_REPEAT_INTERVAL_S, Repeats

FAULT_AFTERMATH_S: Final = 1.0
"""Time after a fault that the file of the fault includes."""
MAX_KEPT_EVENTS: Final = 5000
"""Largest number of events that are kept; the oldest are dropped."""
CHUNK_SAMPLES: Final = 3200
"""Number of samples that are written in one call: 360 kB."""
_OPAQUE_SAMPLE_DTYPE: Final = np.dtype((np.void, SAMPLE_DTYPE.itemsize))
"""A sample as opaque bytes, which numpy copies faster than the members of a record one by one."""
CLOCK_READ_INTERVAL_NS: Final = 1_000_000_000
"""Interval in which monotonic and wall-clock time are read, for the start time of a file."""

_FILE_NAME_PATTERN: Final = re.compile(r"flight-(\d{6,})-[a-z]+\.npz")
_log = logging.getLogger("hapticd")


@dataclass(frozen=True, slots=True)
class _PendingFile:
    """A requested file of the flight recorder, which is written once the time is `due_ns`."""

    path: Path
    reason: str
    tick: int | None
    """Tick of the fault; None: a client requested the file."""
    due_ns: int


@dataclass(frozen=True, slots=True)
class _Job:
    """A file of the flight recorder and its content, for the thread that writes it."""

    file: _PendingFile
    samples: npt.NDArray[np.void]
    events: list[dict[str, object]]
    history: History
    started: Moment | None
    ended: Moment


class Flight:
    """The flight recorder.

    `keep_...`, `hand_over_due` and `finish` are for the telemetry thread, `run` is for the writer thread, and all
    others are for any thread.
    """

    def __init__(
        self,
        directory: Path,
        seconds: float,
        keep: int,
        rate_hz: float,
        now_ns: Callable[[], int],
        scene: FlightScene,
        texts: Callable[[], Mapping[str, object]] = dict,
    ) -> None:
        """Keep samples of the last `seconds` in memory, and the newest `keep` files in `directory`.

        `texts` returns the configuration and the status, which a file contains as well.
        """
        self._scene = scene
        self._moments: deque[Moment] = deque([clock.read()])
        self._directory, self._seconds, self._keep = directory, seconds, keep
        self._now_ns, self._texts = now_ns, texts
        self._samples = np.zeros(round((seconds + FAULT_AFTERMATH_S) * rate_hz), _OPAQUE_SAMPLE_DTYPE)
        self._count = 0
        """Number of samples received. Modulo the length of `_samples` it is the index of the next one."""
        self._events: deque[dict[str, object]] = deque(maxlen=MAX_KEPT_EVENTS)
        self._lock = threading.Lock()
        self._pending: list[_PendingFile] = []
        self._dumping = False
        """Whether a file that a client requested is being written. The next one waits, which limits the memory."""
        self._number = max((int(match[1]) for _, match in self._files()), default=0)
        self._quiet_until_ns = 0
        self._repeats = Repeats()
        self._jobs: queue.SimpleQueue[_Job | None] = queue.SimpleQueue()
        self.version = 0
        """A number that grows when the result of `status` changes."""
        self._under_way = 0
        self._written = 0
        self._skipped = 0
        self._last: Path | None = None
        self._problem: str | None = None

    # ---- The telemetry thread --------------------------------------------------------------------------------------

    def keep_samples(self, samples: npt.NDArray[np.void]) -> None:
        """Copy a batch of samples, of SAMPLE_DTYPE and shape (n,), into the circular array."""
        capacity = len(self._samples)
        batch = samples[-capacity:].view(_OPAQUE_SAMPLE_DTYPE)
        place = self._count % capacity
        until_end = capacity - place
        self._samples[place : place + len(batch)] = batch[:until_end]
        self._samples[: len(batch[until_end:])] = batch[until_end:]
        self._count += len(batch)
        oldest = self._samples.view(SAMPLE_DTYPE)[self._count % capacity if self._count > capacity else 0]
        while self._events and int(str(self._events[0]["tick"])) < oldest["tick"]:
            self._events.popleft()
        self._scene.forget(int(oldest["tick"]), int(oldest["revision"]))
        while len(self._moments) > 1 and self._moments[1].monotonic_ns <= oldest["time_ns"]:
            self._moments.popleft()

    def keep_change(self, change: Change) -> None:
        """Keep a change of the scene, a play or a reset that a command made."""
        self._scene.take(change)

    def keep_event(self, event: dict[str, object]) -> None:
        """Keep an event in the form that subscribers get. A fault requests a file."""
        self._events.append(event)
        if event["event"] == "fault" and event["faults"]:
            self._fault(int(str(event["tick"])))

    def _fault(self, tick: int) -> None:
        now_ns = self._now_ns()
        with self._lock:
            if now_ns < self._quiet_until_ns:
                self._skipped += 1
                self.version += 1
                return
            self._quiet_until_ns = now_ns + round((self._seconds + FAULT_AFTERMATH_S) * 1e9)
            self._request("fault", tick, now_ns + round(FAULT_AFTERMATH_S * 1e9))

    def hand_over_due(self, kept_ns: int) -> None:
        """Pass the requested files that are due to the writer thread. All telemetry before `kept_ns` was kept."""
        if kept_ns - self._moments[-1].monotonic_ns >= CLOCK_READ_INTERVAL_NS:
            self._moments.append(clock.read())
        if not self._pending:
            return
        with self._lock:
            held = self._dumping
            # A change may come slightly later than the samples that were rendered with it.
            ready_ns = kept_ns if self._knows_newest() else kept_ns - round(FAULT_AFTERMATH_S * 1e9)
            due = [file for file in self._pending if ready_ns >= file.due_ns and not (held and file.reason == "asked")]
            self._pending = [file for file in self._pending if file not in due]
            self._dumping = held or any(file.reason == "asked" for file in due)
        self._hand_over(due)

    def _knows_newest(self) -> bool:
        if self._count == 0:
            return True
        newest = self._samples.view(SAMPLE_DTYPE)[(self._count - 1) % len(self._samples)]
        return self._scene.knows(int(newest["revision"]))

    def finish(self) -> None:
        """Pass all requested files to the writer thread, after the last samples were kept."""
        with self._lock:
            due, self._pending = self._pending, []
        self._hand_over(due)

    def _hand_over(self, due: list[_PendingFile]) -> None:
        for file in due:
            place = self._count % len(self._samples) if self._count > len(self._samples) else 0
            kept = self._samples[: self._count]
            samples = np.concatenate((kept[place:], kept[:place])).view(SAMPLE_DTYPE)
            started = self._moments[0] if len(samples) else None
            self._jobs.put(_Job(file, samples, list(self._events), self._scene.history(), started, clock.read()))

    # ---- Any thread ------------------------------------------------------------------------------------------------

    def dump(self) -> Path:
        """Request a file of the kept samples and events, and return its path.

        The file exists once it is complete. Until its writing begins, further requests return the same path.
        """
        with self._lock:
            waiting = next((file.path for file in self._pending if file.reason == "asked"), None)
            return waiting or self._request("asked", None, self._now_ns())

    def _request(self, reason: str, tick: int | None, due_ns: int) -> Path:
        path = None
        while path is None or os.path.lexists(path):  # another daemon may use the same directory
            self._number += 1
            path = self._directory / f"flight-{self._number:06d}-{reason}.npz"
        self._pending.append(_PendingFile(path, reason, tick, due_ns))
        self._under_way += 1
        self.version += 1
        return path

    def status(self) -> dict[str, object]:
        """Return the member `flight` of a status."""
        with self._lock:
            return {
                "directory": str(self._directory),
                "seconds": self._seconds,
                "under_way": self._under_way,
                "written": self._written,
                "skipped": self._skipped,
                "last": None if self._last is None else str(self._last),
                "problem": self._problem,
            }

    # ---- The writer ------------------------------------------------------------------------------------------------

    def run(self, stop: threading.Event) -> None:
        """Write requested files until `wake` is called, and those that were passed before the call."""
        while True:
            try:
                job = self._jobs.get(timeout=MIN_REPEAT_INTERVAL_S)
            except queue.Empty:
                self._repeats.flush()
                continue
            if job is None:
                break
            self._carry_out(job)
            del job  # frees the copy of the samples: the next job may come hours later
            self._repeats.flush()
        self._repeats.finish()

    def _carry_out(self, job: _Job) -> None:
        try:
            self._write(job)
            problem = None
        except (HapticdError, OSError) as error:
            problem = str(error)
        with self._lock:
            self._under_way -= 1
            if job.file.reason == "asked":
                self._dumping = False
            self._problem = problem
            self.version += 1
            if problem is None:
                self._written += 1
                self._last = job.file.path
        # Clients may request dozens of files a second.
        path, level = job.file.path, logging.INFO if problem is None else logging.ERROR
        self._repeats.line(
            f"{job.file.reason} {level}", level, f"flight recorder: {problem or path}", MIN_REPEAT_INTERVAL_S
        )

    def wake(self) -> None:
        """End `run`, the writer thread, once it has written the files that were passed before."""
        self._jobs.put(None)

    def _write(self, job: _Job) -> None:
        from hapticd.recording.writer import RecordingWriter

        if not self._directory.is_dir():
            os.makedirs(self._directory)
            os.chmod(self._directory, 0o750)
        history, about = job.history, {"reason": job.file.reason, "tick": job.file.tick}
        changes = history.change_maps()
        with RecordingWriter(job.file.path) as writer:
            writer.begin({**self._texts(), **history.texts()})
            for change in changes:
                writer.write_change(change)
            # In large chunks: after each write the thread may have to wait for the interpreter, and so may others.
            for first in range(0, len(job.samples), CHUNK_SAMPLES):
                writer.write(job.samples[first : first + CHUNK_SAMPLES])
            for event in job.events:
                writer.write_event(event)
            recording = _account(job, changes)
            writer.finish({"recording": recording, "flight": {**about, "complete_from": history.complete_from}})
        numbered = sorted((int(match[1]), path) for path, match in self._files())
        for _, path in numbered[: -self._keep]:
            path.unlink(missing_ok=True)

    def _files(self) -> list[tuple[Path, re.Match[str]]]:
        if not self._directory.is_dir():
            return []
        matches = ((path, _FILE_NAME_PATTERN.fullmatch(path.name)) for path in self._directory.iterdir())
        return [(path, match) for path, match in matches if match is not None and path.is_file()]


def _account(job: _Job, changes: list[dict[str, object]]) -> dict[str, object]:
    """Return the member `recording` of a file of the flight recorder: counts, times and gaps, as in recordings."""
    samples, history = job.samples, job.history
    ticks, times = samples["tick"].astype(np.int64), samples["time_ns"]
    rates = rates_of(samples, changes, history.rate_hz)
    gaps = gaps_of(ticks)
    return {
        "ticks": len(samples),
        "duration_s": float(times[-1] - times[0]) / 1e9 + 1.0 / rates[-1] if len(samples) else 0.0,
        "events": len(job.events),
        "lost": 0,
        "dropped": sum(length for _, length in gaps),
        "gaps": gaps[:MAX_LISTED_GAPS],
        "missed_periods": missed_periods(samples, rates),
        "missing_revisions": history.missing(set(np.unique(samples["revision"]).tolist())),
        "started": None if job.started is None else asdict(job.started),
        "ended": asdict(job.ended),
        "ended_because": None,
        "notes": {},
    }


def directory_of(configured: str | None, runtime: Path, environ: Mapping[str, str] | None = None) -> Path:
    """Return the directory for flight files: the configured, else systemd's state, else the runtime directory."""
    environ = os.environ if environ is None else environ
    state = environ.get("STATE_DIRECTORY", "").split(":")[0]
    return Path(configured or state or runtime).absolute()
