"""The scale of a figure's axis: linear, logarithmic or categories, in a unit in which numbers are short."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from hapticd.analysis.drawing import literal, plain_decades
from hapticd.fit.report import LABELS_BY_DECADES, MAX_LABELLED_DECADES
from hapticd.sweeps.columns import Column, Value
from hapticd.sweeps.refine import BOUNDARY_COLUMN
from hapticd.sweeps.results import Results

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Floats: TypeAlias = npt.NDArray[np.float64]
Spacing: TypeAlias = Literal["linear", "logarithmic", "categories"]
Which: TypeAlias = Literal["x", "y"]

LOGARITHMIC_FROM_RATIO: Final = 30.0
"""An axis of positive measured values is logarithmic if the largest value is at least 30 times the smallest."""
_PLAIN_FROM, _PLAIN_BELOW = 1e4, 1e7
"""Floats of a magnitude from 1e4 to 1e7 are written without an exponent: 10000."""
_MAX_TICKS: Final = 8
"""If a varied key has at most 8 listed values, each has a tick."""
_READABLE_UNITS: Final[dict[str, tuple[tuple[float, float, str], ...]]] = {
    "m": ((1e-3, 1e6, "µm"), (1.0, 1e3, "mm")),
    "s": ((1e-3, 1e6, "µs"), (1.0, 1e3, "ms")),
    "kg": ((1.0, 1e3, "g"),),
    "us": ((math.inf, 1.0, "µs"),),
}
"""For each unit, tuples (limit, factor, shown unit): values all below limit are shown times factor, in that unit."""


@dataclass(frozen=True, slots=True)
class Scale:
    """The scale of one axis of a figure."""

    label: str
    """Axis label with the unit."""
    spacing: Spacing
    factor: float = 1.0
    """Factor from the column's unit to the unit of the axis."""
    unit: str = ""
    ticks: tuple[float, ...] = ()
    """Positions of the ticks in the unit of the axis; if empty, matplotlib chooses them."""
    categories: tuple[Value, ...] = ()
    """Values at the positions 0, 1, 2... of a categorical axis; otherwise empty."""

    def at(self, values: Sequence[Value]) -> Floats:
        """Return the positions of values on the axis, (n,); NaN for None."""
        if self.spacing == "categories":
            return np.array([float(self.categories.index(value)) for value in values])
        return np.array([math.nan if value is None else self.factor * float(value) for value in values])

    def text(self, value: Value, with_unit: bool = True) -> str:
        """Return a value as text for a caption or a legend: `40 g`."""
        if self.spacing == "categories" or not isinstance(value, int | float):
            return shown(value)
        return f"{shown(self.factor * value)} {self.unit if with_unit else ''}".rstrip()

    def edges(self, centers: Floats) -> Floats:
        """Return the edges of n cells, (n + 1,), half way between their centers, which are in ascending order."""
        if len(centers) == 1:
            step = 0.5 if self.spacing == "categories" else abs(centers[0]) * 0.1 or 0.5
            return np.array([centers[0] - step, centers[0] + step])
        at = np.log(centers) if self.spacing == "logarithmic" else centers
        middle = (at[1:] + at[:-1]) / 2
        found = np.concatenate(([2 * at[0] - middle[0]], middle, [2 * at[-1] - middle[-1]]))
        return np.exp(found) if self.spacing == "logarithmic" else found

    def prepare(self, axes: Axes, which: Which) -> None:
        """Make the axis `which` of a figure logarithmic if this scale is logarithmic. Must be called before drawing."""
        if self.spacing == "logarithmic":
            (axes.set_xscale if which == "x" else axes.set_yscale)("log")

    def label_ticks(self, axes: Axes, which: Which) -> None:
        """Label the ticks of the axis `which`, if there is room, with plain numbers. Must be called after drawing."""
        from matplotlib.ticker import NullLocator

        axis = axes.xaxis if which == "x" else axes.yaxis
        if self.spacing == "categories":
            axis.set_ticks(range(len(self.categories)), [literal(shown(value)) for value in self.categories])
        if self.ticks:
            axis.set_ticks(self.ticks, [shown(value) for value in self.ticks])
            axis.set_minor_locator(NullLocator())
        if self.spacing != "logarithmic" or self.ticks:
            return
        low, high = axes.get_xlim() if which == "x" else axes.get_ylim()
        decades = math.log10(high / low)
        if decades <= MAX_LABELLED_DECADES:
            plain_decades(axis, next(steps for limit, steps in LABELS_BY_DECADES if decades <= limit))
        # matplotlib adds ticks beyond the limits, which would stretch the axis.
        (axes.set_xlim if which == "x" else axes.set_ylim)(low, high)


def shown(value: Value) -> str:
    """Return a value as text for a legend, a tick or a table."""
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if not isinstance(value, float):
        return str(value)
    return f"{value:.0f}" if _PLAIN_FROM <= abs(value) < _PLAIN_BELOW else f"{value:.4g}"


def key_scale(results: Results, name: str) -> Scale:
    """Return the scale of a varied key: categories for texts, else linear or logarithmic as its values are spaced."""
    column, values = results.column(name), results.values(name)
    if column.kind in ("text", "boolean"):
        return Scale(results.words(name), "categories", categories=tuple(values))
    axis = results.study.vary[name]
    numbers = np.array([float(value) for value in values if isinstance(value, int | float)])
    ranged = axis.is_range and numbers.min() > 0
    logarithmic = axis.spacing == "logarithmic" if ranged else _geometric(numbers)
    found = _scale(results.words(name), column, numbers, logarithmic, shows_no_unit=name not in results.study.labels)
    listed = axis.values is not None and len(numbers) <= _MAX_TICKS
    return replace(found, ticks=tuple((found.factor * numbers).tolist())) if listed else found


def measured_scale(results: Results, names: Sequence[str], words: str | None, values: Sequence[Value]) -> Scale:
    """Return the scale of an axis for `values` of measured columns with one unit; `words` is the label, if any."""
    column = results.column(names[0])
    shows_no_unit = words is None and names[0] not in results.study.labels
    words = words or ", ".join(results.words(name) for name in names)
    if column.kind == "boolean":
        return Scale(words, "categories", categories=(False, True))
    known = np.array([float(value) for value in values if value is not None])
    numbers = known[np.isfinite(known)]
    refine = results.study.refine
    if refine is not None and names[0] == BOUNDARY_COLUMN:
        logarithmic = refine.spacing == "logarithmic"
    else:
        logarithmic = len(numbers) > 0 and bool(
            numbers.min() > 0 and numbers.max() >= LOGARITHMIC_FROM_RATIO * numbers.min()
        )
    return _scale(words, column, numbers, logarithmic, shows_no_unit)


def unit_scale(unit: str, largest: float) -> tuple[float, str]:
    """Return a readable unit for values in `unit` up to the magnitude `largest`, as (factor, symbol)."""
    for below, factor, text in _READABLE_UNITS.get(unit, ()):
        if largest < below:
            return factor, text
    return 1.0, unit


def _scale(words: str, column: Column, numbers: Floats, logarithmic: bool, shows_no_unit: bool) -> Scale:
    """Return a linear or logarithmic scale in a readable unit.

    With `shows_no_unit`, the label of a number without a unit ends in `(no unit)`.
    """
    factor, unit = unit_scale(column.unit, float(np.abs(numbers).max(initial=0.0)))
    without = " (no unit)" if shows_no_unit and column.kind == "number" else ""
    label = f"{words}, {unit}" if unit else words + without
    return Scale(label, "logarithmic" if logarithmic else "linear", factor, unit)


def _geometric(numbers: Floats) -> bool:
    """Return whether the ratios of successive numbers vary relatively less than their differences."""
    if len(numbers) < 3 or numbers.min() <= 0:
        return False
    steps, ratios = np.diff(numbers), np.diff(np.log(numbers))
    return bool(ratios.std() / ratios.mean() < steps.std() / steps.mean())
