"""What a sweep costs beside its points: dask against bare processes, plans, growth with points and workers.

python -m bench.sweeps --bare STUDY INDEX COUNT     computes each COUNT-th point of a study, and keeps nothing
python -m bench.sweeps --plan STUDY                 plans a study; prints seconds and megabytes
"""

from __future__ import annotations

import json
import pickle
import resource
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from bench.report import ROOT, Advance, Options, Section, Table, spread, verdict
from hapticd.sweeps.cluster import client_of, processors
from hapticd.sweeps.plan import Plan
from hapticd.sweeps.store import PIECES
from hapticd.sweeps.study import load_sweep
from hapticd.sweeps.task import packed, task
from hapticd.sweeps.worker_check import code_version

POINT_S = 0.05
WORKERS = (1, 2, 4, 8)
_PIECE = 100
"""Points of the piece whose bytes are counted."""


def study(folder: Path, name: str, count: int, duration_s: float | None = None) -> Path:
    """A study of taps on the seven materials over the mass of the hand; without a duration one of cheap points, whose
    margin of stability alone is computed."""
    file = folder / f"{name}.yaml"
    masses = {"device.sim.hand.mass_kg": {"low": 0.01, "high": 0.1, "count": count}}
    shared: dict[str, Any] = {"base": "materials", "vary": masses}
    if duration_s is None:
        file.write_text(json.dumps({**shared, "measure": ["stability_factor"]}))
    else:
        run = {"operator": "taps", "duration_s": duration_s, "measure": ["peak_force_n"]}
        file.write_text(json.dumps({**shared, **run}))
    return file


def compute(file: Path, index: int, count: int) -> None:
    """Each `count`-th point of a study, from `index` on."""
    plan = load_sweep(str(file))
    plan.piece(np.arange(index, len(plan.ids), count)).rows()


def _python(*words: str) -> list[str]:
    return [sys.executable, *words]


def bare(file: Path, count: int) -> float:
    """Seconds that so many processes without dask take for a study."""
    begin = perf_counter()
    started = [
        subprocess.Popen(_python("-m", "bench.sweeps", "--bare", str(file), str(index), str(count)), cwd=ROOT)
        for index in range(count)
    ]
    if any(process.wait() for process in started):
        raise RuntimeError("a process without dask failed")
    return perf_counter() - begin


def command(file: Path, workers: int) -> float:
    """Seconds that `hapticd sweep run` takes for a study."""
    with tempfile.TemporaryDirectory() as folder:
        begin = perf_counter()
        words = ("-m", "hapticd", "sweep", "run", str(file), "-o", folder, "--workers", str(workers), "--json")
        told = subprocess.run(_python(*words), cwd=ROOT, stdout=subprocess.PIPE, check=True).stdout
        took_s = perf_counter() - begin
    if json.loads(told)["failed"]:
        raise RuntimeError("points failed")
    return took_s


def _duration_s(folder: Path) -> float:
    """How long is simulated, so that a point takes POINT_S here."""

    def cost_s(duration_s: float) -> float:
        plan = load_sweep(str(study(folder, "probe", 6, duration_s)))
        plan.piece(np.arange(1)).rows()
        begin = perf_counter()
        plan.piece(np.arange(1, 6)).rows()
        return (perf_counter() - begin) / 5

    short, long = cost_s(4.0), cost_s(12.0)
    return round(4.0 + max(0.0, POINT_S - short) * 8.0 / max(long - short, 1e-6), 1)


def _speed(folder: Path, options: Options, advance: Advance) -> Table:
    points, rounds = options.few(2000, 40), options.few(3, 1)
    file = study(folder, "speed", points, _duration_s(folder))
    found: dict[str, list[float]] = {}
    runs = {
        "bare, two processes": lambda: bare(file, 2),
        "sweep run, two processes": lambda: command(file, 2),
        "sweep run, one process": lambda: command(file, 1),
        "bare, one process": lambda: bare(file, 1),
    }
    for index in range(rounds):
        for number, (name, each) in enumerate(runs.items()):
            advance(0.85 * (index * len(runs) + number) / (rounds * len(runs)), name)
            found.setdefault(name, []).append(each())
    one, two, bare_one, bare_two = (
        np.array(found[name])
        for name in ("sweep run, one process", "sweep run, two processes", "bare, one process", "bare, two processes")
    )
    rows = [[name, spread(each, ".1f"), "", ""] for name, each in found.items()]
    ratios = (
        ("speed-up by the second process", one / two, 1.9, True),
        ("the same of bare processes: what the machine gives", bare_one / bare_two, None, True),
        ("engine over bare, two processes", two / bare_two, 1.05, False),
        ("engine over bare, one process", one / bare_one, 1.05, False),
    )
    for name, ratio, aim, above in ratios:
        judged = "" if aim is None else verdict(float(np.median(ratio)), aim, above=above)
        rows.append([name, spread(ratio, ".3f"), "" if aim is None else f"{'>' if above else '<='} {aim}", judged])
    caption = f"{points} points of {POINT_S:g} s, whole commands, {rounds} rounds in turns, s: median (10 to 90 %)"
    return Table(caption, ("way", "s, or ratio", "aim", "reached"), rows)


def _plans(folder: Path, options: Options) -> Table:
    each = options.few(1000, 100)
    mass, grip = "device.sim.hand.mass_kg", "device.sim.hand.damping_n_s_per_m"
    span = {"low": 0.01, "high": 0.1}
    crossed = {mass: {**span, "count": each}, grip: {**span, "count": each}}
    drawn = {"vary": {mass: span, grip: span, "servo.rate_hz": {"low": 1000.0, "high": 10000.0}}}
    studies: dict[str, dict[str, Any]] = {
        "crossed, two keys": {"vary": crossed},
        "Latin hypercube, three keys": {**drawn, "combine": "latin_hypercube", "count": each**2, "seed": 1},
    }
    rows = []
    for name, keys in studies.items():
        file = folder / "plan.yaml"
        file.write_text(json.dumps({"base": "materials", "measure": ["stability_factor"], **keys}))
        told = subprocess.run(
            _python("-m", "bench.sweeps", "--plan", str(file)), cwd=ROOT, stdout=subprocess.PIPE, check=True, text=True
        ).stdout.split()
        seconds, megabytes = map(float, told)
        rows.append([name, f"{seconds:.1f}", verdict(seconds, 10.0), f"{megabytes:.0f}", verdict(megabytes, 500.0)])
    return Table(f"Plans of {each**2:,} points", ("plan", "s", "<= 10", "MB, all of the process", "<= 500"), rows)


def _growth(folder: Path, options: Options, advance: Advance) -> Table:
    counts = options.few(3, 2)
    points = [10 ** (1 + each) for each in range(counts + 1)]
    files = [study(folder, f"cheap{count}", count) for count in points]
    rows = []
    for number, workers in enumerate(WORKERS):
        advance(0.9 + 0.07 * number / len(WORKERS), f"{workers} workers")
        rows.append([str(workers), *(f"{command(file, workers):.2f}" for file in files)])
    return Table(
        "Whole commands of cheap points (a stability margin each) by processes and points, s",
        ("processes", *(f"{count:,} points" for count in points)),
        rows,
    )


def _pieces(plan: Plan, options: Options, on_disk: str) -> Table:
    """How many pieces a second scheduler and client pass on, and what they weigh."""
    count = options.few(2000, 100)
    content, version = packed(plan.piece(np.arange(1))), code_version()
    rows = []
    for workers in (2, 8):
        with client_of(None, workers, False) as client:
            client.gather([client.submit(task, content, version, pure=False) for _ in range(100)])
            begin = perf_counter()
            client.gather([client.submit(task, content, version, pure=False) for _ in range(count)])
            rows.append(
                [f"pieces of one cheap point a second, {workers} workers", f"{count / (perf_counter() - begin):.0f}"]
            )
    piece = plan.piece(np.arange(_PIECE))
    rows.append([f"bytes of a piece of {_PIECE} points", f"{len(packed(piece)):,}"])
    rows.append(
        [f"bytes of its rows on the way back, each of {_PIECE}", f"{len(pickle.dumps(piece.rows())) / _PIECE:.0f}"]
    )
    rows.append([f"bytes of a row on disk, of {len(plan.ids)}", on_disk])
    return Table(
        f"Pieces as they are sent, {count} of them; all processes on {processors()} processors", ("what", ""), rows
    )


def _file_bytes(file: Path) -> str:
    with tempfile.TemporaryDirectory() as folder:
        words = ("-m", "hapticd", "sweep", "run", str(file), "-o", folder, "--threads", "--json")
        points = json.loads(subprocess.run(_python(*words), cwd=ROOT, stdout=subprocess.PIPE, check=True).stdout)[
            "points"
        ]
        return f"{sum(each.stat().st_size for each in (Path(folder) / PIECES).iterdir()) / points:.0f}"


def run(options: Options, advance: Advance) -> Section:
    """Speed-up, overhead, plans, growth, pieces."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        speed = _speed(folder, options, advance)
        advance(0.86, "plans")
        plans = _plans(folder, options)
        growth = _growth(folder, options, advance)
        advance(0.98, "pieces")
        cheap = study(folder, "cheap", options.few(1000, 200))
        pieces = _pieces(load_sweep(str(cheap)), options, _file_bytes(cheap))
    about = (
        "Whole commands from their start to their end, so that starting and ending processes is in them. *Bare* are "
        "processes without dask that compute the same points, every second one each, and keep nothing."
    )
    return Section("Sweeps", [about, speed, plans, growth, pieces])


def main(arguments: Sequence[str]) -> None:
    """What a process of its own measures."""
    if arguments[0] == "--bare":
        compute(Path(arguments[1]), int(arguments[2]), int(arguments[3]))
    else:
        begin = perf_counter()
        load_sweep(arguments[1])
        print(perf_counter() - begin, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)


if __name__ == "__main__":
    main(sys.argv[1:])
