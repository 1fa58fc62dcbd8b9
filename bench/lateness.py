"""Wake-up lateness and work of the running servo, compared with cyclictest (Debian's rt-tests), in turns.

    python -m bench.lateness RATE_HZ SECONDS SPIN_US       one run of the servo; prints JSON for the benchmark

Servo and cyclictest are each a new process, with one thread at SCHED_FIFO 80, no affinity, all memory locked, woken at
absolute times of CLOCK_MONOTONIC. Both keep the processors out of idle states that are slow to leave
(/dev/cpu_dma_latency).
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.daemon import DEVICE, SCENE
from bench.report import ROOT, Advance, Floats, Options, Section, Table, spread, verdict
from hapticd.base.core import SAMPLE_DTYPE, records
from hapticd.base.errors import HapticdError
from hapticd.config.configuration import load_config
from hapticd.daemon.engine import SAMPLE_CAPACITY, Engine

RATES_HZ = (1000, 4000, 10_000)
SPIN_US = {1000: 100.0, 4000: 100.0, 10_000: 50.0}
"""Spin time by rate. At 10 kHz it is less than the period: the kernel throttles real-time threads that never sleep."""
PRIORITY = 80
PERCENTILES = (50.0, 99.0, 99.9)
SETTLE_S = 0.2
"""Time at the start of a run that is left out, because of page faults of the new process."""


@dataclass(frozen=True, slots=True)
class Run:
    """One run of the servo; lists have a value for each of PERCENTILES."""

    lateness_ns: list[float]
    work_ns: list[float]
    skipped: int
    """Number of missed periods."""
    scheduler: str
    missing: list[str]
    """Privileges that were not granted."""


def lateness_of(samples: np.ndarray[tuple[int], np.dtype[np.void]], rate_hz: float) -> tuple[Floats, int]:
    """Return the lateness of each wake-up in ns, and the number of missed periods.

    A sample has the lateness after the deadline for which it was rendered. Periods missed before it are added, as in
    cyclictest.
    """
    period_ns = 1e9 / rate_hz
    missed = np.rint(np.diff(samples["time_ns"]) / period_ns) - 1
    late: Floats = samples["lateness_ns"][1:] + missed * period_ns
    return late, int(missed.sum())


def servo(rate_hz: float, seconds: float, spin_us: float) -> Run:
    """Run the servo in this process, and read its samples five times a second. Raises HapticdError."""
    settings = {"rate_hz": rate_hz, "spin_us": spin_us, "priority": PRIORITY}
    engine = Engine(load_config({"servo": settings, "device": DEVICE, "scene": SCENE}))
    room = records(SAMPLE_DTYPE, SAMPLE_CAPACITY)
    taken = []
    granted = engine.start()
    try:
        end = time.monotonic() + SETTLE_S + seconds
        while time.monotonic() < end:
            time.sleep(0.2)
            engine.beat()
            count, dropped = engine.read_samples(room)
            if dropped:
                raise RuntimeError(f"{dropped} samples were dropped")
            taken.append(room[:count].copy())
    finally:
        engine.stop()
    samples = np.concatenate(taken)[round(SETTLE_S * rate_hz) :]
    late, skipped = lateness_of(samples, rate_hz)
    return Run(
        np.percentile(late, PERCENTILES).tolist(),
        np.percentile(samples["work_ns"], PERCENTILES).tolist(),
        skipped,
        granted.scheduler,
        list(granted.missing),
    )


def servo_process(rate_hz: float, seconds: float, spin_us: float) -> Run:
    """Run the servo in a separate process. Raises HapticdError."""
    arguments = [sys.executable, "-m", "bench.lateness", str(rate_hz), str(seconds), str(spin_us)]
    return Run(**json.loads(output_of(arguments)))


def output_of(arguments: Sequence[str]) -> str:
    """Run a process and return its output. Raises HapticdError with the last line on stderr if it fails."""
    process = subprocess.run(arguments, cwd=ROOT, capture_output=True, text=True)
    if process.returncode != 0:
        last = (process.stderr.strip().splitlines() or ["no message"])[-1]
        raise HapticdError(f"{' '.join(arguments[1:])} ended with {process.returncode}: {last}")
    return process.stdout


def cyclictest(rate_hz: float, seconds: float) -> list[float]:
    """Run cyclictest and return the PERCENTILES of its latencies in ns."""
    with tempfile.TemporaryDirectory(prefix="hapticd-bench-") as folder:
        path = Path(folder, "cyclictest.json")
        loops = round(rate_hz * (seconds + SETTLE_S))
        arguments = ["-q", "-m", "-N", f"-p{PRIORITY}", "-t1", f"-i{round(1e6 / rate_hz)}", f"-l{loops}"]
        subprocess.run(
            ["cyclictest", *arguments, "-h1000000", f"--json={path}"],
            check=True,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        thread = json.loads(path.read_text(encoding="utf-8"))["thread"]["0"]
    bins = sorted((int(latency), int(count)) for latency, count in thread["histogram"].items())
    latency, count = np.array(bins, dtype=np.float64).T
    # Latencies beyond the histogram count as the largest latency.
    beyond = int(thread["cycles"]) - float(count.sum())
    latency, count = np.append(latency, thread["max"]), np.append(count, max(beyond, 0.0))
    percentiles: list[float] = np.percentile(latency, PERCENTILES, weights=count, method="inverted_cdf").tolist()
    return percentiles


def _us(values: list[float]) -> str:
    return spread(values, ".1f", 1e-3)


def run(options: Options, advance: Advance) -> Section:
    """Measure lateness and work at each rate, and return their section."""
    pairs, seconds = options.few(6, 2), options.few(3, 1)
    spins = options.few(3, 1)
    have = shutil.which("cyclictest") is not None
    runs: dict[int, list[Run]] = {rate: [] for rate in RATES_HZ}
    theirs: dict[int, list[list[float]]] = {rate: [] for rate in RATES_HZ}
    spun: dict[int, list[Run]] = {rate: [] for rate in RATES_HZ}
    total = len(RATES_HZ) * (pairs * (2 if have else 1) + spins)
    done = 0

    def step_done(what: str) -> None:
        nonlocal done
        done += 1
        advance(done / total, what)

    for pair in range(pairs):
        for rate in RATES_HZ:
            # In turns, and each first in half of the pairs.
            for ours in (True, False) if pair % 2 == 0 else (False, True):
                if ours:
                    runs[rate].append(servo_process(rate, seconds, 0.0))
                    step_done(f"servo at {rate} Hz")
                elif have:
                    theirs[rate].append(cyclictest(rate, seconds))
                    step_done(f"cyclictest at {rate} Hz")
    for _ in range(spins):
        for rate in RATES_HZ:
            spun[rate].append(servo_process(rate, seconds, SPIN_US[rate]))
            step_done(f"servo at {rate} Hz with spin")
    first = runs[RATES_HZ[0]][0]
    section = Section("The running servo")
    section.parts.append(
        f"Simulated joystick at rest above a wooden floor, "
        f"{'SCHED_FIFO ' + str(PRIORITY) if first.scheduler == 'fifo' else 'no real-time priority'}"
        f"{', not granted: ' + '; '.join(first.missing) if first.missing else ''}; runs of {seconds:g} s, "
        "without additional load. "
        "Lateness is the time from the deadline to the wake-up, missed periods included. Work is the time from the "
        "wake-up to the force at the device: check for commands and a table, read the device, estimate the velocity, "
        "compute the tick, write the device, and read the clock once."
    )
    section.parts.append(_work(runs, spun))
    if have:
        section.parts.append(_compared(runs, theirs))
        section.parts.append(_ratios(runs, theirs))
    else:
        section.parts.append(
            "**Not measured: wake-up lateness of cyclictest.** It is not installed (Debian: rt-tests). The servo alone:"
        )
        section.parts.append(
            _servo_table("Wake-up lateness, us, without spin", runs, dict.fromkeys(RATES_HZ, 0.0), None)
        )
    section.parts.append(_servo_table("Wake-up lateness, us, with spin", spun, SPIN_US, 1000.0))
    return section


def _work(runs: dict[int, list[Run]], spun: dict[int, list[Run]]) -> Table:
    rows = []
    for name, group in (("", runs), (" with spin", spun)):
        for rate, found in group.items():
            p50, p99, p999 = ([run.work_ns[i] for run in found] for i in range(3))
            cells = [spread(p50, ".0f"), spread(p99, ".0f"), spread(p999, ".0f")]
            rows.append([f"{rate} Hz{name}", str(len(found)), *cells, verdict(float(np.median(p50)), 200.0)])
    return Table(
        "Work of the servo in a tick, ns: median over the runs (10 to 90 %); aim: p50 < 200",
        ["servo", "runs", "p50", "p99", "p99.9", "reached"],
        rows,
    )


def _compared(runs: dict[int, list[Run]], theirs: dict[int, list[list[float]]]) -> Table:
    rows = []
    for rate in RATES_HZ:
        ours = [run.lateness_ns for run in runs[rate]]
        for name, found in (("servo", ours), ("cyclictest", theirs[rate])):
            rows.append([f"{rate} Hz, {name}", *(_us([run[i] for run in found]) for i in range(3))])
    return Table(
        f"Wake-up lateness, us, without spin, {len(runs[RATES_HZ[0]])} interleaved runs of each: median (10 to 90 %)",
        ["", "p50", "p99", "p99.9"],
        rows,
    )


def _ratios(runs: dict[int, list[Run]], theirs: dict[int, list[list[float]]]) -> Table:
    rows = []
    for rate in RATES_HZ:
        ratio = np.array([r.lateness_ns for r in runs[rate]]) / np.array(theirs[rate])
        skipped = sum(run.skipped for run in runs[rate])
        rows.append(
            [
                f"{rate} Hz",
                *(spread(ratio[:, i], ".2f") for i in range(3)),
                verdict(float(np.median(ratio[:, 1])), 1.2),
                str(skipped),
            ]
        )
    return Table(
        "Servo over cyclictest, pair by pair: median (10 to 90 %); aim: p99 at most 1.2",
        ["", "p50", "p99", "p99.9", "reached", "periods missed by the servo, all runs"],
        rows,
    )


def _servo_table(caption: str, runs: dict[int, list[Run]], spin_us: dict[int, float], aim_ns: float | None) -> Table:
    rows = []
    for rate, found in runs.items():
        cells = [_us([run.lateness_ns[i] for run in found]) for i in range(3)]
        p50 = float(np.median([run.lateness_ns[0] for run in found]))
        reached = "" if aim_ns is None else verdict(p50, aim_ns)
        skipped = str(sum(run.skipped for run in found))
        rows.append([f"{rate} Hz, spin {spin_us[rate]:g} us", str(len(found)), *cells, reached, skipped])
    aim = "" if aim_ns is None else f"; aim: p50 < {aim_ns / 1e3:g}"
    return Table(
        f"{caption}: median over the runs (10 to 90 %){aim}",
        ["", "runs", "p50", "p99", "p99.9", "reached", "periods missed"],
        rows,
    )


if __name__ == "__main__":
    found = servo(float(sys.argv[1]), float(sys.argv[2]), float(sys.argv[3]))
    fields = {name: getattr(found, name) for name in Run.__dataclass_fields__}
    print(json.dumps(fields))
