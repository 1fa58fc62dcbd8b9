"""How values of a column lie on an axis: linear, logarithmic or side by side, in a unit that is easy to read."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from hapticd.analysis.drawing import literal, plain_decades
from hapticd.fit.report import MAX_LABELLED_DECADES, LABELS_BY_DECADES
from hapticd.sweeps.columns import Column, Value
from hapticd.sweeps.results import Results

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Floats: TypeAlias = npt.NDArray[np.float64]
Spacing: TypeAlias = Literal["linear", "logarithmic", "categories"]
Which: TypeAlias = Literal["x", "y"]

WIDE: Final = 30.0
"""Measured values, all above 0, whose largest is so many times the least are on a logarithmic axis."""
_PLAIN, _MOST_PLAIN = 1e4, 1e7
"""A number from one to the other has no exponent: 10000."""
_MOST_TICKS: Final = 8
"""So many values that a study lists have a tick each."""
_UNITS: Final[dict[str, tuple[tuple[float, float, str], ...]]] = {
    "m": ((1e-3, 1e6, "µm"), (1.0, 1e3, "mm")),
    "s": ((1e-3, 1e6, "µs"), (1.0, 1e3, "ms")),
    "kg": ((1.0, 1e3, "g"),),
    "us": ((math.inf, 1.0, "µs"),),
}
"""By unit: if the largest value is below the first number, values are multiplied by the second, in the third."""


@dataclass(frozen=True, slots=True)
class Scale:
    """One axis."""

    label: str
    """Words and unit."""
    spacing: Spacing
    factor: float = 1.0
    """Numbers are multiplied by it."""
    unit: str = ""
    """As it is written at the axis."""
    ticks: tuple[float, ...] = ()
    """Where ticks are, in the axis' unit; none: where matplotlib has them."""
    categories: tuple[Value, ...] = ()
    """Values that lie one beside the other, at 0, 1, 2..."""

    def at(self, values: Sequence[Value]) -> Floats:
        """Where values lie, (n,); what is None is NaN."""
        if self.spacing == "categories":
            return np.array([float(self.categories.index(value)) for value in values])
        return np.array([math.nan if value is None else self.factor * float(value) for value in values])

    def text(self, value: Value, with_unit: bool = True) -> str:
        """A value in a caption or a legend: `40 g`."""
        if self.spacing == "categories" or not isinstance(value, int | float):
            return shown(value)
        return f"{shown(self.factor * value)} {self.unit if with_unit else ''}".rstrip()

    def edges(self, centers: Floats) -> Floats:
        """The borders of cells about centers that ascend, (n + 1,): half way to the next, as the axis is spaced."""
        if len(centers) == 1:
            step = 0.5 if self.spacing == "categories" else abs(centers[0]) * 0.1 or 0.5
            return np.array([centers[0] - step, centers[0] + step])
        laid = np.log(centers) if self.spacing == "logarithmic" else centers
        middle = (laid[1:] + laid[:-1]) / 2
        found = np.concatenate(([2 * laid[0] - middle[0]], middle, [2 * laid[-1] - middle[-1]]))
        return np.exp(found) if self.spacing == "logarithmic" else found

    def prepare(self, axes: Axes, which: Which) -> None:
        """Before anything is drawn: what a line on this axis is laid out by."""
        if self.spacing == "logarithmic":
            (axes.set_xscale if which == "x" else axes.set_yscale)("log")

    def label_ticks(self, axes: Axes, which: Which) -> None:
        """After everything is drawn: ticks with plain numbers, as many as have room."""
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
            plain_decades(axis, next(steps for most, steps in LABELS_BY_DECADES if decades <= most))
        # matplotlib adds what it has beyond either end, which would stretch the axis.
        (axes.set_xlim if which == "x" else axes.set_ylim)(low, high)


def shown(value: Value) -> str:
    """A value in a legend, at a tick or in a table."""
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if not isinstance(value, float):
        return str(value)
    return f"{value:.0f}" if _PLAIN <= abs(value) < _MOST_PLAIN else f"{value:.4g}"


def key_scale(results: Results, name: str) -> Scale:
    """Of a varied key: logarithmic where its values are spaced so."""
    column, values = results.column(name), results.values(name)
    if column.kind in ("text", "boolean"):
        return Scale(results.words(name), "categories", categories=tuple(values))
    axis = results.study.vary[name]
    numbers = np.array([float(value) for value in values if isinstance(value, int | float)])
    ranged = axis.is_range and numbers.min() > 0
    logarithmic = axis.spacing == "logarithmic" if ranged else _geometric(numbers)
    found = _scale(results.words(name), column, numbers, logarithmic, bare=name not in results.study.labels)
    listed = axis.values is not None and len(numbers) <= _MOST_TICKS
    return replace(found, ticks=tuple((found.factor * numbers).tolist())) if listed else found


def measured_scale(results: Results, names: Sequence[str], words: str | None, values: Sequence[Value]) -> Scale:
    """Of measured columns of one unit, drawn with these values among them; `words` instead of the columns' own."""
    column = results.column(names[0])
    bare = words is None and names[0] not in results.study.labels
    words = words or ", ".join(results.words(name) for name in names)
    if column.kind == "boolean":
        return Scale(words, "categories", categories=(False, True))
    known = np.array([float(value) for value in values if value is not None])
    numbers = known[np.isfinite(known)]
    refine = results.study.refine
    if refine is not None and names[0] == "boundary":
        logarithmic = refine.spacing == "logarithmic"
    else:
        logarithmic = len(numbers) > 0 and bool(numbers.min() > 0 and numbers.max() >= WIDE * numbers.min())
    return _scale(words, column, numbers, logarithmic, bare)


def unit_scale(unit: str, largest: float) -> tuple[float, str]:
    """The factor of a unit that suits values up to this magnitude, and the unit's sign."""
    for below, factor, text in _UNITS.get(unit, ()):
        if largest < below:
            return factor, text
    return 1.0, unit


def _scale(words: str, column: Column, numbers: Floats, logarithmic: bool, bare: bool) -> Scale:
    """`bare`: the words are not the study's own, which may say of what a number without a unit is a ratio."""
    factor, unit = unit_scale(column.unit, float(np.abs(numbers).max(initial=0.0)))
    without = " (no unit)" if bare and column.kind == "number" else ""
    label = f"{words}, {unit}" if unit else words + without
    return Scale(label, "logarithmic" if logarithmic else "linear", factor, unit)


def _geometric(numbers: Floats) -> bool:
    """Whether listed numbers are nearer to equal ratios than to equal steps."""
    if len(numbers) < 3 or numbers.min() <= 0:
        return False
    steps, ratios = np.diff(numbers), np.diff(np.log(numbers))
    return bool(ratios.std() / ratios.mean() < steps.std() / steps.mean())
