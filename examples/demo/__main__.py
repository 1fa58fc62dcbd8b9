"""`python -m examples.demo`: performs, measures, prints the tables, saves the plot; 1 if anything missed its mark."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Mapping
from functools import partial
from pathlib import Path

from rich.console import Console
from rich.progress import Progress, TaskID

from examples.demo import comb, puncture, sandpaper, taps
from examples.demo.marks import Marks
from examples.demo.perform import Recorded, Waypoints, perform, running_daemon
from examples.demo.plot import PLOT, save
from hapticd.base.errors import HapticdError
from hapticd.cli.streams import guarded
from hapticd.client.blocking import Client
from hapticd.config.materials import Materials, shipped_materials


def main() -> int:
    """Runs the demo; its exit code."""
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
            f"{len(taps.SPEEDS_M_PER_S)} taps on each material, {len(comb.WAYS)} strokes over a comb, "
            f"{len(sandpaper.WAYS)} over sandpaper, a puncture"
        )
        with Progress(console=console) as progress:
            recorded = _performed(daemon, progress, library)
        counters = daemon.get_status()["counters"]

    marks = Marks()
    torn, combed, sanded = (recorded.pop(part.MATERIAL) for part in (puncture, comb, sandpaper))
    tapped = {name: taps.measured(each) for name, each in recorded.items()}
    combing = comb.measured(combed, library[comb.MATERIAL])
    sanding = sandpaper.measured(sanded, library[sandpaper.MATERIAL])
    console.print(taps.table(tapped, library, marks))
    console.print(comb.table(combing, combed, library[comb.MATERIAL], marks))
    console.print(sandpaper.table(sanding, library[sandpaper.MATERIAL], rate_hz, marks))
    console.print(puncture.table(torn, library[puncture.MATERIAL], marks))
    save(recorded, tapped, library, combed, combing, sanding, torn)
    console.print(
        f"{counters['ticks']} ticks, {counters['skipped']} periods skipped, {counters['samples_dropped']} samples "
        f"dropped; plot: {PLOT}"
    )
    for line in marks.missed:
        console.print(f"missed: {line}", style="bold red")
    return 1 if marks.missed else 0


def _performed(daemon: Client, progress: Progress, library: Materials) -> dict[str, Recorded]:
    """Everything that is done, by the material that it is done to."""
    parts: dict[str, tuple[Mapping[str, object], Waypoints]] = {}
    floors = {name: taps.tapping() for name, material in library.items() if material.tap is not None}
    for name, path in {**floors, comb.MATERIAL: comb.PATH, sandpaper.MATERIAL: sandpaper.PATH}.items():
        parts[name] = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": name}, path
    parts[puncture.MATERIAL] = puncture.SKIN, puncture.PATH
    recorded: dict[str, Recorded] = {}
    for name, (surface, path) in parts.items():
        task = progress.add_task(name, total=1.0)
        daemon.set_scene({"objects": {"surface": surface}}, wait=True)
        recorded[name] = perform(daemon, path, partial(_advance, progress, task))
    return recorded


def _advance(progress: Progress, task: TaskID, done: float) -> None:
    progress.update(task, completed=done)


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
