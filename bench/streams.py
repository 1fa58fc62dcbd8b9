"""Streamed forces, 1,000 a second: losses, latency from a message to the tick that uses it, and processor time.

The sender is another process. Its forces are points of a circle, with large distances between successive points. The
servo changes the force in straight lines: the point at which the line of a tick meets the circle is the message of this
tick. So each message is found in the samples, independent of counters. Its time is CLOCK_MONOTONIC before `send`; the
time of a tick is the wake-up of the servo, deadline plus lateness.

    python -m bench.streams --send ENDPOINT COUNT FILE      the sender; writes its times into FILE
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import zmq

from bench.daemon import Running, call, daemon, dealer
from bench.report import ROOT, Advance, Options, Section, Table, verdict
from bench.resources import cpu_s
from bench.samples import SampleReader
from hapticd.base.errors import HapticdError
from hapticd.protocol import streams

RATE_HZ = 10_000
RATE_PER_S = 1000
"""Number of messages per second."""
CIRCLE_N = 0.02
POINTS = 64
STRIDE = 25
"""Number of points from one message to the next. In a tick the force moves far less than the ramp allows."""
TIMEOUT_S = 0.02
RAMP_S = 0.02

Times = npt.NDArray[np.int64]


# ---- The sender ------------------------------------------------------------------------------------------------------


def send(endpoint: str, count: int, file: str) -> None:
    """Stream `count` forces, a thousand a second, and save the time in ns at which each was sent."""
    times = np.zeros(count, np.int64)
    angles = 2 * math.pi * STRIDE / POINTS * np.arange(POINTS)
    forces_n = (CIRCLE_N * np.column_stack([np.cos(angles), np.sin(angles)])).tolist()
    with zmq.Context() as context, context.socket(zmq.DEALER) as socket:
        socket.connect(endpoint)
        call(socket, "get_status")
        begin = time.monotonic_ns() + 10_000_000
        for seq in range(count):
            wait_s = 1e-9 * (begin + seq * 1_000_000_000 // RATE_PER_S - time.monotonic_ns())
            if wait_s > 0:
                time.sleep(wait_s)
            times[seq] = time.monotonic_ns()
            socket.send(streams.write("force", seq, *forces_n[seq % POINTS]))
        call(socket, "get_status")  # waits until the daemon has received all messages
    np.save(file, times)


# ---- Measurement -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Minute:
    """Results of one stream of forces."""

    counted: dict[str, int]
    latency_us: npt.NDArray[np.float64]
    """Latency of each message that is found in the samples."""
    interval_us: npt.NDArray[np.float64]
    """Time between two messages at the sender."""
    command_us: float
    """Processor time that a message adds to the threads of the daemon other than the servo."""
    missed: int
    """Number of periods that the servo missed."""


def _counted(client: zmq.Socket[bytes]) -> dict[str, int]:
    status: dict[str, dict[str, int]] = call(client, "get_status")["streams"]  # type: ignore[assignment]
    return status["force"]


def _python_s(pid: int) -> tuple[float, float]:
    """Return the processor time of the daemon's threads except the servo, and the time of this reading, in s."""
    total, servo = cpu_s(pid)
    return total - servo, time.monotonic()


def aims(force_n: npt.NDArray[np.float64]) -> npt.NDArray[np.int64]:
    """Return the point to which the force moves in each tick except the first; -1 if it rests, or fades to zero."""
    begin, step = force_n[:-1], np.diff(force_n, axis=0)
    size = np.hypot(step[:, 0], step[:, 1])
    moves = size > 1e-9
    along = step / np.where(moves, size, 1.0)[:, None]
    ahead = (begin * along).sum(axis=1)
    aside = begin[:, 0] * along[:, 1] - begin[:, 1] * along[:, 0]
    moves &= (np.abs(aside) > 1e-9) | (ahead >= 0.0)
    # The point at which the line from a point inside meets the circle.
    distance = -ahead + np.sqrt(np.maximum(0.0, ahead**2 - (begin**2).sum(axis=1) + CIRCLE_N**2))
    to = begin + distance[:, None] * along
    place = np.rint(np.arctan2(to[:, 1], to[:, 0]) / (2 * math.pi) * POINTS).astype(np.int64) % POINTS
    return np.where(moves, place * pow(STRIDE, -1, POINTS) % POINTS, -1)


def latencies(sent_ns: Times, samples: np.ndarray[tuple[int], np.dtype[np.void]], last: int) -> npt.NDArray[np.float64]:
    """Return the latency in us of each used message. `last` is the number of the last used message."""
    to = aims(samples["contact_force_n"])
    at = np.flatnonzero(to >= 0)
    at = at[np.concatenate([[True], to[at[1:]] != to[at[:-1]]])]
    woke_ns = (samples["time_ns"] + samples["lateness_ns"])[at + 1]
    # The first used message is one of the first POINTS, and each later one is at most POINTS after the one before.
    message = to[at[0]] + np.concatenate([[0], np.cumsum((np.diff(to[at]) - 1) % POINTS + 1)])
    if message[-1] != last:
        raise HapticdError(f"the samples show message {message[-1]:,} as the last one, not {last:,}")
    latency_us: npt.NDArray[np.float64] = (woke_ns - sent_ns[message]) / 1e3
    return latency_us


def minute(running: Running, client: zmq.Socket[bytes], seconds: float) -> Minute:
    """Measure one stream, from its first message to the end of its force."""
    before = _counted(client)
    skipped = call(client, "get_status")["counters"]["skipped"]  # type: ignore[index]
    reader = SampleReader(running.paths.telemetry_endpoint)
    count = int(seconds * RATE_PER_S)
    idle_s, idle_since_s = _python_s(running.pid)
    time.sleep(min(seconds, 5.0))
    idle_s, idle_since_s = (b - a for a, b in zip((idle_s, idle_since_s), _python_s(running.pid), strict=True))
    with tempfile.TemporaryDirectory(prefix="hapticd-bench-") as folder:
        file = os.path.join(folder, "sent.npy")
        used_s, since_s = _python_s(running.pid)
        words = ["-m", "bench.streams", "--send", running.paths.command_endpoint, str(count), file]
        if subprocess.run([sys.executable, *words], cwd=ROOT, check=False).returncode != 0:
            raise HapticdError("the sender failed")
        used_s, since_s = (b - a for a, b in zip((used_s, since_s), _python_s(running.pid), strict=True))
        sent_ns: Times = np.load(file)
    time.sleep(TIMEOUT_S + 2 * RAMP_S)
    after = _counted(client)
    status = call(client, "get_status")
    samples = reader.until(int(str(status["tick"])))
    return Minute(
        {name: after[name] - before[name] for name in after if name not in ("active", "seq", "tick")},
        latencies(sent_ns, samples[samples["tick"] <= after["tick"]], after["seq"]),
        np.diff(sent_ns) / 1e3,
        1e6 * (used_s - idle_s / idle_since_s * since_s) / count,
        status["counters"]["skipped"] - skipped,  # type: ignore[index]
    )


# ---- The section -----------------------------------------------------------------------------------------------------


def _percentiles(values: npt.NDArray[np.float64]) -> list[str]:
    return [*(f"{np.percentile(values, percent):,.0f}" for percent in (50, 99, 99.9)), f"{values.max():,.0f}"]


def run(options: Options, advance: Advance) -> Section:
    """Measure a stream, and return the section."""
    seconds = options.few(60, 3)
    with daemon(rate_hz=RATE_HZ) as running, dealer(running.paths.command_endpoint) as client:
        found = minute(running, client, seconds)
    advance(1.0, "a minute")
    counted = found.counted
    p99 = float(np.percentile(found.latency_us, 99))
    return Section(
        "Streams",
        [
            f"A daemon at {RATE_HZ} Hz. Another process streams forces on a circle, {RATE_PER_S:,} a second "
            f"for {seconds} s. The latency is the time from `send` to the wake-up of the tick that took the message. "
            "The samples show which message a tick took, because each force is another point of the circle.",
            Table(
                f"What became of {seconds * RATE_PER_S:,} messages",
                [
                    "received",
                    "lost",
                    "late",
                    "refused",
                    "used",
                    "superseded",
                    "time-outs of the stream",
                    "seen in the samples",
                    "periods missed",
                ],
                [
                    [
                        *(f"{counted[name]:,}" for name in ("received", "lost", "late", "refused")),
                        *(f"{counted[name]:,}" for name in ("used", "superseded", "timeouts")),
                        f"{len(found.latency_us):,}",
                        f"{found.missed:,}",
                    ]
                ],
            ),
            Table(
                "Latency and interval, us",
                ["", "p50", "p99", "p99.9", "worst", "aim, reached"],
                [
                    ["from send to the tick", *_percentiles(found.latency_us), f"p99 < 1,000: {verdict(p99, 1000)}"],
                    ["between two messages, as sent", *_percentiles(found.interval_us), ""],
                ],
            ),
            f"A message takes {found.command_us:.1f} us of processor time in the daemon, including the wake-up of the "
            f"command thread: {found.command_us * RATE_PER_S / 1e4:.1f} % of a processor at {RATE_PER_S:,} messages a "
            "second.",
        ],
    )


if __name__ == "__main__":
    send(sys.argv[2], int(sys.argv[3]), sys.argv[4])
