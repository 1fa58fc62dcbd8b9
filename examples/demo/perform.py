"""Running the daemon, having the operator do something, and recording what telemetry says of it."""

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
"""Handle and hand of the default configuration: what makes an acceleration a force."""
GRIP_N_PER_M: Final = 300.0
"""Stiffness of its hand."""
FLOOR_N_PER_M: Final = 800.0
"""Of the materials that are stroked."""
HOVER_M: Final = 0.012
"""Where the hand waits between two performances, above the surface y = 0."""
PAUSE_BEFORE_STROKE_S: Final = 0.15
START_TIMEOUT_S: Final = 180.0
"""A daemon that gets a hundredth of a processor needs so long to start."""
ANSWER_TIMEOUT_S: Final = 30.0
"""A daemon that does nothing for so long has failed, however busy the machine is."""


class Disturbed(HapticdError):
    """The machine was too busy to record a performance whole. It says nothing about the daemon."""


@dataclass(frozen=True, slots=True)
class Recorded:
    """Telemetry of one performance, times in seconds from its first sample."""

    time_s: Floats
    samples: npt.NDArray[np.void]
    """(n,) records with the fields of telemetry, one a tick."""
    events: tuple[dict[str, Any], ...]
    start_ns: int
    rate_hz: float

    def vibration(self, axis: int) -> Floats:
        """(n,) what the modes and the noise ask of the handle along an axis, m/s^2."""
        return np.ascontiguousarray(self.samples["vibration_force_n"][:, axis]) / MASS_KG

    def gaps(self) -> npt.NDArray[np.intp]:
        """Samples before which periods were missed."""
        return np.flatnonzero(np.diff(self.time_s) > 1.5 / self.rate_hz) + 1

    def flagged(self, flags: Flag) -> npt.NDArray[np.bool_]:
        """(n,) whether a tick has one of these flags."""
        return np.asarray((self.samples["flags"] & flags) != 0)

    def reported(self, kind: str) -> list[dict[str, Any]]:
        """The events of a kind, in order."""
        return [event for event in self.events if event["event"] == kind]

    def onset_s(self, event: dict[str, Any]) -> float:
        """When an event happened, between two samples."""
        return float((event["time_ns"] - self.start_ns) / 1e9 - event["before_tick_s"])


def stroking(
    half_m: float, strokes: Sequence[tuple[float, float, int]]
) -> tuple[Waypoints, list[tuple[int, float, float]]]:
    """Waypoints of a hand that strokes the floor at y = 0 between -half_m and half_m, and of each way the number of its
    stroke, begin and end. A stroke is its speed, the force that is pressed with, N, and how many ways it goes."""
    now, x, path, ways = 0.5, -half_m, [[0.2, -half_m, HOVER_M]], []
    for number, (speed, press_n, count) in enumerate(strokes):
        # Hand and surface are springs in series.
        depth, lasting = press_n * (1 / FLOOR_N_PER_M + 1 / GRIP_N_PER_M), 2 * half_m / speed
        path += [[now, x, -depth]] if number == 0 else []
        now += PAUSE_BEFORE_STROKE_S
        path.append([now, x, -depth])
        for _ in range(count):
            ways.append((number, now, now + lasting))
            x, now = -x, now + lasting
            path.append([now, x, -depth])
    path += [
        [now + PAUSE_BEFORE_STROKE_S, x, path[-1][2]],
        [now + PAUSE_BEFORE_STROKE_S + 0.2, x, HOVER_M],
        [now + PAUSE_BEFORE_STROKE_S + 0.4, 0.0, HOVER_M],
    ]
    return path, ways


def joined(measured: Sequence[Any]) -> Any:
    """Measurements of several performances as one: arrays are put one after the other, numbers are added."""
    first = measured[0]
    if isinstance(first, np.ndarray):
        return np.concatenate(measured)
    if isinstance(first, int):
        return sum(measured)
    return type(first)(*(joined([getattr(each, field.name) for each in measured]) for field in fields(first)))


def perform(daemon: Client, waypoints: Waypoints, advance: Callable[[float], None]) -> Recorded:
    """Has the operator follow the waypoints and records it until the end; `advance` gets the part that is done.

    Raises Disturbed where samples or events were lost, or where commands got no processor for so long that the forces
    went off.
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
        # The end of the gesture is the last event that matters: what happened before it has come when it comes.
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
    """A client of a daemon that may still be starting. Raises DaemonNotRunning."""
    deadline = time.monotonic() + START_TIMEOUT_S
    while True:
        try:
            return connect(directory, ANSWER_TIMEOUT_S, wait_s=1.0)
        except DaemonNotRunning:
            if process.poll() is not None or time.monotonic() > deadline:
                raise


@contextmanager
def running_daemon(directory: Path) -> Iterator[Client]:
    """`hapticd run` in a process of its own, stopped (and checked to have stopped well) at the end."""
    command = [sys.executable, "-m", "hapticd", "--runtime-dir", str(directory), "run"]
    silent = False
    # In a pipe that nobody reads, a long log of a busy machine would stop the daemon.
    with tempfile.TemporaryFile("w+") as log:
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=log)
        try:
            with _connected(process, directory) as daemon:
                yield daemon
        except DaemonNotRunning:
            silent = process.poll() is None  # one that ended by itself says why
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
