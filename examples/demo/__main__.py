"""`python -m examples.demo`: performs, measures, prints the tables, saves the plot; 1 if anything missed its mark."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path

from rich.console import Console
from rich.progress import Progress

from examples.demo import comb, puncture, sandpaper, taps
from examples.demo.marks import Marks
from examples.demo.perform import Part, Recorded, perform, running_daemon
from examples.demo.plot import PLOT, save
from hapticd.base.errors import HapticdError
from hapticd.cli.streams import guarded
from hapticd.client.blocking import Client
from hapticd.config.materials import shipped_materials


def main() -> int:
    """Runs the demo; its exit code."""
    console = Console()
    library = shipped_materials()
    tapped = [name for name, material in library.items() if material.tap is not None]
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
            f"{len(taps.SPEEDS_M_PER_S)} taps on each material, {len(comb.STROKES)} strokes over a comb, "
            f"{len(sandpaper.STROKES)} times {sandpaper.STROKED_S:g} s over sandpaper, a puncture"
        )
        with Progress(console=console) as progress:
            recorded = _performed(daemon, progress, tapped)
        counters = daemon.get_status()["counters"]

    marks = Marks()
    torn = recorded.pop(puncture.MATERIAL)
    combed = recorded.pop(comb.MATERIAL)
    sanded = recorded.pop(sandpaper.MATERIAL)
    fits = {name: taps.fitted(each, library[name]) for name, each in recorded.items()}
    combing = comb.measured(combed, library[comb.MATERIAL])
    sanding = sandpaper.measured(sanded, library[sandpaper.MATERIAL], rate_hz)
    console.print(taps.table(recorded, fits, library, marks))
    console.print(comb.table(combing, library[comb.MATERIAL], marks))
    console.print(sandpaper.table(sanding, library[sandpaper.MATERIAL], marks))
    console.print(puncture.table(torn, library[puncture.MATERIAL], marks))
    save(recorded, fits, library, combed, combing, sanding, torn)
    console.print(
        f"{counters['ticks']} ticks, {counters['skipped']} periods skipped, {counters['samples_dropped']} samples "
        f"dropped; plot: {PLOT}"
    )
    for line in marks.missed:
        console.print(f"missed: {line}", style="bold red")
    return 1 if marks.missed else 0


def _performed(daemon: Client, progress: Progress, tapped: Iterable[str]) -> dict[str, Recorded]:
    """Everything that is done, by the material that it is done to."""
    recorded: dict[str, Recorded] = {}

    def part(name: str, objects: Mapping[str, Mapping[str, object]], waypoints: list[list[float]]) -> None:
        task = progress.add_task(name, total=1.0)
        daemon.set_scene({"objects": objects}, wait=True)
        recorded[name] = perform(daemon, waypoints, Part(progress, task))

    def floor(name: str) -> dict[str, dict[str, object]]:
        return {"floor": {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": name}}

    for name in tapped:
        part(name, floor(name), taps.tapping(taps.SPEEDS_M_PER_S))
    part(comb.MATERIAL, floor(comb.MATERIAL), comb.stroking())
    part(sandpaper.MATERIAL, floor(sandpaper.MATERIAL), sandpaper.stroking())
    part(puncture.MATERIAL, {"skin": puncture.SKIN}, puncture.pressing())
    return recorded


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        with guarded():
            code = main()
            sys.stdout.flush()
        sys.exit(code)
    except HapticdError as problem:
        print(f"hapticd demo: {problem}", file=sys.stderr)
        sys.exit(1)
