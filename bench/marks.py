"""What marks cost the servo: its work and its lateness while none, ten and a thousand of them a second are left."""

from __future__ import annotations

import time

import numpy as np
import zmq

from bench.daemon import call, daemon, dealer
from bench.lateness import lateness_of
from bench.report import Advance, Floats, Options, Section, Table, spread
from bench.samples import SampleReader

RATE_HZ = 10_000
PER_S = (0, 10, 1000)
"""Marks a second that are asked for; a thousand are as many as one client gets answered."""

_PERCENTILES = (50, 99, 99.9)


def _marked(client: zmq.Socket[bytes], per_s: int, seconds: float) -> list[int]:
    """Leaves marks, evenly as far as they are answered in time; the ticks that took them."""
    ticks: list[int] = []
    begin = time.monotonic()
    while (now := time.monotonic() - begin) < seconds:
        due = (len(ticks) + 1) / per_s if per_s else seconds
        if now < due:
            time.sleep(min(due, seconds) - now)
        if per_s:
            ticks.append(int(str(call(client, "mark", {"text": "trial", "data": {"number": len(ticks)}})["tick"])))
    return ticks


def run(options: Options, advance: Advance) -> Section:
    """The table of it."""
    parts, seconds = options.few(10, 2), options.few(3, 1)
    work: dict[int, list[Floats]] = {per_s: [] for per_s in PER_S}
    late: dict[int, list[Floats]] = {per_s: [] for per_s in PER_S}
    missed, marks = dict.fromkeys(PER_S, 0), dict.fromkeys(PER_S, 0)
    more: list[float] = []
    with daemon(rate_hz=RATE_HZ) as running, dealer(running.paths.command_endpoint) as client:
        for part in range(parts):
            for place, per_s in enumerate(PER_S):
                reader = SampleReader(running.paths.telemetry_endpoint)
                ticks = _marked(client, per_s, seconds)
                samples = reader.until(int(str(call(client, "get_status")["tick"])))
                lateness, skipped = lateness_of(samples, RATE_HZ)
                work[per_s].append(np.percentile(samples["work_ns"], _PERCENTILES))
                late[per_s].append(np.percentile(lateness, _PERCENTILES))
                missed[per_s] += skipped
                marks[per_s] += len(ticks)
                if per_s == max(PER_S):
                    took = np.isin(samples["tick"], ticks)
                    more.append(float(np.median(samples["work_ns"][took]) - np.median(samples["work_ns"][~took])))
                advance((part + (place + 1) / len(PER_S)) / parts, f"{per_s} marks a second")
    rows = [
        [
            f"{per_s:,} marks/s",
            f"{marks[per_s] / (parts * seconds):,.0f}",
            *(spread([each[place] for each in work[per_s]], ".0f") for place in range(2)),
            *(spread([each[place] for each in late[per_s]], ".1f", 1e-3) for place in range(2)),
            f"{missed[per_s]:,}",
        ]
        for per_s in PER_S
    ]
    return Section(
        "Marks",
        [
            f"The whole daemon at {RATE_HZ} Hz over a wooden floor, {parts} runs of {seconds} s of each kind in turns, "
            "one client that leaves marks with data and one thread of it that reads all samples.",
            Table(
                f"Servo, {parts} runs: median of the runs (10 to 90 %)",
                ["asked for", "taken a second", "work p50, ns", "p99, ns", "lateness p50, us", "p99, us", "missed"],
                rows,
            ),
            f"A tick that takes a mark works {spread(more, '.0f')} ns longer than one that takes none (medians of the "
            f"ticks of one run at {max(PER_S):,} marks a second).",
        ],
    )
