"""The default figures, for a study without the key `figures`."""

from __future__ import annotations

from typing import Final

from hapticd.sweeps.figure_faults import MAX_FIGURE_LINES
from hapticd.sweeps.figure_keys import SweepFigure
from hapticd.sweeps.map_figure import MAX_MAP_TEXTS
from hapticd.sweeps.refine import BOUNDARY_COLUMN
from hapticd.sweeps.results import Results

MAX_DEFAULT_FIGURES: Final = 6
_MIN_MAP_VALUES: Final = 5
"""Two keys with at least 5 values each are drawn as a map; with fewer values, a line for each value is clearer."""


def default_figures(results: Results) -> list[SweepFigure]:
    """Return a figure for each measured column, up to MAX_DEFAULT_FIGURES; with `refine` one figure of the boundary.

    The x axis is the numeric key with the most values. The key with the second most values is the y axis of a map if it
    is numeric and has at least _MIN_MAP_VALUES values; otherwise each of its values is a line. Other keys of a crossed
    study are kept at their first value. A study without a numeric varied key has no figures.
    """
    study = results.study
    counts = {name: len(results.values(name)) for name in results.named("varied")}
    numeric = [name for name in counts if counts[name] > 1 and results.column(name).kind in ("number", "integer")]
    if not numeric:
        return []
    # The sort is stable: of keys with equally many values, the first in the study wins.
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
    """Return the measured columns that can be drawn (as a map if `is_map`, else as lines) and have any value."""
    if results.study.refine is not None:
        return [BOUNDARY_COLUMN]
    found = []
    for name in results.named("measured"):
        values = {row[name] for row in results.rows} - {None}
        is_text = results.column(name).kind == "text"
        if values and (not is_text or (is_map and len(values) <= MAX_MAP_TEXTS)):
            found.append(name)
    return found[:MAX_DEFAULT_FIGURES]
