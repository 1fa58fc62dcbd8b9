"""Runs the daemon, commands the operator, and records telemetry."""

from __future__ import annotations

import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from hapticd.base.core import Flag
from hapticd.base.errors import HapticdError
from hapticd.client.blocking import Client, connect
from hapticd.protocol.calls import DaemonNotRunning

Floats = npt.NDArray[np.float64]
Waypoints = list[list[float]]

MASS_KG: Final = 0.05
"""Effective mass of handle and hand in the default configuration: the ratio of force to acceleration."""
GRIP_N_PER_M: Final = 300.0
"""Stiffness of the hand in the default configuration."""
FLOOR_N_PER_M: Final = 800.0
"""Stiffness of the stroked materials."""
HOVER_M: Final = 0.012
"""Height of the hand above the surface y = 0 between two motions."""
PAUSE_BEFORE_STROKE_S: Final = 0.15
START_TIMEOUT_S: Final = 180.0
"""Time within which a daemon must start; enough with a hundredth of a processor."""
ANSWER_TIMEOUT_S: Final = 30.0
"""A daemon that does not answer within this time has failed, even on a busy machine."""


class Disturbed(HapticdError):
    """The machine was too busy to record a motion completely. This is not a fault of the daemon."""


@dataclass(frozen=True, slots=True)
class Recorded:
    """Telemetry of one motion, with times in s since its first sample."""

    time_s: Floats
    samples: npt.NDArray[np.void]
    """Records with the fields of telemetry, one per tick, (n,)."""
    events: tuple[dict[str, Any], ...]
    start_ns: int
    rate_hz: float

    def vibration(self, axis: int) -> Floats:
        """Return the commanded acceleration of modes and noise along an axis in m/s^2, (n,)."""
        return np.ascontiguousarray(self.samples["vibration_force_n"][:, axis]) / MASS_KG

    def gaps(self) -> npt.NDArray[np.intp]:
        """Return the indices of the samples that follow missed periods."""
        return np.flatnonzero(np.diff(self.time_s) > 1.5 / self.rate_hz) + 1

    def flagged(self, flags: Flag) -> npt.NDArray[np.bool_]:
        """Return whether each tick has one of these flags, (n,)."""
        return np.asarray((self.samples["flags"] & flags) != 0)

    def reported(self, kind: str) -> list[dict[str, Any]]:
        """Return the events of a kind, in order."""
        return [event for event in self.events if event["event"] == kind]

    def onset_s(self, event: dict[str, Any]) -> float:
        """Return the time of an event, which may lie between two samples."""
        return float((event["time_ns"] - self.start_ns) / 1e9 - event["before_tick_s"])


def stroking(
    half_m: float, strokes: Sequence[tuple[float, float, int]]
) -> tuple[Waypoints, list[tuple[int, float, float]]]:
    """Return the waypoints of a hand that strokes the floor at y = 0 between -half_m and half_m, and its passes.

    A stroke has a speed in m/s, a pressing force in N and a number of passes. A pass has the number of its stroke, its
    begin and its end in s.
    """
    now, x, path, passes = 0.5, -half_m, [[0.2, -half_m, HOVER_M]], []
    for number, (speed, press_n, count) in enumerate(strokes):
        # Hand and surface are springs in series.
        depth, duration = press_n * (1 / FLOOR_N_PER_M + 1 / GRIP_N_PER_M), 2 * half_m / speed
        path += [[now, x, -depth]] if number == 0 else []
        now += PAUSE_BEFORE_STROKE_S
        path.append([now, x, -depth])
        for _ in range(count):
            passes.append((number, now, now + duration))
            x, now = -x, now + duration
            path.append([now, x, -depth])
    path += [
        [now + PAUSE_BEFORE_STROKE_S, x, path[-1][2]],
        [now + PAUSE_BEFORE_STROKE_S + 0.2, x, HOVER_M],
        [now + PAUSE_BEFORE_STROKE_S + 0.4, 0.0, HOVER_M],
    ]
    return path, passes


def joined(measured: Sequence[Any]) -> Any:
    """Join the measurements of several motions: concatenate arrays, add numbers."""
    first = measured[0]
    if isinstance(first, np.ndarray):
        return np.concatenate(measured)
    if isinstance(first, int):
        return sum(measured)
    return type(first)(*(joined([getattr(each, field.name) for each in measured]) for field in fields(first)))


def perform(daemon: Client, waypoints: Waypoints, advance: Callable[[float], None]) -> Recorded:
    """Let the operator follow the waypoints, and record telemetry until the end; `advance` gets the completed fraction.

    Raises Disturbed if samples or events were lost, or if the forces went off because commands got no processor.
    """
    before = daemon.get_status()
    with daemon.samples() as samples, daemon.events() as feed:
        answer = daemon.set_operator(waypoints)
        begin, duration_s, rate_hz = int(answer["tick"]), float(answer["duration_s"]), float(before["rate_hz"])
        batches: list[npt.NDArray[np.void]] = []
        events: list[dict[str, Any]] = []
        done_s = 0.0
        while done_s <= duration_s + 5 / rate_hz:
            batch = next(samples)
            if batch.lost:
                raise Disturbed(f"{batch.lost} samples were lost on their way")
            while (event := feed.receive(0.0)) is not None:
                events.append({**event})
            if len(kept := batch[batch["tick"] >= begin]):
                batches.append(np.array(kept))
                done_s = (int(kept["time_ns"][-1]) - int(batches[0]["time_ns"][0])) / 1e9
                advance(min(1.0, done_s / duration_s))
        # Events arrive in order: the end of the gesture follows all events that matter.
        while not any(event.get("started_tick") == begin for event in events):
            if (event := feed.receive(ANSWER_TIMEOUT_S)) is None:
                raise Disturbed("the end of the gesture was not reported")
            events.append({**event})
    after = daemon.get_status()
    if after["faults"] == ["control"]:
        daemon.set_forces(True)
        raise Disturbed("the forces went off, as commands got no processor for a second")
    if after["faults"]:
        raise HapticdError(f"the daemon reports a fault: {', '.join(after['faults'])}")
    for counter in ("samples_dropped", "events_dropped"):
        if dropped := after["counters"][counter] - before["counters"][counter]:
            raise Disturbed(f"{dropped} {counter.split('_')[0]} were dropped")
    data = np.concatenate(batches)
    zero, end_ns = int(data["time_ns"][0]), int(data["time_ns"][-1])
    reported = tuple(event for event in events if begin <= event["tick"] and event["time_ns"] <= end_ns)
    return Recorded((data["time_ns"] - zero) / 1e9, data, reported, zero, rate_hz)


def _connected(process: subprocess.Popen[bytes], directory: Path) -> Client:
    """Connect to a daemon that may still be starting. Raises DaemonNotRunning."""
    deadline = time.monotonic() + START_TIMEOUT_S
    while True:
        try:
            return connect(directory, ANSWER_TIMEOUT_S, wait_s=1.0)
        except DaemonNotRunning:
            if process.poll() is not None or time.monotonic() > deadline:
                raise


@contextmanager
def running_daemon(directory: Path) -> Iterator[Client]:
    """Run `hapticd run` in a separate process; at the end stop it, and check its exit code."""
    command = [sys.executable, "-m", "hapticd", "--runtime-dir", str(directory), "run"]
    silent = False
    # A file, because a pipe that is not read would block the daemon when its log fills the pipe.
    with tempfile.TemporaryFile("w+") as log:
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=log)
        try:
            with _connected(process, directory) as daemon:
                yield daemon
        except DaemonNotRunning:
            silent = process.poll() is None  # if the daemon itself ended, its log says why
            raise
        finally:
            process.send_signal(signal.SIGTERM)
            try:
                process.wait(ANSWER_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
                raise HapticdError(f"the daemon did not end within {ANSWER_TIMEOUT_S:g} s") from None
            if process.returncode != 0 and not silent:
                log.seek(0)
                raise HapticdError(f"the daemon ended with {process.returncode}: {log.read().strip()}")
