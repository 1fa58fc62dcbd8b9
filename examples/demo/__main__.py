"""`python -m examples.demo`: run the demo, print the tables and save the plot.

The exit code is 1 if a figure is wrong or the daemon failed. The demo reports if too little could be measured because
periods were missed.
"""

from __future__ import annotations

import os
import sys
import tempfile
import warnings
from collections.abc import Mapping
from pathlib import Path

from rich.console import Console
from rich.progress import Progress

from examples.demo import comb, puncture, sandpaper, taps
from examples.demo.marks import Marks
from examples.demo.parts import Seen, all_parts, repeat
from examples.demo.perform import running_daemon
from examples.demo.plot import PLOT, save
from hapticd.base.errors import HapticdError
from hapticd.cli.streams import guarded
from hapticd.config.materials import Materials, shipped_materials
from hapticd.protocol.calls import TelemetryLoss


def main() -> int:
    """Run the demo, and return its exit code."""
    console = Console()
    library = shipped_materials()
    with (
        tempfile.TemporaryDirectory(prefix="hapticd-demo-") as directory,
        running_daemon(Path(directory, "run")) as daemon,
    ):
        status = daemon.get_status()
        realtime = status["realtime"] or {}
        rate_hz = float(status["rate_hz"])
        console.print(
            f"hapticd {status['version']}, {status['device']} at {rate_hz:g} Hz, "
            f"{'SCHED_FIFO' if realtime.get('priority') else 'without real-time rights'}; "
            f"{len(taps.SPEEDS_M_PER_S)} taps on each material, {len(comb.PASSES)} strokes over a comb, "
            f"{len(sandpaper.PASSES)} over sandpaper, a puncture"
        )
        with Progress(console=console) as progress:
            seen = {part.material: repeat(daemon, progress, part) for part in all_parts(library)}
        counters = daemon.get_status()["counters"]

    marks = Marks()
    _compare(console, seen, library, rate_hz, marks)
    skipped, periods = counters["skipped"], counters["skipped"] + counters["ticks"]
    save(seen, library, rate_hz, skipped, periods)
    console.print(f"plot: {PLOT} and {PLOT.with_suffix('.svg').name}", soft_wrap=True)
    missed = f"the machine missed {skipped:,} of {periods:,} periods"
    too_little = [each for each in seen.values() if not each.enough]
    for each in too_little:
        marks.expect(each.disturbed, f"{each}, and no period was missed")
    if disturbed := ", ".join(str(each) for each in too_little if each.disturbed):
        missed = (
            f"not enough seen: {disturbed}; {missed}; real-time rights or a quieter machine help, see hapticd doctor"
        )
    console.print(missed, soft_wrap=True)
    for line in marks.missed:
        console.print(f"wrong: {line}", style="bold red", soft_wrap=True)
    return 1 if marks.missed else 0


def _compare(console: Console, seen: Mapping[str, Seen], library: Materials, rate_hz: float, marks: Marks) -> None:
    """Print the measured figures next to those of the library and of the paper."""
    measured = {name: each.measured for name, each in seen.items() if each.measured is not None}
    if tapped := {name: each for name, each in measured.items() if isinstance(each, taps.Tapped)}:
        console.print(taps.table(tapped, library, marks))
    if comb.MATERIAL in measured:
        console.print(comb.table(measured[comb.MATERIAL], library[comb.MATERIAL], marks))
    if sandpaper.MATERIAL in measured:
        console.print(sandpaper.table(measured[sandpaper.MATERIAL], library[sandpaper.MATERIAL], rate_hz, marks))
    if puncture.MATERIAL in measured:
        console.print(puncture.table(measured[puncture.MATERIAL], library[puncture.MATERIAL], marks))


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    warnings.simplefilter("ignore", TelemetryLoss)  # a performance that lost samples is repeated
    try:
        with guarded():
            code = main()
            sys.stdout.flush()
        sys.exit(code)
    except HapticdError as problem:
        print(f"hapticd demo: {problem}", file=sys.stderr)
        sys.exit(1)
