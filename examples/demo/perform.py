"""Running the daemon, having the operator do something, and recording what telemetry says of it."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from hapticd.base.errors import HapticdError
from hapticd.client.blocking import Client, connect

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
REST_S: Final = 0.15
"""Before each stroke."""


class Unseen(HapticdError):
    """Between the periods that the machine missed too little can be seen. It is to be done again."""


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

    def told(self, kind: str) -> list[dict[str, Any]]:
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
        now += REST_S
        path.append([now, x, -depth])
        for _ in range(count):
            ways.append((number, now, now + lasting))
            x, now = -x, now + lasting
            path.append([now, x, -depth])
    path += [[now + REST_S, x, path[-1][2]], [now + REST_S + 0.2, x, HOVER_M], [now + REST_S + 0.4, 0.0, HOVER_M]]
    return path, ways


def perform(daemon: Client, waypoints: Waypoints, advance: Callable[[float], None]) -> Recorded:
    """Has the operator follow the waypoints and records it until the end; `advance` hears which part is done."""
    with daemon.samples() as samples, daemon.events() as feed:
        answer = daemon.set_operator(waypoints)
        begin, lasting = int(answer["tick"]), float(answer["duration_s"])
        rate = float(daemon.get_status()["rate_hz"])
        batches: list[npt.NDArray[np.void]] = []
        events: list[dict[str, Any]] = []
        done_s = 0.0
        while done_s <= lasting + 5 / rate:
            batch = next(samples)
            if batch.lost:
                raise HapticdError(f"{batch.lost} samples were lost: the machine is too busy for the demo")
            while (event := feed.receive(0.0)) is not None:
                events.append({**event})
            if len(kept := batch[batch["tick"] >= begin]):
                batches.append(np.array(kept))
                done_s = (int(kept["time_ns"][-1]) - int(batches[0]["time_ns"][0])) / 1e9
                advance(min(1.0, done_s / lasting))
        end_ns = int(batches[-1]["time_ns"][-1])
        # What happened until the end may still be on its way; what happened after it says that it has come.
        while not (events and events[-1]["time_ns"] > end_ns) and (event := feed.receive(0.1)) is not None:
            events.append({**event})
    data = np.concatenate(batches)
    zero = int(data["time_ns"][0])
    told = tuple(event for event in events if begin <= event["tick"] and event["time_ns"] <= end_ns)
    return Recorded((data["time_ns"] - zero) / 1e9, data, told, zero, rate)


@contextmanager
def running_daemon(directory: Path) -> Iterator[Client]:
    """`hapticd run` in a process of its own, stopped (and checked to have stopped well) at the end."""
    command = [sys.executable, "-m", "hapticd", "--runtime-dir", str(directory), "run"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    try:
        with connect(directory, wait_s=30.0) as daemon:
            yield daemon
    finally:
        process.send_signal(signal.SIGTERM)
        _, said = process.communicate(timeout=30)
        if process.returncode != 0:
            raise HapticdError(f"the daemon ended with {process.returncode}: {said.strip()}")
