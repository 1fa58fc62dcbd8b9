"""Trials without a daemon, faster than real time: the servo's own tick and the simulated joystick.

Nothing waits here, so the session's clock is the simulated hand's: each tick adds its period.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from hapticd._version import __version__
from hapticd.base.core import SAMPLE_DTYPE
from hapticd.base.errors import HapticdError
from hapticd.base.yaml_source import Json
from hapticd.config.configuration import Config
from hapticd.experiment.event_codes import EventCode
from hapticd.experiment.stage import Motion, Samples, Telemetry, until
from hapticd.protocol.events import event_map
from hapticd.recording.writer import RecordingWriter
from hapticd.rendering.offline import Run, simulate_run


class OfflineStage:
    """A stage that is computed."""

    def __init__(self, keep_telemetry: bool = False) -> None:
        """`keep_telemetry`: a .npz for each trial, which takes longer than the trial's computation."""
        self._keep = keep_telemetry
        self._config: Config | None = None
        self._on = False
        self._now_s = 0.0
        self._parts: list[Run] = []
        self._marks: list[dict[str, Any]] = []

    def now_s(self) -> float:
        """Simulated time since the stage was made, s."""
        return self._now_s

    def describe(self) -> dict[str, Json]:
        """Of this version of the core; device and rate are those of each scene."""
        return {"kind": "offline", "version": __version__, "device": "sim"}

    def check(self) -> None:
        """Nothing can be lost here."""

    def arm(self, config: Config) -> None:
        """Each run of the closed loop begins with a scene that nothing has touched."""
        self.fade()
        self._config = config

    def is_clear(self) -> bool:
        """Each motion begins where its waypoints do."""
        return True

    def enable(self) -> None:
        if self._config is None:
            raise HapticdError("no scene is armed")
        self._on = True

    def fade(self) -> None:
        self._on = False

    def mark(self, text: str, data: Json) -> None:
        """An event code, at the tick that comes next; a new interval begins with the mark `interval`."""
        if text == EventCode.INTERVAL.text:
            self._parts = []
        tick = sum(len(part.samples) for part in self._parts)
        self._marks.append(
            {"event": "mark", "tick": tick, "time_ns": round(self._now_s * 1e9), "text": text, "data": data}
        )

    @contextmanager
    def recording(self, target: Path, notes: Mapping[str, Json]) -> Iterator[None]:
        """Into `target`, where telemetry is kept: the motions of the last interval."""
        self._parts, self._marks = [], []
        yield
        if self._keep and self._parts:
            self._write(target, notes)

    def move(self, motion: Motion) -> Samples:
        """The closed loop with the simulated joystick of the scene that is armed."""
        if self._config is None or not self._on:
            raise HapticdError("the forces are off: arm a scene and enable it before the hand moves")
        run = simulate_run(self._config, motion.waypoints, check_stability=False)
        if motion.reaction is not None:
            at_s = motion.reaction.noticed_s(run.samples)
            if at_s is not None:
                # The same run until then, bit for bit, since nothing of it depends on what comes later.
                changed = np.vstack((until(motion.waypoints, at_s), motion.reaction.then(at_s)))
                run = simulate_run(self._config, changed, check_stability=False)
        self._parts.append(run)
        self._now_s += len(run.samples) / run.rate_hz
        return run.samples

    def telemetry(self) -> Telemetry:
        """The last interval's motions in a row; their ticks and times count on."""
        samples, events = [np.zeros(0, SAMPLE_DTYPE)], []
        ticks, time_ns = 0, 0
        for run in self._parts:
            part = run.samples.copy()
            part["tick"] += ticks
            part["time_ns"] += time_ns
            samples.append(part)
            events += [_shifted(event, run, ticks, time_ns) for event in run.events]
            ticks += len(part)
            time_ns += round(len(part) / run.rate_hz * 1e9)
        return Telemetry(np.concatenate(samples), events)

    def _write(self, target: Path, notes: Mapping[str, Json]) -> None:
        assert self._config is not None
        told, run = self.telemetry(), self._parts[0]
        servo = self._config.servo.model_copy(update={"rate_hz": run.rate_hz})
        texts = {
            "config": {"servo": servo.to_dict(), "device": self._config.device.to_dict()},
            "scene": self._config.scene.to_dict(),
            "materials": {name: material.to_dict() for name, material in self._config.materials.items()},
        }
        about = {
            "ticks": len(told.samples),
            "duration_s": len(told.samples) / run.rate_hz,
            "events": len(told.events),
            "missed_periods": 0,
            "notes": dict(notes),
        }
        with RecordingWriter(target) as writer:
            writer.write_all(texts, [{"revision": 1}], told.samples, iter(told.events))
            writer.finish({"recording": about})


def _shifted(event: Any, run: Run, ticks: int, time_ns: int) -> dict[str, Any]:
    """An event as a map, counted from the first motion of the interval."""
    told: dict[str, Any] = event_map(event, run.objects.get((int(event["slot"]), int(event["generation"]))))
    told["tick"] += ticks
    for name in ("time_ns", "onset_time_ns"):
        if name in told:
            told[name] += time_ns
    return told
