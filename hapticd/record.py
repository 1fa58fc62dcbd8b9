"""Recordings of a running daemon: its telemetry, and what the samples were rendered with, into a file.

sink.py and mcap.py write the files, replay.py renders what is in them again.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final, cast

import numpy as np
import numpy.typing as npt

from hapticd import calls
from hapticd.calls import Topic
from hapticd.client import Client, Subscription
from hapticd.errors import HapticdError
from hapticd.samples import SampleBatch, SampleStream
from hapticd.sink import NO_TIME, DiskFullError, Samples, Sink, event_array, open_sink

__all__ = ["NO_TIME", "Recording", "event_array", "open_sink", "record"]

MOST_GAPS: Final = 1000
"""Gaps that a recording lists; the ticks of its samples show all of them."""

LAST_CHANGE_S: Final = 1.0
"""How long, at the end, the change is waited for that the last samples were rendered with."""

_LOOKS: Final = 10
"""Attempts to read scene and materials while somebody changes the materials."""


@dataclass(frozen=True, slots=True)
class Recording:
    """What a recording holds, and what it lacks."""

    file: str
    ticks: int
    duration_s: float
    events: int
    lost: int
    """Samples that did not arrive here."""
    dropped: int
    """Samples that the daemon's ring had no room for."""
    missing_revisions: tuple[int, ...]
    """Revisions of the scene that samples were rendered with and that are not in it."""
    ended: str | None
    """Why it ended early, None where it did not."""

    def summary(self) -> str:
        """One line for people."""
        text = f"{self.file}: {self.ticks} ticks in {self.duration_s:.3f} s, {self.events} events, "
        missing = self.lost + self.dropped
        if missing:
            where = f"{self.lost} on the way here, {self.dropped} in the daemon's ring"
            text += f"{missing} ticks lost ({where})"
        else:
            text += "nothing lost"
        if self.missing_revisions:
            text += f"; {len(self.missing_revisions)} revisions of the scene are not in it"
        return text


def record(
    client: Client,
    target: str | os.PathLike[str],
    duration_s: float | None = None,
    *,
    stop: threading.Event | None = None,
    progress: Callable[[float], None] = lambda recorded_s: None,
) -> Recording:
    """Records every tick and every event into `target`, for `duration_s` of the daemon's time or until
    `stop` is set.

    What was recorded is kept when it is stopped, when the daemon goes away and when the disk is full. `progress` is
    called with the time recorded so far. Raises HapticdError where the target cannot be written, before anything is
    recorded.
    """
    with open_sink(target) as sink:
        take = _Take(client, sink, duration_s)
        try:
            ended = take.run(stop or threading.Event(), progress)
        except DiskFullError as error:
            ended = str(error)
        if sink.count == 0:
            raise HapticdError(f"{target}: nothing was recorded{f' ({ended})' if ended else ''}")
        kept = take.account(ended)
        sink.finish({"recording": kept})
        if sink.count != kept["ticks"]:  # the disk was full, and the end gave way to what else is in the file
            kept = take.account(ended)
        return Recording(
            os.fspath(target),
            sink.count,
            kept["duration_s"],
            sink.event_count,
            kept["lost"],
            kept["dropped"],
            tuple(kept["missing_revisions"]),
            ended,
        )


class _Take:
    """One recording under way."""

    def __init__(self, client: Client, sink: Sink, duration_s: float | None) -> None:
        self._client = client
        self._sink = sink
        self._scenes = _Scenes(client, sink)
        self._stream = SampleStream(warn=False)
        self._span = _Span(duration_s)
        self._gaps: list[tuple[int, int]] = []
        self._started_ns = 0

    def run(self, stop: threading.Event, progress: Callable[[float], None]) -> str | None:
        """Takes what comes; why it ended early, None where it did not."""
        client, span = self._client, self._span
        with client.telemetry("samples", "event", "change", "status") as messages:
            self._begin()
            silent_since = time.monotonic()
            while not span.over:
                if stop.is_set():
                    self._await_changes(messages)
                    return "stopped"
                received = messages.receive(0.1)
                if received is None:
                    if time.monotonic() - silent_since > client.timeout_s:
                        return str(calls.silent(client.paths, client.timeout_s))
                    continue
                silent_since = time.monotonic()
                topic, message = received
                if topic == "samples":
                    batch = self._stream.convert(topic, message)
                    if self._stream.restarts or (batch.lost and self._restarted()):
                        return "the daemon was restarted"
                    self._take(batch)
                    progress(span.recorded_s)
                elif topic == "event":
                    span.hold(message)
                elif topic == "change":
                    self._scenes.take(message)
                else:
                    self._sink.write_status(message)
            self._await_changes(messages)
        return None

    def _begin(self) -> None:
        start = self._scenes.begin()
        self._started_ns = start["status"]["started_ns"]
        self._sink.begin({"config": self._client.get_config()["config"], **start})
        self._sink.write_change({"revision": self._scenes.revision})

    def _await_changes(self, messages: Subscription[tuple[Topic, dict[str, object]]]) -> None:
        """The last samples may have come before the message of the change that they were rendered with."""
        deadline = time.monotonic() + LAST_CHANGE_S
        while self._scenes.missing and (left_s := deadline - time.monotonic()) > 0:
            received = messages.receive(left_s)
            if received is not None and received[0] == "change":
                self._scenes.take(received[1])

    def _restarted(self) -> bool:
        """Whether those whose samples are missing are another daemon's. Where nobody answers, silence will tell."""
        with suppress(calls.DaemonNotRunning):
            return self._client.get_status()["started_ns"] != self._started_ns
        return False

    def _take(self, batch: SampleBatch) -> None:
        if self._sink.count == 0:
            batch = batch[self._scenes.reached(batch["revision"])]
        samples = self._span.cut(batch).view(np.ndarray)
        if len(samples) == 0:
            return
        ticks = samples["tick"].astype(np.int64)
        before = self._sink.last_tick if self._sink.count else int(ticks[0]) - 1
        steps = np.diff(ticks, prepend=before)
        for place in np.flatnonzero(steps != 1)[: MOST_GAPS - len(self._gaps)].tolist():
            missing = int(steps[place]) - 1
            self._gaps.append((int(ticks[place]) - missing, missing))
        self._scenes.show(samples["revision"])
        self._sink.write(samples)
        for event in self._span.release():
            self._sink.write_event(event)

    def account(self, ended: str | None) -> dict[str, Any]:
        """What the recording holds and what it lacks, as its file says it."""
        return {
            "ticks": self._sink.count,
            "duration_s": self._span.duration_s(self._sink.last_time_ns),
            "events": self._sink.event_count,
            "lost": self._stream.lost,
            "dropped": self._stream.dropped,
            "gaps": self._gaps,
            "missing_revisions": self._scenes.missing,
            "ended": ended,
        }


class _Scenes:
    """What the daemon renders: all of it at the start, and then what each change says.

    Where changes were lost, or one is too large to be told, all is read again. What samples were rendered with
    meanwhile is missing in the recording, which says so.
    """

    def __init__(self, client: Client, sink: Sink) -> None:
        self._client = client
        self._sink = sink
        self.revision = 0
        """The newest one that is known."""
        self._known: set[int] = set()
        self._shown: set[int] = set()
        self._scene: dict[str, Any] = {}
        self._objects: dict[str, Any] = {}
        self._materials: dict[str, Any] = {}
        self._rate_hz = 0.0

    @property
    def missing(self) -> list[int]:
        """Revisions that samples were rendered with, and nobody said what they are."""
        return sorted(self._shown - self._known)

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

    def show(self, revisions: npt.NDArray[np.uint32]) -> None:
        """Samples were rendered with these."""
        self._shown.update(np.unique(revisions).tolist())

    def take(self, change: dict[str, Any]) -> None:
        """Takes what a message of the topic `change` says."""
        if "revision" not in change:
            self._sink.write_change(change)
            return
        ahead = (change["revision"] - self.revision) & 0xFFFFFFFF
        if ahead == 1 and not change.get("large"):
            _merge(self._scene, change.get("scene", {}))
            _merge(self._objects, change.get("objects", {}))
            _merge(self._materials, change.get("materials", {}))
            self._rate_hz = change.get("rate_hz", self._rate_hz)
            self._write(change)
        elif 0 < ahead < 0x80000000:
            self._read_again()

    def _read_again(self) -> None:
        # What cannot be read is missing, and told as that; silence will tell where the daemon is gone.
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
        self._sink.write_change({name: part for name, part in change.items() if part != {}})

    def _read(self) -> tuple[int, dict[str, Any], dict[str, Any], dict[str, Any], dict[str, Any]] | None:
        """Revision, scene, objects, materials and status; None where materials or rate never stood still."""
        materials, status = self._beside()
        for _ in range(_LOOKS):
            scene, after = self._client.get_scene(), self._beside()
            if after[0] == materials and after[1]["rate_hz"] == status["rate_hz"]:  # so they were in between, too
                rest = dict(scene["scene"])
                return scene["revision"], rest, cast("dict[str, Any]", rest.pop("objects")), materials, status
            materials, status = after
        return None

    def _beside(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """What else a scene is rendered with: the materials, and the status, which has the rate."""
        return dict(self._client.get_materials()["materials"]), dict(self._client.get_status())


def _merge(into: dict[str, Any], changes: Mapping[str, Any]) -> None:
    for name, value in changes.items():
        if value is None:
            into.pop(name, None)
        else:
            into[name] = value


def _changes(before: Mapping[str, object], after: Mapping[str, object]) -> dict[str, object]:
    """What differs, by key; None for what is gone."""
    changed = {name: value for name, value in after.items() if name not in before or before[name] != value}
    return changed | dict.fromkeys(name for name in before if name not in after)


class _Span:
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
        self._held: list[dict[str, Any]] = []
        self.over = False

    @property
    def recorded_s(self) -> float:
        if self._first_tick is None:
            return 0.0
        return self.duration_s(self._last_ns)

    def duration_s(self, last_ns: int) -> float:
        """From the first sample to the end of one at `last_ns`."""
        return (last_ns + self._period_ns - self._first_ns) / 1e9

    def cut(self, batch: SampleBatch) -> Samples:
        if len(batch) == 0:
            return batch
        times = batch["time_ns"]
        if self._first_tick is None:
            self._first_tick = int(batch["tick"][0])
            self._first_ns = int(times[0])
        if len(batch) > 1:
            self._period_ns = int(np.min(np.diff(times)))
        kept: Samples = batch
        if self._duration_ns is not None:
            # A deadline is rounded to whole nanoseconds: half a period decides which tick is the first
            # outside.
            inside = times - self._first_ns + self._period_ns // 2 < self._duration_ns
            kept = batch[inside]
            self.over = len(kept) < len(batch)
        if len(kept):
            self._end_tick = int(kept["tick"][-1]) + 1
            self._last_ns = int(kept["time_ns"][-1])
        return kept

    def hold(self, event: dict[str, Any]) -> None:
        self._held.append(event)

    def release(self) -> list[dict[str, Any]]:
        """The events of the ticks recorded so far."""
        if self._first_tick is None:
            return []
        held, self._held = self._held, []
        released = []
        for event in held:
            tick = int(event.get("tick", 0))
            if tick >= self._end_tick:
                self._held.append(event)
            elif tick >= self._first_tick:
                released.append(event)
        return released
