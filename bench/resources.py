"""Cost of a daemon: start-up time, memory, processor time."""

from __future__ import annotations

import compileall
import os
import time
from pathlib import Path

import numpy as np

from bench.daemon import daemon
from bench.report import ROOT, Advance, Options, Section, Table, spread, verdict

RATES_HZ = (1000, 4000, 10_000)


def memory_kib(pid: int) -> dict[str, int]:
    """Return VmRSS, VmHWM and VmLck of a process in KiB: resident, largest and locked memory."""
    lines = Path(f"/proc/{pid}/status").read_text(encoding="utf-8").splitlines()
    pairs = (line.split(":", 1) for line in lines if line.startswith(("VmRSS", "VmHWM", "VmLck")))
    return {name: int(value.split()[0]) for name, value in pairs}


def cpu_s(pid: int) -> tuple[float, float]:
    """Return the processor time of a process so far, and that of its real-time threads, in s."""
    total = servo = 0.0
    for thread in Path(f"/proc/{pid}/task").iterdir():
        fields = (thread / "stat").read_text(encoding="utf-8").rpartition(")")[2].split()
        # schedstat has nanoseconds, stat only clock ticks.
        seconds = int((thread / "schedstat").read_text(encoding="utf-8").split()[0]) / 1e9
        total += seconds
        servo += seconds if int(fields[37]) > 0 else 0.0  # rt_priority
    return total, servo


def run(options: Options, advance: Advance) -> Section:
    """Measure start-up, processor time and memory of daemons, and return the section."""
    starts, seconds = options.few(9, 2), 1.0 if options.quick else 6.0
    compileall.compile_dir(str(ROOT / "hapticd"), quiet=1)  # as in an installed package
    ready, answered = [], []
    for index in range(starts):
        with daemon(rate_hz=10_000) as running:
            ready.append(running.ready_s)
            answered.append(running.answered_s)
        advance(0.3 * (index + 1) / starts, "starts")
    rows = []
    resident = []
    for index, rate in enumerate(RATES_HZ):
        with daemon(rate_hz=rate) as running:
            time.sleep(0.5)
            before, then = cpu_s(running.pid), time.monotonic()
            time.sleep(seconds)
            after, lasted = cpu_s(running.pid), time.monotonic() - then
            memory = memory_kib(running.pid)
        percent = [100 * (b - a) / lasted for a, b in zip(before, after, strict=True)]
        resident.append(memory["VmHWM"] / 1024)
        rows.append(
            [
                f"{rate} Hz",
                f"{percent[0]:.1f}",
                f"{percent[1]:.1f}",
                f"{memory['VmRSS'] / 1024:.1f}",
                f"{memory['VmHWM'] / 1024:.1f}",
                f"{memory['VmLck'] / 1024:.1f}",
                verdict(resident[-1], 80.0),
            ]
        )
        advance(0.3 + 0.7 * (index + 1) / len(RATES_HZ), f"{rate} Hz")
    return Section(
        "Cost of a daemon",
        [
            Table(
                f"Start, s, {starts} starts: median (10 to 90 %); aim: ready < 0.5",
                ["from the start of the process", "s", "reached"],
                [
                    ["to the command socket", spread(ready, ".3f"), verdict(float(np.median(ready)), 0.5)],
                    ["to the first answer", spread(answered, ".3f"), ""],
                ],
            ),
            Table(
                f"Processor time, % of one of {os.cpu_count()}, over {seconds:g} s, without clients; memory, MB, aim "
                "< 80 (locked: address space, of which only used pages are resident)",
                ["servo", "daemon, %", "of it servo thread, %", "resident, MB", "largest, MB", "locked, MB", "reached"],
                rows,
            ),
        ],
    )
