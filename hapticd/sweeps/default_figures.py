"""The figures of a study that names none."""

from __future__ import annotations

from typing import Final

from hapticd.sweeps.figure_faults import MAX_FIGURE_LINES
from hapticd.sweeps.figure_keys import SweepFigure
from hapticd.sweeps.map_figure import MAX_MAP_TEXTS
from hapticd.sweeps.results import Results

MAX_DEFAULT_FIGURES: Final = 6
_MIN_MAP_VALUES: Final = 5
"""Two keys with so many values each are the axes of a map; with fewer, a line for each value is read more easily."""


def default_figures(results: Results) -> list[SweepFigure]:
    """One for each measured column, up to MAX_DEFAULT_FIGURES; of a refined study the boundary alone.

    Over the key with the most values, by the one with the next most: as a map if both are numbers with five values or
    more, otherwise as lines. Other keys of a crossed study stay at their first value. Without a number that is varied
    there is none.
    """
    study = results.study
    counts = {name: len(results.values(name)) for name in results.named("varied")}
    numeric = [name for name in counts if counts[name] > 1 and results.column(name).kind in ("number", "integer")]
    if not numeric:
        return []
    # Sorted stably: of as many values, the first in the study.
    ordered = sorted(numeric, key=lambda name: -counts[name])
    x, others = ordered[0], ordered[1:] + [name for name in counts if counts[name] > 1 and name not in numeric]
    second = others[0] if others else None
    is_map = second in numeric and counts[second] >= _MIN_MAP_VALUES
    if not is_map and second is not None:
        second = next((name for name in others if counts[name] <= MAX_FIGURE_LINES), None)
    named = [name for name in (x, second) if name is not None]
    fixed = {name: results.values(name)[0] for name in counts if name not in named and counts[name] > 1}
    where = fixed if study.combine == "crossed" else {}
    found: list[SweepFigure] = []
    for column in _drawn(results, is_map):
        keys = {"kind": "map", "y": second, "color": column} if is_map else {"kind": "line", "y": column, "by": second}
        found.append(SweepFigure.parsed({"x": x, "where": where, **{k: v for k, v in keys.items() if v is not None}}))
    return found


def _drawn(results: Results, is_map: bool) -> list[str]:
    """Measured columns that can be drawn and have a value."""
    if results.study.refine is not None:
        return ["boundary"]
    found = []
    for name in results.named("measured"):
        values = {row[name] for row in results.rows} - {None}
        is_text = results.column(name).kind == "text"
        if values and (not is_text or (is_map and len(values) <= MAX_MAP_TEXTS)):
            found.append(name)
    return found[:MAX_DEFAULT_FIGURES]
