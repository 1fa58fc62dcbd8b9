"""Recordings of a running daemon: its telemetry, and what the samples were rendered with, into a file; for a time, or
by a thread while a block of code runs.

recording/writer.py writes the files, recording/replay.py renders what is in them again.
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

LAST_CHANGE_S: Final = 1.0
"""How long without news, at the end, what was before it is waited for: the last tick, and the change that it was
rendered with."""

STOPPED: Final = "stopped"
"""Why a recording ended that somebody stopped."""

ENDED: Final = "the daemon stopped"
"""Why one ended whose daemon was ended, or killed."""

ENDED_AFTER_S: Final = 0.2
"""A daemon's last samples are here once nothing came for so long after its socket was gone."""

_ATTEMPTS: Final = 10
"""Attempts to read scene and materials while somebody changes the materials."""


def ended_early(because: str | None) -> str | None:
    """Why a recording ended before it was to end, by its `ended_because`; None where it did not: who stops one ends it
    when it is to end."""
    return None if because == STOPPED else because


@dataclass(frozen=True, slots=True)
class RecordSummary:
    """What a recording holds, and what it lacks."""

    file: str
    """Where it is."""
    ticks: int
    duration_s: float
    events: int
    lost: int
    """Samples that did not arrive here."""
    dropped: int
    """Samples that the daemon's ring had no room for."""
    missing_revisions: tuple[int, ...]
    """Revisions of the scene that samples were rendered with and that are not in it."""
    missed_periods: int
    """Periods in which the servo rendered no tick though one was due."""
    started: Moment | None
    """The daemon's clocks at the start; None: of a daemon that does not tell them."""
    ended: Moment | None
    """The daemon's clocks at the end."""
    ended_because: str | None
    """Why it ended early, None where it did not."""
    warning: str | None
    """More periods were missed than `servo.overruns.threshold`; None: not so many."""

    def summary(self) -> str:
        """One line for people."""
        missing = self.lost + self.dropped
        lost = "nothing lost"
        if missing:
            where = f"{self.lost:,} on the way here, {self.dropped:,} in the daemon's ring"
            lost = f"{wording.count(missing, 'tick')} lost ({where})"
        text = f"{self.file}: {wording.count(self.ticks, 'tick')} in {self.duration_s:.3f} s, "
        text += (
            f"{missed_text(self.missed_periods, self.ticks + missing)}, {lost}, {wording.count(self.events, 'event')}"
        )
        if self.missing_revisions:
            text += f"; {wording.count(len(self.missing_revisions), 'revision')} of the scene not in it"
        return text


class Messages(Protocol):
    """A subscription to telemetry."""

    def receive(self, timeout_s: float) -> tuple[Topic, dict[str, object]] | None: ...


class Daemon(Protocol):
    """What a recording needs of a client, which itself needs recordings."""

    paths: RuntimePaths
    timeout_s: float

    def get_status(self, detail: bool = False) -> Status: ...
    def get_config(self) -> ConfigResult: ...
    def get_scene(self) -> SceneResult: ...
    def get_materials(self) -> MaterialsResult: ...
    def telemetry(self, *topics: Topic) -> AbstractContextManager[Messages]: ...


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
    """Records every tick and every event into `target`, for `duration_s` of the daemon's time or until
    `stop` is set; then what the daemon had rendered by that time is in it.

    What was recorded is kept when it is stopped, when the daemon goes away and when the disk is full. `notes` are kept
    in it. `progress` is called with the time recorded so far, which is 0 until the first sample was taken; `opened`
    with the writer, before anything is recorded: another thread may ask it how much it wrote. Raises HapticdError where
    the target cannot be written, or is there already and `overwrite` does not say that it is to be replaced, before
    anything is recorded.
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
        # Told again where the disk was full, and the end gave way to what else is in the file.
        writer.finish(lambda: {"recording": session.account(ended)})
        account = session.account(ended)
        clocks = {name: moment_of(account[name]) for name in ("started", "ended")}
        summed = {each.name: account[each.name] for each in fields(RecordSummary) if each.name in account}
        return RecordSummary(
            **summed | clocks, file=os.fspath(recording_path(target)), warning=session.warning(account)
        )


class _Session:
    """One recording under way."""

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
        """At the start."""
        self._newest: Mapping[str, Any] = {}
        self._rates: list[tuple[int, float]] = []
        """The servo's from a tick on."""
        self._missed: list[tuple[int, int]] = []
        """Of batches in which periods were missed, the last tick, and how many."""

    def run(self, stop: threading.Event, progress: Callable[[float], None]) -> str | None:
        """Takes what comes; why it ended early, None where it did not."""
        client, interval = self._client, self._interval
        # Who is not there says so at once to a question; to wait for telemetry takes longer.
        client.get_status()
        with client.telemetry("samples", "event", "change", "status") as messages:
            self._begin()
            silent_since, ended = time.monotonic(), 0
            while not interval.over:
                if stop.is_set() and not interval.ends:
                    # What somebody did before stopping it is in it.
                    interval.end_at(self.ask_status())
                    continue
                received = messages.receive(0.1)
                if received is None:
                    silent_s = time.monotonic() - silent_since
                    if silent_s > client.timeout_s:
                        return str(no_telemetry(client.paths, client.timeout_s))
                    # Twice in a row: what was on its way when its socket went is here then.
                    ended = ended + 1 if silent_s > ENDED_AFTER_S and has_ended(client.paths) else 0
                    if ended > 1:
                        return ENDED
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
        return STOPPED if interval.ends else None

    def ask_status(self) -> int | None:
        """The tick that the servo is at, and with it the clocks at the end; None where nobody answers."""
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
        """The last samples may have come before the message of the change that they were rendered with."""
        deadline = time.monotonic() + LAST_CHANGE_S
        while self._scenes.missing and (left_s := deadline - time.monotonic()) > 0:
            received = messages.receive(left_s)
            if received is not None and received[0] == "change":
                self._scenes.apply(received[1])

    def _restarted(self) -> bool:
        """Whether those whose samples are missing are another daemon's. Where nobody answers, silence will tell."""
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
        """What the recording holds and what it lacks, as its file says it."""
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
        """Where more periods were missed than the configuration puts up with."""
        threshold = self._status.get("overruns", {}).get("threshold")
        missed, rendered = account["missed_periods"], account["ticks"] + account["lost"] + account["dropped"]
        if threshold is None or share(missed, rendered) <= threshold:
            return None
        part = wording.percent(share(missed, rendered))
        return (
            f"{missed:,} of {missed + rendered:,} periods were missed ({part}), more than "
            f"servo.overruns.threshold ({wording.percent(threshold)}); `hapticd doctor` says what the machine lacks"
        )


class _Scenes:
    """What the daemon renders: all of it at the start, and then what each change says.

    Where changes were lost, or one is too large to be sent, all is read again. What samples were rendered with
    meanwhile is missing in the recording, which says so.
    """

    def __init__(self, client: Daemon, writer: RecordingWriter) -> None:
        self._client = client
        self._writer = writer
        self.revision = 0
        """The newest one that is known."""
        self._known: set[int] = set()
        self._used: set[int] = set()
        self._scene: dict[str, Any] = {}
        self._objects: dict[str, Any] = {}
        self._materials: dict[str, Any] = {}
        self._rate_hz = 0.0

    @property
    def missing(self) -> tuple[int, ...]:
        """Revisions that samples were rendered with, and nobody said what they are."""
        return tuple(sorted(self._used - self._known))

    def begin(self) -> dict[str, Any]:
        """Status, scene and materials at the start."""
        read = self._read()
        if read is None:
            raise HapticdError("the materials change too fast for a recording to begin")
        self.revision, self._scene, self._objects, self._materials, status = read
        self._rate_hz = status["rate_hz"]
        self._known.add(self.revision)
        scene = {**self._scene, "objects": dict(self._objects)}
        return {"status": status, "scene": scene, "materials": dict(self._materials)}

    def reached(self, revisions: npt.NDArray[np.uint32]) -> npt.NDArray[np.bool_]:
        """Those that are the newest one known, or come after it."""
        return (revisions - np.uint32(self.revision)).astype(np.int32) >= 0

    def note_used(self, revisions: npt.NDArray[np.uint32]) -> None:
        """Samples were rendered with these."""
        self._used.update(np.unique(revisions).tolist())

    def apply(self, change: dict[str, Any]) -> None:
        """Takes what a message of the topic `change` says."""
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
        # What cannot be read is missing, and reported as that; silence will tell where the daemon is gone.
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
        """Revision, scene, objects, materials and status; None where materials or rate never stood still."""
        materials, status = self._materials_and_status()
        for _ in range(_ATTEMPTS):
            scene, after = self._client.get_scene(), self._materials_and_status()
            if after[0] == materials and after[1]["rate_hz"] == status["rate_hz"]:  # so they were in between, too
                rest = dict(scene["scene"])
                return scene["revision"], rest, cast("dict[str, Any]", rest.pop("objects")), materials, status
            materials, status = after
        return None

    def _materials_and_status(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """What else a scene is rendered with: the materials, and the status, which has the rate."""
        return dict(self._client.get_materials()["materials"]), dict(self._client.get_status(detail=True))


def _changes(before: Mapping[str, object], after: Mapping[str, object]) -> dict[str, object]:
    """What differs, by key; None for what is gone."""
    changed = {name: value for name, value in after.items() if name not in before or before[name] != value}
    return changed | dict.fromkeys(name for name in before if name not in after)


class _Interval:
    """The stretch of the daemon's time that is recorded, from the first sample that came.

    Events are sent before the samples of their ticks, so that those of a stretch are complete when its
    samples are.
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
        self.ends = False
        """Somebody stopped it."""
        self._complete: bool = False

    @property
    def over(self) -> bool:
        """Nothing more is to be taken."""
        if not self.ends:
            return self._complete
        return self._complete or self._end_tick > self._last_tick or time.monotonic() > self._give_up_at

    def end_at(self, tick: int | None) -> None:
        """It is over once this tick was taken, or soon; None: at once."""
        self.ends, self._complete = True, self._complete or tick is None
        self._last_tick = tick or 0
        self._give_up_at = time.monotonic() + LAST_CHANGE_S

    @property
    def recorded_s(self) -> float:
        if self._first_tick is None:
            return 0.0
        return self.duration_s(self._last_ns)

    def duration_s(self, last_ns: int) -> float:
        """From the first sample to the end of one at `last_ns`."""
        return (last_ns + self._period_ns - self._first_ns) / 1e9

    def clip(self, batch: SampleBatch) -> Samples:
        if len(batch) == 0:
            return batch
        times = batch["time_ns"]
        self._give_up_at = time.monotonic() + LAST_CHANGE_S  # what comes late is waited for as long as something comes
        if self._first_tick is None:
            self._first_tick = int(batch["tick"][0])
            self._first_ns = int(times[0])
        if len(batch) > 1:
            self._period_ns = int(np.min(np.diff(times)))
        clipped: Samples = batch
        if self._duration_ns is not None:
            # A deadline is rounded to whole nanoseconds: half a period decides which tick is the first
            # outside.
            inside = times - self._first_ns + self._period_ns // 2 < self._duration_ns
            clipped = batch[inside]
            self._complete = len(clipped) < len(batch)
        if len(clipped):
            self._end_tick = int(clipped["tick"][-1]) + 1
            self._last_ns = int(clipped["time_ns"][-1])
        return clipped

    def queue(self, event: dict[str, Any]) -> None:
        self._queued.append(event)

    def due_events(self) -> list[dict[str, Any]]:
        """The events of the ticks recorded so far."""
        if self._first_tick is None:
            return []
        ticks = [(int(event.get("tick", 0)), event) for event in self._queued]
        self._queued = [event for tick, event in ticks if tick >= self._end_tick]
        return [event for tick, event in ticks if self._first_tick <= tick < self._end_tick]


# ---- While a block of code runs --------------------------------------------------------------------------------------


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
