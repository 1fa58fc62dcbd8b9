"""`make bench`, or `python -m bench [NAMES...] [--quick]`; `--help` says more."""

from __future__ import annotations

import argparse
import os
import platform
import shutil
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from bench import (
    closed_loop,
    command,
    crowd,
    displayed,
    features,
    lateness,
    link,
    offline,
    resources,
    telemetry,
    tick,
    velocity,
)
from bench.report import ROOT, Advance, Options, Section, Table, machine
from hapticd.errors import HapticdError

BENCHMARKS = ROOT / "docs" / "benchmarks.md"
ACCURACY = ROOT / "docs" / "accuracy.md"
DEVICES = ROOT / "docs" / "devices.md"


def _velocity(options: Options, advance: Advance) -> Section:
    """The estimators side by side: bench/velocity.py."""
    rate_hz, step_m = 10_000.0, 20e-6
    if shutil.which("cc") is None and shutil.which("gcc") is None:
        return Section("Velocity estimators", ["**Not measured:** no C compiler to build the other estimators with."])
    with tempfile.TemporaryDirectory(prefix="hapticd-bench-") as folder:
        advance(0.02, "compiling")
        library = velocity.Library(folder)
        estimators = library.line_up()
        count = 20_000
        paths = {
            name: velocity.quantise(path + 1.23e-6, step_m) for name, path in velocity.motions(rate_hz, count).items()
        }
        interval_s = np.full(count, 1.0 / rate_hz)
        errors, costs = [], []
        for index, (name, estimate) in enumerate(estimators.items()):
            cells = [velocity.constant(estimate, rate_hz, step_m)]
            cells += [velocity.contact(estimate, rate_hz, step_m, a) for a in (1.0, 3.0, 10.0)]
            cells.append(velocity.impact(estimate, rate_hz, step_m))
            errors.append([name, *(" / ".join(cell.split()) for cell in cells)])
            taken = [velocity.cost_ns(estimate, step_m, interval_s, path) for path in paths.values()]
            costs.append([name, *(f"{value:.0f}" for value in taken)])
            advance(0.1 + 0.9 * (index + 1) / len(estimators), name)
        width = velocity.widths(library, rate_hz, step_m)
    heads = ["constant: median / 99 % / worst, %", *(f"{a} m/s^2: mean / rms, mm/s" for a in (1, 3, 10))]
    return Section(
        "Velocity estimators",
        [
            f"{velocity.TRIALS} seeded trials of two axes at {rate_hz:.0f} Hz, positions rounded to {1e6 * step_m:g} "
            "um: constant speeds of 0.05 to 0.5 m/s, at contact while slowing down, and after an impact from 0.3 to "
            "-0.15 m/s (samples until within 0.045 m/s, median and worst; rms from 1 to 10 ms after, mm/s).",
            Table("Error against the true speed", ["estimator", *heads, "impact: samples / worst / rms"], errors),
            f"Half the width of the set of speeds that the samples allow, at constant speed, mm/s, median: {width}.",
            Table("ns an update of both axes, median of 7 runs, compiled with -O2", ["estimator", *paths], costs),
        ],
    )


MEASUREMENTS: dict[str, tuple[str, Callable[[Options, Advance], Section]]] = {
    "tick": ("work per tick, the estimator, subnormal numbers", tick.run),
    "features": ("each feature of a surface and each ringing mode: cost and error", features.run),
    "crowd": ("1 to 10,000 objects, and compiling them", crowd.run),
    "offline": ("render and simulate, ticks a second", offline.run),
    "servo": ("lateness and work of the running servo beside cyclictest", lateness.run),
    "command": ("command round trip beside a bare echo", command.run),
    "telemetry": ("ten subscribers, one dead", telemetry.run),
    "resources": ("start, memory, processor time", resources.run),
    "loop": ("closed-loop error against the cost of the tick", closed_loop.run),
    "displayed": ("what the handle makes of a strike, compensated or not, and what a tail costs", displayed.run),
    "link": ("links of 1000, 500 and 250 Hz: stability, and error of each material", link.run),
    "velocity": ("velocity estimators: error and cost", _velocity),
}


def _parser() -> argparse.ArgumentParser:
    defaults = Options()
    names = "\n".join(f"  {name:10s} {what}" for name, (what, _) in MEASUREMENTS.items())
    parser = argparse.ArgumentParser(
        prog="python -m bench",
        description="Measures speed and error. A whole run writes docs/benchmarks.md and docs/accuracy.md; link writes "
        "its tables into docs/devices.md too.",
        epilog=f"names:\n{names}\n  accuracy   what is rendered and the closed loop, against references; writes "
        "docs/accuracy.md",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help="what to measure [default: everything]")
    parser.add_argument("--quick", action="store_true", help="a minute or two: shows that it runs, writes nothing")
    parser.add_argument("--pairs", type=int, default=defaults.pairs, help="paired runs beside cyclictest at each rate")
    parser.add_argument("--seconds", type=float, default=defaults.seconds, help="length of each of them")
    parser.add_argument("--minute", type=float, default=defaults.minute_s, help="seconds of the telemetry run")
    parser.add_argument("--load", type=int, default=0, help="busy processes beside the servo's runs")
    parser.add_argument("--out", type=Path, help="where the report goes [default: docs/benchmarks.md, of a whole run]")
    return parser


def _measure(console: Console, names: list[str], options: Options) -> tuple[list[Section], list[Section]]:
    """Sections on speed and on accuracy, shown as they come."""
    speed: list[Section] = []
    exact: list[Section] = []
    columns = (TextColumn("{task.description:40}"), BarColumn(), TimeElapsedColumn())
    for name in names:
        # Redrawing is work beside what is measured.
        with Progress(*columns, console=console, transient=True, refresh_per_second=1) as progress:
            task = progress.add_task(name, total=1.0)

            def advance(part: float, what: str, name: str = name, progress: Progress = progress) -> None:
                progress.update(task, completed=part, description=f"{name}: {what}")  # noqa: B023

            if name == "accuracy":
                found = closed_loop.accuracy(options, advance)
                exact += found
            else:
                found = [MEASUREMENTS[name][1](options, advance)]
                speed += found
                if name == "link" and not options.quick:
                    link.write_into(DEVICES, found[0])
        for section in found:
            section.show(console)
    return speed, exact


def _write(path: Path, title: str, about: str, sections: list[Section]) -> None:
    text = "\n\n".join([f"# {title}", about, *(section.markdown() for section in sections)])
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text + "\n", encoding="utf-8")


def main() -> int:
    """Runs what was asked for; the exit code."""
    parser = _parser()
    arguments = parser.parse_args()
    known = [*MEASUREMENTS, "accuracy"]
    for name in arguments.names:
        if name not in known:
            parser.error(f"there is no {name}: choose from {', '.join(known)}")
    names = [name for name in known if name in arguments.names] or known
    options = Options(
        pairs=arguments.pairs,
        seconds=arguments.seconds,
        minute_s=arguments.minute,
        load=arguments.load,
        quick=arguments.quick,
    )
    on = machine()
    console = Console(width=None if sys.stdout.isatty() else 160)
    console.print(on, markup=False, highlight=False)
    try:
        speed, exact = _measure(console, names, options)
    except HapticdError as error:
        print(f"bench: {error}", file=sys.stderr)
        return 1
    out = arguments.out or (BENCHMARKS if names == known and not options.quick else None)
    if out is not None and speed:
        about = (
            f"Written by `make bench`; ratios are of one run. {on} "
            f"Processors and other guests of the machine are shared, so that medians and ratios count, not the tails; "
            "a figure is the median over repetitions, and in brackets the tenth to the ninetieth percentile of them."
        )
        _write(out, "Benchmarks", about, speed)
        console.print(f"written: {out}", highlight=False)
    if exact and not options.quick:
        about = (
            "Written by `python -m bench accuracy` (a part of `make bench`); nothing in it depends on the machine's "
            f"speed. Computed on {platform.machine()}, {os.uname().sysname}. Asserted, with margins, in "
            "`tests/unit/test_modes.py`, `tests/unit/test_contacts.py`, `tests/unit/test_sim.py` and "
            "`tests/unit/test_closed_loop.py`."
        )
        _write(ACCURACY, "Accuracy", about, exact)
        console.print(f"written: {ACCURACY}", highlight=False)
    return 0


if __name__ == "__main__":
    sys.exit(main())
