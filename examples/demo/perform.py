"""Running the daemon, having the operator do something, and recording what telemetry says of it."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from rich.progress import Progress, TaskID

from hapticd.base.errors import HapticdError
from hapticd.client.blocking import Client, Subscription, connect
from hapticd.protocol.results import Event

Floats = npt.NDArray[np.float64]

MASS_KG: Final = 0.05
"""Handle and hand of the default configuration: what makes an acceleration a force."""
GRIP_N_PER_M: Final = 300.0
"""Stiffness of its hand."""
HOVER_M: Final = 0.012
"""Where the hand waits between two performances, above the surface y = 0."""


@dataclass(frozen=True, slots=True)
class Recorded:
    """Telemetry of one performance, times in seconds from its first sample."""

    time_s: Floats
    samples: npt.NDArray[np.void]
    """(n,) records with the fields of telemetry, one a tick."""
    events: tuple[dict[str, Any], ...]
    start_ns: int

    def onset_s(self, event: dict[str, Any]) -> float:
        """When an event happened, between two samples."""
        return float((event["time_ns"] - self.start_ns) / 1e9 - event["before_tick_s"])


@dataclass(frozen=True, slots=True)
class Part:
    """A bar of the progress display."""

    progress: Progress
    task: TaskID

    def __call__(self, done: float) -> None:
        """`done`, 0 to 1."""
        self.progress.update(self.task, completed=done)


def hand_depth_m(press_n: float, stiffness_n_per_m: float) -> float:
    """How far below a surface the hand wants to be to press it so hard: hand and surface are springs in series."""
    return press_n * (1 / stiffness_n_per_m + 1 / GRIP_N_PER_M)


def perform(daemon: Client, waypoints: list[list[float]], advance: Part) -> Recorded:
    """Has the operator follow the waypoints and records it until the end."""
    feed: Subscription[Event]
    with daemon.samples() as samples, daemon.events() as feed:
        answer = daemon.set_operator(waypoints)
        begin, lasting = int(answer["tick"]), float(answer["duration_s"])
        rate = float(daemon.get_status()["rate_hz"])
        batches = []
        events: list[dict[str, Any]] = []
        start_ns = None
        while True:
            batch = next(samples)
            if batch.lost:
                raise HapticdError(f"{batch.lost} samples were lost: the machine is too busy for the demo")
            while (event := feed.receive(0.0)) is not None:
                events.append({**event})
            kept = batch[batch["tick"] >= begin]
            if len(kept):
                start_ns = int(kept["time_ns"][0]) if start_ns is None else start_ns
                batches.append(np.array(kept))
                advance(min(1.0, (int(kept["time_ns"][-1]) - start_ns) / 1e9 / lasting))
                if int(kept["time_ns"][-1]) - start_ns > (lasting + 5 / rate) * 1e9:
                    break
        end_ns = int(batches[-1]["time_ns"][-1])
        # What happened until the end may still be on its way; what happened after it says that it has come.
        while not (events and events[-1]["time_ns"] > end_ns) and (event := feed.receive(0.1)) is not None:
            events.append({**event})
    data = np.concatenate(batches)
    zero = int(data["time_ns"][0])
    return Recorded(
        time_s=(data["time_ns"] - zero) / 1e9,
        samples=data,
        events=tuple(event for event in events if begin <= event["tick"] and event["time_ns"] <= end_ns),
        start_ns=zero,
    )


@contextmanager
def running_daemon(directory: Path) -> Iterator[Client]:
    """`hapticd run` in a process of its own, stopped (and checked to have stopped well) at the end."""
    process = subprocess.Popen(
        [sys.executable, "-m", "hapticd", "--runtime-dir", str(directory), "run"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield _connected(process, directory)
    finally:
        process.send_signal(signal.SIGTERM)
        _, said = process.communicate(timeout=30)
    if process.returncode != 0:
        raise HapticdError(f"the daemon ended with {process.returncode}: {said.strip()}")


def _connected(process: subprocess.Popen[str], directory: Path) -> Client:
    deadline = time.monotonic() + 30
    while not (directory / "hapticd.command").exists():
        if process.poll() is not None:
            raise HapticdError(f"the daemon does not start: {process.communicate()[1].strip()}")
        if time.monotonic() > deadline:
            raise HapticdError("the daemon was not ready within 30 s")
        time.sleep(0.02)  # it is another process, and what it says last is this file
    return connect(directory)
