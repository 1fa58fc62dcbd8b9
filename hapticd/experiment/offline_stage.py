"""The stage (renderer) for trials without a daemon: it simulates servo and joystick, faster than real time.

The session's clock is the simulated time: each tick adds its period.
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
from hapticd.recording.simulated import write_run
from hapticd.recording.writer import RecordingWriter
from hapticd.rendering.offline import Run, simulate_run


class OfflineStage:
    """A renderer of trials that simulates servo and joystick, without a daemon."""

    def __init__(self, keep_telemetry: bool = False) -> None:
        """Make the stage. With `keep_telemetry` each trial is written to a .npz, which takes longer than the trial."""
        self._keep = keep_telemetry
        self._config: Config | None = None
        self._on = False
        self._now_s = 0.0
        self._parts: list[Run] = []
        self._marks: list[dict[str, Any]] = []

    def now_s(self) -> float:
        """Return the simulated time since the stage was made, in s."""
        return self._now_s

    def describe(self) -> dict[str, Json]:
        """Return the version and the device, which is always the simulated joystick."""
        return {"kind": "offline", "version": __version__, "device": "sim"}

    def check(self) -> None:
        """Do nothing: offline, neither a fault nor another client switches the forces off."""

    def arm(self, config: Config) -> None:
        """Set the configuration that `move` simulates, and forbid motions until `enable`.

        Each motion begins with an untouched scene.
        """
        self.fade()
        self._config = config

    def is_clear(self) -> bool:
        """Return True, since no hand holds the handle between motions."""
        return True

    def enable(self) -> None:
        """Allow motions of the simulated hand. Raises HapticdError if no scene is armed."""
        if self._config is None:
            raise HapticdError("no scene is armed")
        self._on = True

    def fade(self) -> None:
        """Forbid motions of the simulated hand until `enable`."""
        self._on = False

    def mark(self, text: str, data: Json) -> None:
        """Add a mark with this text and data at the next tick. The text `interval` begins a new interval."""
        if text == EventCode.INTERVAL.text:
            self._parts = []
        tick = sum(len(part.samples) for part in self._parts)
        self._marks.append(
            {"event": "mark", "tick": tick, "time_ns": round(self._now_s * 1e9), "text": text, "data": data}
        )

    @contextmanager
    def recording(self, target: Path, notes: Mapping[str, Json]) -> Iterator[None]:
        """Record a trial. If telemetry is kept, write the motions of its last interval into `target`, a .npz file."""
        self._parts, self._marks = [], []
        yield
        if self._keep and self._parts:
            self._write(target, notes)

    def move(self, motion: Motion) -> Samples:
        """Simulate a motion in the armed scene with the simulated joystick, and return its samples."""
        if self._config is None or not self._on:
            raise HapticdError("the forces are off; arm a scene and enable it before the hand moves")
        run = simulate_run(self._config, motion.waypoints, check_stability=False)
        if motion.reaction is not None:
            at_s = motion.reaction.noticed_s(run.samples)
            if at_s is not None:
                # Until `at_s` the new run is the same, bit for bit, because it does not depend on later waypoints.
                changed = np.vstack((until(motion.waypoints, at_s), motion.reaction.then(at_s)))
                run = simulate_run(self._config, changed, check_stability=False)
        self._parts.append(run)
        self._now_s += len(run.samples) / run.rate_hz
        return run.samples

    def telemetry(self) -> Telemetry:
        """Return the telemetry of all motions of the last interval, with consecutive ticks and times."""
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
        run = self.telemetry()
        with RecordingWriter(target) as writer:
            write_run(writer, self._config, self._parts[0].rate_hz, run.samples, run.events, notes)


def _shifted(event: Any, run: Run, ticks: int, time_ns: int) -> dict[str, Any]:
    """Return an event of a motion as a mapping, with `ticks` added to its tick and `time_ns` to its times."""
    found: dict[str, Any] = event_map(event, run.objects.get((int(event["slot"]), int(event["generation"]))))
    found["tick"] += ticks
    for name in ("time_ns", "onset_time_ns"):
        if name in found:
            found[name] += time_ns
    return found
