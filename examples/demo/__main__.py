"""`python -m examples.demo`: performs, measures, prints the tables, saves the plot; 1 if anything missed its mark."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

from rich.console import Console
from rich.progress import Progress, TaskID

from examples.demo import comb, puncture, sandpaper, taps
from examples.demo.marks import Marks
from examples.demo.perform import Recorded, Unseen, Waypoints, perform, running_daemon
from examples.demo.plot import PLOT, save
from hapticd.base.errors import HapticdError
from hapticd.cli.streams import guarded
from hapticd.client.blocking import Client
from hapticd.config.materials import Materials, shipped_materials

TIMES: Final = 10
"""A part is done at most so often."""


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
            done = _performed(daemon, progress, library)
        counters = daemon.get_status()["counters"]

    marks = Marks()
    (torn, tearing), (combed, combing), (_, sanding) = (done.pop(part.MATERIAL) for part in (puncture, comb, sandpaper))
    recorded = {name: each for name, (each, _) in done.items()}
    tapped = {name: each for name, (_, each) in done.items()}
    console.print(taps.table(tapped, library, marks))
    console.print(comb.table(combing, library[comb.MATERIAL], marks))
    console.print(sandpaper.table(sanding, library[sandpaper.MATERIAL], rate_hz, marks))
    console.print(puncture.table(torn, tearing, library[puncture.MATERIAL], marks))
    save(recorded, tapped, library, combed, combing, sanding, torn)
    console.print(
        f"{counters['ticks']} ticks, {counters['skipped']} periods skipped, {counters['samples_dropped']} samples "
        f"dropped; plot: {PLOT}"
    )
    for line in marks.missed:
        console.print(f"missed: {line}", style="bold red")
    return 1 if marks.missed else 0


@dataclass(frozen=True, slots=True)
class _Part:
    """Something that is done to a surface, and measured."""

    surface: Mapping[str, object]
    path: Callable[[int], Waypoints]
    """Of the first time, the second, ..."""
    measured: Callable[[Recorded], Any]
    joined: Callable[[list[Any]], Any] = lambda found: found[-1]
    """What was measured each time, as one; by default the last."""


def _performed(daemon: Client, progress: Progress, library: Materials) -> dict[str, tuple[Recorded, Any]]:
    """Everything that is done and what was measured of it, by the material that it is done to."""
    parts = {
        name: _Part(_floor(name), taps.tapping, taps.measured)
        for name, material in library.items()
        if material.tap is not None
    }
    parts[comb.MATERIAL] = _Part(
        _floor(comb.MATERIAL), comb.path, partial(comb.measured, material=library[comb.MATERIAL]), comb.joined
    )
    parts[sandpaper.MATERIAL] = _Part(
        _floor(sandpaper.MATERIAL),
        lambda _: sandpaper.PATH,
        partial(sandpaper.measured, material=library[sandpaper.MATERIAL]),
    )
    parts[puncture.MATERIAL] = _Part(puncture.SKIN, lambda _: puncture.PATH, puncture.measured)
    return {name: _done(daemon, progress, name, part) for name, part in parts.items()}


def _floor(material: str) -> dict[str, object]:
    return {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": material}


def _done(daemon: Client, progress: Progress, name: str, part: _Part) -> tuple[Recorded, Any]:
    """Does a part, again where the machine missed so many periods that it cannot be measured. Raises Unseen after some
    times."""
    task = progress.add_task(name, total=1.0)
    found: list[Any] = []
    for time in range(1, TIMES + 1):
        daemon.set_scene({"objects": {"surface": part.surface}}, wait=True)
        daemon.reset()
        recorded = perform(daemon, part.path(time), partial(_advance, progress, task))
        try:
            found.append(part.measured(recorded))
            return recorded, part.joined(found)
        except Unseen as unseen:
            if time == TIMES:
                raise
            progress.update(task, description=f"{name}, again")
            progress.console.print(f"{name}: {unseen}; once more")
    raise AssertionError("it was done or given up")


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
