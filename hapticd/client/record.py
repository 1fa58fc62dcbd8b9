"""Recordings of a running daemon: telemetry, configuration, scene and materials.

A recording lasts for a duration, until it is stopped, or while a block of code runs. recording/writer.py writes the
files, recording/replay.py renders them again.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, Final, Protocol, cast

import numpy as np
import numpy.typing as npt

from hapticd.base import arguments, wording
from hapticd.base.clock import Moment, moment_of
from hapticd.base.errors import HapticdError
from hapticd.base.merge_patch import replace_members
from hapticd.base.threads import in_background
from hapticd.client.samples import SampleBatch, SampleStream
from hapticd.protocol.calls import DaemonNotRunning, MissedPeriods, TelemetryLoss, Topic
from hapticd.protocol.places import has_ended, no_telemetry
from hapticd.protocol.results import ConfigResult, MaterialsResult, SceneResult, Status
from hapticd.recording.missed_periods import MAX_LISTED_GAPS, gaps_of, missed_periods, missed_text, share
from hapticd.recording.recording import Recording, load, recording_into, recording_path
from hapticd.recording.writer import DiskFullError, RecordingWriter, Samples
from hapticd.system.paths import RuntimePaths

if TYPE_CHECKING:
    from hapticd.base.yaml_source import Json

FINAL_CHANGE_TIMEOUT_S: Final = 1.0
"""Longest wait at the end of a recording for its last tick, and for the change of the scene before that tick."""

STOPPED_REASON: Final = "stopped"
"""`ended_because` of a recording that was stopped, as in the file."""

DAEMON_STOPPED_REASON: Final = "the daemon stopped"
"""`ended_because` of a recording whose daemon ended or was killed."""

END_SILENCE_S: Final = 0.2
"""Time without messages after which a daemon with a closed socket counts as stopped."""

_MAX_SCENE_READS: Final = 10
"""Number of attempts to read a consistent scene and materials while other clients change the materials."""


def ended_early(because: str | None) -> str | None:
    """Return `because`, the reason why a recording ended, or None if the recording was stopped or complete."""
    return None if because == STOPPED_REASON else because


@dataclass(frozen=True, slots=True)
class RecordSummary:
    """The contents of a recording, and what is missing in it."""

    file: str
    """Path of the recording."""
    ticks: int
    duration_s: float
    events: int
    lost: int
    """Number of samples lost between daemon and recording."""
    dropped: int
    """Number of samples dropped by the daemon because its ring was full."""
    missing_revisions: tuple[int, ...]
    """Revisions of the scene that samples were rendered with and that are not in the recording."""
    missed_periods: int
    """Number of periods in which the servo rendered no tick."""
    started: Moment | None
    """Clocks of the daemon at the start; None if the daemon does not report them."""
    ended: Moment | None
    """Clocks of the daemon at the end; None if the daemon does not report them."""
    ended_because: str | None
    """Why the recording ended: STOPPED_REASON, DAEMON_STOPPED_REASON or another; None if its duration was over."""
    warning: str | None
    """Warning if the fraction of missed periods exceeds `servo.overruns.threshold`, otherwise None."""

    def summary(self) -> str:
        """Return the summary as a line of text."""
        missing = self.lost + self.dropped
        lost = "nothing lost"
        if missing:
            where = f"{self.lost:,} between daemon and recording, {self.dropped:,} in the ring of the daemon"
            lost = f"{wording.count(missing, 'tick')} lost ({where})"
        text = f"{self.file}: {wording.count(self.ticks, 'tick')} in {self.duration_s:.3f} s, "
        text += (
            f"{missed_text(self.missed_periods, self.ticks + missing)}, {lost}, {wording.count(self.events, 'event')}"
        )
        if self.missing_revisions:
            text += f"; {wording.count(len(self.missing_revisions), 'revision')} of the scene missing"
        return text


class Messages(Protocol):
    """A subscription to telemetry."""

    def receive(self, timeout_s: float) -> tuple[Topic, dict[str, object]] | None:
        """Return topic and content of the next message, or None if none arrives within `timeout_s`."""


class Daemon(Protocol):
    """The methods of a client that a recording uses. The client itself imports this module."""

    paths: RuntimePaths
    timeout_s: float

    def get_status(self, detail: bool = False) -> Status:
        """Return the status of the daemon."""

    def get_config(self) -> ConfigResult:
        """Return the keys `servo` and `device` of the configuration."""

    def get_scene(self) -> SceneResult:
        """Return the scene, and its revision: the number of the last change of scene or materials."""

    def get_materials(self) -> MaterialsResult:
        """Return all materials by name."""

    def telemetry(self, *topics: Topic) -> AbstractContextManager[Messages]:
        """Subscribe to topics of telemetry."""


def record(
    client: Daemon,
    target: str | os.PathLike[str],
    duration_s: float | None = None,
    *,
    overwrite: bool = False,
    notes: Mapping[str, Json] | None = None,
    stop: threading.Event | None = None,
    progress: Callable[[float], None] = lambda recorded_s: None,
    opened: Callable[[RecordingWriter], None] = lambda writer: None,
) -> RecordSummary:
    """Record every tick and every event to `target`, for `duration_s` of the daemon's time or until `stop` is set.

    A stopped recording has all ticks that the daemon had rendered when `stop` was set. If the daemon ends or the disk
    is full, the recording is completed with the data that it received. `notes` are stored in it. `progress` is called
    with the recorded time in s, which is 0 before the first sample. `opened` is called with the writer before anything
    is recorded, so that another thread can read how much is written. Raises HapticdError before anything is recorded if
    the target cannot be written, or exists and `overwrite` is false.
    """
    with recording_into(target, overwrite) as writer:
        opened(writer)
        session = _Session(client, writer, duration_s, dict(notes or {}))
        try:
            ended = session.run(stop or threading.Event(), progress)
            if ended is None:
                session.ask_status()
        except DiskFullError as error:
            ended = str(error)
            session.ask_status()
        if writer.count == 0:
            raise HapticdError(f"{target}: nothing was recorded{f' ({ended})' if ended else ''}")
        # The function is called again if the last samples were removed to make room on a full disk.
        writer.finish(lambda: {"recording": session.account(ended)})
        account = session.account(ended)
        clocks = {name: moment_of(account[name]) for name in ("started", "ended")}
        summed = {each.name: account[each.name] for each in fields(RecordSummary) if each.name in account}
        return RecordSummary(
            **summed | clocks, file=os.fspath(recording_path(target)), warning=session.warning(account)
        )


class _Session:
    """A running recording."""

    def __init__(
        self, client: Daemon, writer: RecordingWriter, duration_s: float | None, notes: dict[str, Json]
    ) -> None:
        self._client = client
        self._notes = notes
        self._writer = writer
        self._scenes = _Scenes(client, writer)
        self._stream = SampleStream(warn=False)
        self._interval = _Interval(duration_s)
        self._gaps: list[tuple[int, int]] = []
        self._status: Mapping[str, Any] = {}
        """Status at the start."""
        self._newest: Mapping[str, Any] = {}
        self._rates: list[tuple[int, float]] = []
        """Pairs of a tick and the servo rate from it on, in Hz."""
        self._missed: list[tuple[int, int]] = []
        """Pairs of the last tick of a batch and the number of missed periods in it, if any."""

    def run(self, stop: threading.Event, progress: Callable[[float], None]) -> str | None:
        """Record until the end, and return why the recording ended, or None if its duration is over."""
        client, interval = self._client, self._interval
        # A missing daemon is noticed at once by a call; waiting for telemetry takes longer.
        client.get_status()
        with client.telemetry("samples", "event", "change", "status") as messages:
            self._begin()
            silent_since, ended = time.monotonic(), 0
            while not interval.over:
                if stop.is_set() and not interval.stopped:
                    # Everything that happened before the stop is recorded.
                    interval.end_at(self.ask_status())
                    continue
                received = messages.receive(0.1)
                if received is None:
                    silent_s = time.monotonic() - silent_since
                    if silent_s > client.timeout_s:
                        return str(no_telemetry(client.paths, client.timeout_s))
                    # Twice in a row, so that messages sent before the socket was closed have arrived.
                    ended = ended + 1 if silent_s > END_SILENCE_S and has_ended(client.paths) else 0
                    if ended > 1:
                        return DAEMON_STOPPED_REASON
                    continue
                silent_since, ended = time.monotonic(), 0
                topic, message = received
                if topic == "samples":
                    batch = self._stream.convert(topic, message)
                    if self._stream.restarts or (batch.lost and self._restarted()):
                        return "the daemon was restarted"
                    self._take(batch)
                    progress(interval.recorded_s)
                elif topic == "event":
                    if message["event"] == "rate":
                        self._rates.append((int(str(message["tick"])), float(str(message["rate_hz"]))))
                    interval.queue(message)
                elif topic == "change":
                    self._scenes.apply(message)
                else:
                    self._newest = message
            self._await_changes(messages)
        return STOPPED_REASON if interval.stopped else None

    def ask_status(self) -> int | None:
        """Store the status at the end of the recording, and return the servo's tick; None if there is no reply."""
        with suppress(HapticdError):
            self._newest = self._client.get_status()
            return cast("int | None", self._newest.get("tick"))
        return None

    def _begin(self) -> None:
        start = self._scenes.begin()
        self._status = self._newest = start["status"]
        self._rates = [(0, self._status["rate_hz"])]
        about = {"started": self._status.get("clock"), "notes": self._notes}
        self._writer.begin({"config": self._client.get_config()["config"], **start}, about)
        self._writer.write_change({"revision": self._scenes.revision})

    def _await_changes(self, messages: Messages) -> None:
        """Wait for the changes that the last samples were rendered with, which may arrive after them."""
        deadline = time.monotonic() + FINAL_CHANGE_TIMEOUT_S
        while self._scenes.missing and (left_s := deadline - time.monotonic()) > 0:
            received = messages.receive(left_s)
            if received is not None and received[0] == "change":
                self._scenes.apply(received[1])

    def _restarted(self) -> bool:
        """Return whether the daemon was restarted; false without a reply: missing messages end the recording then."""
        with suppress(DaemonNotRunning):
            return bool(self._client.get_status()["started_ns"] != self._status["started_ns"])
        return False

    def _take(self, batch: SampleBatch) -> None:
        if self._writer.count == 0:
            batch = batch[self._scenes.reached(batch["revision"])]
        samples = self._interval.clip(batch).view(np.ndarray)
        if len(samples) == 0:
            return
        ticks = samples["tick"].astype(np.int64)
        before = (self._writer.last_tick, self._writer.last_time_ns) if self._writer.count else None
        self._gaps += gaps_of(ticks, before and before[0])[: MAX_LISTED_GAPS - len(self._gaps)]
        since, rates = zip(*self._rates, strict=True)
        places = np.searchsorted(np.array(since), ticks, side="right") - 1
        missed = missed_periods(samples, np.array(rates)[places], before)
        if missed:
            self._missed.append((int(ticks[-1]), missed))
        self._scenes.note_used(samples["revision"])
        self._writer.write(samples)
        for event in self._interval.due_events():
            self._writer.write_event(event)

    def account(self, ended: str | None) -> dict[str, Any]:
        """Return the member `recording` of the file: counts of recorded and missing data, and the user's notes."""
        return {
            "ticks": self._writer.count,
            "duration_s": self._interval.duration_s(self._writer.last_time_ns),
            "events": self._writer.event_count,
            "lost": self._stream.lost,
            "dropped": self._stream.dropped,
            "gaps": self._gaps,
            "missed_periods": sum(missed for at, missed in self._missed if at <= self._writer.last_tick),
            "missing_revisions": self._scenes.missing,
            "started": self._status.get("clock"),
            "ended": self._newest.get("clock"),
            "ended_because": ended,
            "notes": self._notes,
        }

    def warning(self, account: Mapping[str, Any]) -> str | None:
        """Return the warning if more periods were missed than `servo.overruns.threshold`, otherwise None."""
        threshold = self._status.get("overruns", {}).get("threshold")
        missed, rendered = account["missed_periods"], account["ticks"] + account["lost"] + account["dropped"]
        if threshold is None or share(missed, rendered) <= threshold:
            return None
        fraction = wording.percent(share(missed, rendered))
        return (
            f"{missed:,} of {missed + rendered:,} periods were missed ({fraction}), more than "
            f"servo.overruns.threshold ({wording.percent(threshold)}); `hapticd doctor` says what the machine lacks"
        )


class _Scenes:
    """Scene and materials of the daemon: read at the start, then updated by each change.

    If a change was lost or too large to be sent, scene and materials are read again. The recording lacks the revisions
    in between, and lists them as missing.
    """

    def __init__(self, client: Daemon, writer: RecordingWriter) -> None:
        self._client = client
        self._writer = writer
        self.revision = 0
        """Newest known revision."""
        self._known: set[int] = set()
        self._used: set[int] = set()
        self._scene: dict[str, Any] = {}
        self._objects: dict[str, Any] = {}
        self._materials: dict[str, Any] = {}
        self._rate_hz = 0.0

    @property
    def missing(self) -> tuple[int, ...]:
        """Numbers of the changes with which samples were rendered, but whose scene or materials were not received."""
        return tuple(sorted(self._used - self._known))

    def begin(self) -> dict[str, Any]:
        """Read and return status, scene and materials at the start of the recording. Raises HapticdError."""
        read = self._read()
        if read is None:
            raise HapticdError("the recording cannot begin: other clients change the materials too fast")
        self.revision, self._scene, self._objects, self._materials, status = read
        self._rate_hz = status["rate_hz"]
        self._known.add(self.revision)
        scene = {**self._scene, "objects": dict(self._objects)}
        return {"status": status, "scene": scene, "materials": dict(self._materials)}

    def reached(self, revisions: npt.NDArray[np.uint32]) -> npt.NDArray[np.bool_]:
        """Return for each revision (number of a change of the scene) whether it is the newest known one or later."""
        return (revisions - np.uint32(self.revision)).astype(np.int32) >= 0

    def note_used(self, revisions: npt.NDArray[np.uint32]) -> None:
        """Note the revisions (numbers of changes of the scene) that samples were rendered with."""
        self._used.update(np.unique(revisions).tolist())

    def apply(self, change: dict[str, Any]) -> None:
        """Apply a message of the topic `change` to scene and materials, and write the message to the recording."""
        if "revision" not in change:
            self._writer.write_change(change)
            return
        ahead = (change["revision"] - self.revision) & 0xFFFFFFFF
        if ahead == 1 and not change.get("large"):
            replace_members(self._scene, change.get("scene", {}))
            replace_members(self._objects, change.get("objects", {}))
            replace_members(self._materials, change.get("materials", {}))
            self._rate_hz = change.get("rate_hz", self._rate_hz)
            self._write(change)
        elif 0 < ahead < 0x80000000:
            self._read_again()

    def _read_again(self) -> None:
        # Revisions that cannot be read are reported as missing; the end of a daemon is noticed by silence.
        with suppress(HapticdError):
            read = self._read()
            if read is not None and read[0] not in self._known:
                revision, scene, objects, materials, status = read
                rate_hz = status["rate_hz"]
                changed: dict[str, object] = {} if rate_hz == self._rate_hz else {"rate_hz": rate_hz}
                changed |= {
                    "scene": _changes(self._scene, scene),
                    "objects": _changes(self._objects, objects),
                    "materials": _changes(self._materials, materials),
                }
                self._scene, self._objects, self._materials, self._rate_hz = scene, objects, materials, rate_hz
                self._write({"revision": revision, **changed})

    def _write(self, change: dict[str, Any]) -> None:
        self.revision = change["revision"]
        self._known.add(self.revision)
        self._writer.write_change({name: part for name, part in change.items() if part != {}})

    def _read(self) -> tuple[int, dict[str, Any], dict[str, Any], dict[str, Any], dict[str, Any]] | None:
        """Return revision, scene, objects, materials and status; None if materials or rate changed at every attempt."""
        materials, status = self._materials_and_status()
        for _ in range(_MAX_SCENE_READS):
            scene, after = self._client.get_scene(), self._materials_and_status()
            # If they are the same before and after the scene was read, they belong to the scene.
            if after[0] == materials and after[1]["rate_hz"] == status["rate_hz"]:
                rest = dict(scene["scene"])
                return scene["revision"], rest, cast("dict[str, Any]", rest.pop("objects")), materials, status
            materials, status = after
        return None

    def _materials_and_status(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return the materials, and the status with the rate of the servo."""
        return dict(self._client.get_materials()["materials"]), dict(self._client.get_status(detail=True))


def _changes(before: Mapping[str, object], after: Mapping[str, object]) -> dict[str, object]:
    """Return the members in which two mappings differ, by key: their new values, None for removed ones."""
    changed = {name: value for name, value in after.items() if name not in before or before[name] != value}
    return changed | dict.fromkeys(name for name in before if name not in after)


class _Interval:
    """The recorded interval of the daemon's time, from the first received sample on.

    Events are sent before the samples of their ticks. So all events of an interval arrive before its last samples.
    """

    def __init__(self, duration_s: float | None) -> None:
        self._duration_ns = None if duration_s is None else round(duration_s * 1e9)
        self._first_tick: int | None = None
        self._first_ns = 0
        self._end_tick = 0
        self._last_ns = 0
        self._period_ns = 0
        self._queued: list[dict[str, Any]] = []
        self._last_tick = 0
        self._give_up_at = 0.0
        self.stopped = False
        """Whether the recording was stopped."""
        self._complete: bool = False

    @property
    def over(self) -> bool:
        """Whether the recorded interval is complete."""
        if not self.stopped:
            return self._complete
        return self._complete or self._end_tick > self._last_tick or time.monotonic() > self._give_up_at

    def end_at(self, tick: int | None) -> None:
        """End the recorded interval after this tick, or at the time-out if the tick does not come; None: end it now."""
        self.stopped, self._complete = True, self._complete or tick is None
        self._last_tick = tick or 0
        self._give_up_at = time.monotonic() + FINAL_CHANGE_TIMEOUT_S

    @property
    def recorded_s(self) -> float:
        """Recorded time, in s."""
        if self._first_tick is None:
            return 0.0
        return self.duration_s(self._last_ns)

    def duration_s(self, last_ns: int) -> float:
        """Return the time from the first sample to one period after the sample at `last_ns`, in s."""
        return (last_ns + self._period_ns - self._first_ns) / 1e9

    def clip(self, batch: SampleBatch) -> Samples:
        """Return the samples of a batch that are in the recorded interval."""
        if len(batch) == 0:
            return batch
        times = batch["time_ns"]
        self._give_up_at = time.monotonic() + FINAL_CHANGE_TIMEOUT_S  # prolonged while samples arrive
        if self._first_tick is None:
            self._first_tick = int(batch["tick"][0])
            self._first_ns = int(times[0])
        if len(batch) > 1:
            self._period_ns = int(np.min(np.diff(times)))
        clipped: Samples = batch
        if self._duration_ns is not None:
            # Deadlines are rounded to nanoseconds, so half a period of tolerance decides which tick is outside.
            inside = times - self._first_ns + self._period_ns // 2 < self._duration_ns
            clipped = batch[inside]
            self._complete = len(clipped) < len(batch)
        if len(clipped):
            self._end_tick = int(clipped["tick"][-1]) + 1
            self._last_ns = int(clipped["time_ns"][-1])
        return clipped

    def queue(self, event: dict[str, Any]) -> None:
        """Store an event until the sample of its tick is recorded."""
        self._queued.append(event)

    def due_events(self) -> list[dict[str, Any]]:
        """Return and remove the queued events of the recorded ticks."""
        if self._first_tick is None:
            return []
        ticks = [(int(event.get("tick", 0)), event) for event in self._queued]
        self._queued = [event for tick, event in ticks if tick >= self._end_tick]
        return [event for tick, event in ticks if self._first_tick <= tick < self._end_tick]


# ---- While a block of code runs --------------------------------------------------------------------------------------


class Recorder:
    """A recording that runs during a `with` block and is complete after it."""

    def __init__(
        self,
        connect: Callable[[], AbstractContextManager[Daemon]],
        path: str | os.PathLike[str],
        overwrite: bool,
        notes: Mapping[str, object],
    ) -> None:
        """Prepare a recording; `connect` returns a client for its thread. Raises InvalidError if notes are not JSON."""
        self.path = arguments.path("path", path)
        self._connect = connect
        self._overwrite = arguments.flag("overwrite", overwrite)
        self._notes: dict[str, Json] = arguments.plain(("notes",), notes)
        self._stop = threading.Event()
        self._begun = threading.Event()
        """Set when the first sample is recorded, or the recording has failed."""
        self._done: Future[RecordSummary] | None = None

    @property
    def result(self) -> RecordSummary:
        """Summary of the recording. Raises HapticdError if the `with` block has not ended, or nothing was recorded."""
        if self._done is None or not self._done.done():
            raise HapticdError(f"{self.path}: not complete: the result is available after the block")
        return self._done.result()

    def load(self) -> Recording:
        """Load and return the recording. Raises HapticdError if the `with` block of the recording has not ended."""
        return load(self.result.file)

    def begin(self) -> None:
        """Start the recording, and wait for its first sample. If the recording cannot start, raises the cause."""
        self._done = in_background("hapticd-record", self._record)
        self._done.add_done_callback(lambda _: self._begun.set())
        self._begun.wait()
        if self._done.done():
            self._done.result()

    def end(self) -> list[Warning]:
        """Record all ticks rendered until now, complete the file, and return the warnings.

        Raises HapticdError if the recording ended early, or the file could not be written.
        """
        self._stop.set()
        if self._done is None:
            raise HapticdError(f"{self.path}: the recording has not begun")
        result = self._done.result()
        if ended_early(result.ended_because) is not None:
            raise HapticdError(f"{result.ended_because}; {result.file} has everything before that")
        warnings: list[Warning] = []
        if result.lost:
            lost = wording.count(result.lost, "sample")
            warnings.append(TelemetryLoss(f"{result.file}: {lost} were lost between daemon and recording"))
        if result.warning is not None:
            warnings.append(MissedPeriods(f"{result.file}: {result.warning}"))
        return warnings

    def _record(self) -> RecordSummary:
        with self._connect() as client:
            overwrite, notes, stop = self._overwrite, self._notes, self._stop
            return record(client, self.path, overwrite=overwrite, notes=notes, stop=stop, progress=self._progress)

    def _progress(self, recorded_s: float) -> None:
        if recorded_s > 0:
            self._begun.set()
