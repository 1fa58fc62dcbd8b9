"""The parts of the demo: a motion on a surface, repeated until there is enough to measure."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

from rich.progress import Progress

from examples.demo import comb, puncture, sandpaper, taps
from examples.demo.perform import Disturbed, Recorded, Waypoints, joined, perform
from hapticd.client.blocking import Client
from hapticd.config.materials import Materials

MAX_REPETITIONS: Final = 10
"""Maximum number of repetitions of a part, if there is too little to measure."""


@dataclass(frozen=True, slots=True)
class Part:
    """A motion on a surface, and its measurement."""

    material: str
    surface: Mapping[str, object]
    path: Waypoints
    measured: Callable[[Recorded], Any]
    minimum: int
    """Minimum count of the measurement, in `unit`."""
    unit: str
    """What is counted: taps, strikes, strokes or ruptures."""


@dataclass(slots=True)
class Seen:
    """The measurements of all repetitions of a part."""

    part: Part
    measured: Any = None
    """None if every repetition was disturbed."""
    best: tuple[Any, Any] = (None, None)
    """The repetition with the largest count, as a Recorded, and its measurement."""
    disturbed: bool = False
    """Whether periods were missed, or samples or events were lost."""

    @property
    def enough(self) -> bool:
        """Whether there is enough to measure."""
        return self.measured is not None and self.measured.count >= self.part.minimum

    def __str__(self) -> str:
        count = 0 if self.measured is None else self.measured.count
        return f"{self.part.material}: {count} of {self.part.minimum} {self.part.unit}"

    def add(self, recorded: Recorded) -> None:
        """Add the measurement of one repetition."""
        one = self.part.measured(recorded)
        self.measured = one if self.measured is None else joined([self.measured, one])
        self.disturbed |= len(recorded.gaps()) > 0
        if self.best[1] is None or one.count >= self.best[1].count:
            self.best = recorded, one


def all_parts(library: Materials) -> list[Part]:
    """Return the parts in order: taps on each material, comb, sandpaper, puncture."""
    floors = [
        *((name, taps, taps.MIN_TAPS, "taps") for name, material in library.items() if material.tap is not None),
        (comb.MATERIAL, comb, comb.MIN_STRIKES, "strikes"),
        (sandpaper.MATERIAL, sandpaper, sandpaper.MIN_STROKES, "strokes"),
    ]
    return [
        *(
            Part(
                name,
                {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": name},
                how.PATH,
                how.measured if how is taps else partial(how.measured, material=library[name]),
                minimum,
                unit,
            )
            for name, how, minimum, unit in floors
        ),
        Part(
            puncture.MATERIAL,
            puncture.SKIN,
            puncture.PATH,
            partial(puncture.measured, material=library[puncture.MATERIAL]),
            puncture.MIN_RUPTURES,
            "ruptures",
        ),
    ]


def repeat(daemon: Client, progress: Progress, part: Part) -> Seen:
    """Repeat a part until there is enough to measure, at most MAX_REPETITIONS times."""
    task = progress.add_task(part.material, total=1.0)
    seen = Seen(part)
    for repetition in range(1, MAX_REPETITIONS + 1):
        daemon.set_scene({"objects": {"surface": part.surface}}, wait=True)
        daemon.reset()
        try:
            seen.add(perform(daemon, part.path, lambda done: progress.update(task, completed=done)))
            found = f"{seen} so far"
        except Disturbed as disturbed:
            seen.disturbed = True
            found = f"{part.material}: {disturbed}"
        if seen.enough or repetition == MAX_REPETITIONS:
            break
        progress.update(task, description=f"{part.material}, again")
        progress.console.print(f"{found}; once more")
    return seen
