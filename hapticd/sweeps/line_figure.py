"""Draws measured columns over a varied key: one line for each column, or for each value of another varied key."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from hapticd.analysis.drawing import literal
from hapticd.sweeps.axis_scales import Scale, key_scale, measured_scale
from hapticd.sweeps.columns import Row, Value
from hapticd.sweeps.figure_keys import SweepFigure
from hapticd.sweeps.refine import BOUNDARY_COLUMN, BOUNDARY_FAILS_COLUMN, BOUNDARY_STATE_COLUMN
from hapticd.sweeps.results import Results, with_values

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NO_RESULT_LABEL: Final = "no result"
"""Label of points without a result in a legend."""
BOUNDARY_STATE_MARKERS: Final = {
    "always": ("^", "holds to the end of the search"),
    "never": ("v", "does not hold at the start of the search"),
}
"""Marker and label of a boundary that was not found, by its state. The marker is at the last tried value."""
_MAX_DOTS: Final = 40
"""A line has dots if it has at most 40 points."""


@dataclass(frozen=True, slots=True)
class _Line:
    """One line of a figure: its label, its column, and the rows of its points."""

    label: str
    column: str
    rows: Sequence[Row]


def draw_lines(figure: Figure, results: Results, keys: SweepFigure) -> None:
    """Draw a line figure. Points without a result are crosses at the lower edge of the figure."""
    assert keys.x is not None and keys.y is not None
    rows = with_values(results.rows, keys.where)
    lines = _lines(results, keys, rows)
    drawn: list[Value] = [row[name] for row in rows for name in (*keys.y, *(keys.overlay or ()))]
    if keys.y == (BOUNDARY_COLUMN,):
        drawn += [row[BOUNDARY_FAILS_COLUMN] for row in rows]
    x, y = key_scale(results, keys.x), measured_scale(results, keys.y, keys.axis_label, drawn)
    figure.set_size_inches(6.4, 4.2)
    axes = figure.subplots()
    x.prepare(axes, "x")
    y.prepare(axes, "y")
    # Random points differ in several keys at once, so a line between them has no meaning.
    joined = results.study.combine in ("crossed", "zipped")
    for number, line in enumerate(lines):
        color = f"C{number}"
        at, values = x.at([row[keys.x] for row in line.rows]), y.at([row[line.column] for row in line.rows])
        style = ("o-" if len(at) <= _MAX_DOTS else "-") if joined else "o"
        if line.column == BOUNDARY_COLUMN:
            _draw_boundary(axes, line.rows, at, y, color, style, line.label)
        else:
            axes.plot(at, values, style, ms=3.5, lw=1.3, color=color, label=literal(line.label))
    _draw_overlays(axes, results, keys, lines, x, y)
    _mark_missing(axes, lines, keys.x, x)
    if y.spacing == "categories":
        axes.set_ylim(-0.3, len(y.categories) - 0.7)
    x.label_ticks(axes, "x")
    y.label_ticks(axes, "y")
    axes.set_xlabel(literal(x.label))
    axes.set_ylabel(literal(y.label))
    axes.grid(alpha=0.3)
    _add_legend(figure, axes, results, keys)


def _add_legend(figure: Figure, axes: Axes, results: Results, keys: SweepFigure) -> None:
    """Add a legend to a line figure: lines first, then markers."""
    handles, labels = axes.get_legend_handles_labels()
    known = dict(zip(labels, handles, strict=True))
    marks = [*(words for _, words in BOUNDARY_STATE_MARKERS.values()), NO_RESULT_LABEL]
    ordered = [*(label for label in known if label not in marks), *(label for label in marks if label in known)]
    if not ordered or (keys.by is None and len(ordered) < 2):
        return
    figure.legend(
        [known[label] for label in ordered],
        ordered,
        loc="outside lower center",
        ncols=min(4, len(ordered)),
        frameon=False,
        title=None if keys.by is None else literal(key_scale(results, keys.by).label),
        title_fontsize=8,
    )


def _lines(results: Results, keys: SweepFigure, rows: Sequence[Row]) -> list[_Line]:
    assert keys.y is not None
    if keys.by is None:
        return [_Line(results.words(name), name, rows) for name in keys.y]
    scale = key_scale(results, keys.by)
    found = []
    for value in results.values(keys.by):
        of_value = [row for row in rows if row[keys.by] == value]
        found.append(_Line(scale.text(value, with_unit=False), keys.y[0], of_value))
    return [line for line in found if line.rows]


def _draw_boundary(
    axes: Axes, rows: Sequence[Row], at: np.ndarray, y: Scale, color: str, style: str, label: str
) -> None:
    """Draw a line through the values of BOUNDARY_COLUMN, and a band up to the values of BOUNDARY_FAILS_COLUMN."""
    found = np.array([row[BOUNDARY_STATE_COLUMN] == "found" for row in rows])
    last, first = y.at([row[BOUNDARY_COLUMN] for row in rows]), y.at([row[BOUNDARY_FAILS_COLUMN] for row in rows])
    axes.plot(at, np.where(found, last, math.nan), style, ms=3.5, lw=1.3, color=color, label=literal(label))
    axes.fill_between(at, last, first, where=found, color=color, alpha=0.3, lw=0)
    for state, (marker, words) in BOUNDARY_STATE_MARKERS.items():
        here = np.array([row[BOUNDARY_STATE_COLUMN] == state for row in rows])
        if here.any():
            values = last if state == "always" else first
            axes.plot(at[here], values[here], marker, ms=7, color=color, mfc="none", label=words)


def _draw_overlays(axes: Axes, results: Results, keys: SweepFigure, lines: Sequence[_Line], x: Scale, y: Scale) -> None:
    """Draw each overlay column as a dashed line: one if all lines have equal values, else one in each line's color."""
    assert keys.x is not None
    for name in keys.overlay or ():
        each = [(x.at([row[keys.x] for row in line.rows]), y.at([row[name] for row in line.rows])) for line in lines]
        same = all(np.array_equal(np.array(one), np.array(each[0]), equal_nan=True) for one in each)
        for number, (at, values) in enumerate(each[:1] if same else each):
            color = axes.xaxis.label.get_color() if same else f"C{number}"
            axes.plot(at, values, "--", lw=1.1, color=color, label=literal(results.words(name)), zorder=5)


def _mark_missing(axes: Axes, lines: Sequence[_Line], key: str, x: Scale) -> None:
    """Draw crosses for points without a value: one row for each line, at the lower edge."""
    for number, line in enumerate(lines):
        missing = [
            row[key]
            for row in line.rows
            if row[line.column] is None
            and not (line.column == BOUNDARY_COLUMN and row[BOUNDARY_STATE_COLUMN] in BOUNDARY_STATE_MARKERS)
        ]
        if missing:
            axes.plot(
                x.at(missing),
                np.full(len(missing), 0.03 * (1 + number)),
                "x",
                ms=6,
                mew=1.4,
                color=f"C{number}",
                label=NO_RESULT_LABEL,
                transform=axes.get_xaxis_transform(),
                clip_on=False,
            )
