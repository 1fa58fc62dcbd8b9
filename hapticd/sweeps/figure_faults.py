"""Checks the figures and labels of a study against its columns."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from hapticd.base.errors import Path, known_names, shown
from hapticd.sweeps.axes import Axis, shown_value
from hapticd.sweeps.columns import Column, Value
from hapticd.sweeps.figure_keys import SweepFigure
from hapticd.sweeps.keys import SweepStudy

MAX_FIGURE_LINES: Final = 10
"""Maximum number of lines in a figure, and of panels in a map; readers cannot distinguish more."""
_DRAWN_AS_NUMBERS: Final = ("number", "integer", "boolean")
"""Kinds of columns whose values are drawn as numbers."""


def figure_faults(study: SweepStudy, columns: Sequence[Column], axes: Sequence[Axis]) -> list[tuple[Path, str]]:
    """Return the faults of the keys `figures` and `labels`, each with its path in the study."""
    known = {column.name: column for column in columns}
    values = {axis.name: [shown_value(value, axis.kind) for value in axis.plain_values] for axis in axes}
    faults: list[tuple[Path, str]] = [
        (("labels", name), f"unknown column {name}; {known_names(name, list(known))}")
        for name in study.labels
        if name not in known
    ]
    for index, figure in enumerate(study.figures or ()):
        found = _Figure(figure, known, values, study.combine == "crossed").faults()
        faults += [(("figures", index, *path), text) for path, text in found]
    return faults


class _Figure:
    """Checks one figure against the columns and varied values of the study."""

    def __init__(
        self, figure: SweepFigure, columns: Mapping[str, Column], values: Mapping[str, Sequence[Value]], crossed: bool
    ) -> None:
        self._figure, self._columns, self._values, self._crossed = figure, columns, values, crossed

    def faults(self) -> list[tuple[Path, str]]:
        """Return the faults of the figure, with paths relative to the figure's keys."""
        figure = self._figure
        faults = list(self._where_faults())
        if figure.kind == "table":
            return faults + list(self._table_faults())
        assert figure.x is not None and figure.y is not None
        keys = {"x": figure.x, **({"y": figure.y[0]} if figure.kind == "map" else {})}
        if figure.by is not None:
            keys["by"] = figure.by
        faults += [
            ((key,), f"{name} is not a varied key; {known_names(name, list(self._values))}")
            for key, name in keys.items()
            if name not in self._values
        ]
        measured = {"color": figure.color} if figure.kind == "map" else {"y": figure.y}
        for key, names in {**measured, "overlay": figure.overlay}.items():
            faults += self._measured_faults(key, names or (), text_allowed=key == "color")
        if faults:
            return faults
        faults += [
            (("overlay",), f"{name} must have the unit of y, {self._unit(figure.y[0])}, has {self._unit(name)}")
            for name in figure.overlay or ()
            if self._columns[name].unit != self._columns[figure.y[0]].unit
        ]
        return [*faults, *self._key_faults(keys)]

    def _table_faults(self) -> Iterator[tuple[Path, str]]:
        for key, names in (("columns", self._figure.columns or ()), ("best", tuple(self._figure.best or ()))):
            for name in names:
                if name not in self._columns:
                    yield (key,), f"unknown column {name}; {known_names(name, list(self._columns))}"
                elif key == "best" and self._columns[name].kind == "text":
                    yield (key, name), f"{name} is a text column; best needs numbers"

    def _unit(self, name: str) -> str:
        return self._columns[name].unit or "no unit"

    def _measured_faults(self, key: str, names: Sequence[str], text_allowed: bool) -> list[tuple[Path, str]]:
        """Return faults of the columns `names`: not measured, not drawable, or with different units."""
        measured = [name for name, column in self._columns.items() if column.role == "measured"]
        for name in names:
            if name not in measured:
                return [((key,), f"unknown measured column {name}; {known_names(name, measured)}")]
            kind = self._columns[name].kind
            if kind not in _DRAWN_AS_NUMBERS and not (text_allowed and len(names) == 1):
                return [((key,), f"{name} is a text column: only a map of this single column can draw it")]
        units = {self._columns[name].unit for name in names}
        if len(units) > 1:
            listed = ", ".join(f"{name} ({self._unit(name)})" for name in names)
            return [((key,), f"columns of one figure must have the same unit, have: {listed}")]
        return []

    def _where_faults(self) -> list[tuple[Path, str]]:
        known = self._columns if self._figure.kind == "table" else self._values
        faults: list[tuple[Path, str]] = []
        for name, value in self._figure.where.items():
            if name not in known:
                what = "unknown column" if self._figure.kind == "table" else "unknown varied key"
                faults.append((("where", name), f"{what} {name}; {known_names(name, list(known))}"))
            elif name in self._values and value not in self._values[name]:
                have = ", ".join(map(str, self._values[name][:MAX_FIGURE_LINES]))
                faults.append((("where", name), f"no point has the value {shown(value)}; known: {have}"))
        return faults

    def _key_faults(self, keys: Mapping[str, str]) -> list[tuple[Path, str]]:
        """Return the faults of varied keys that the figure uses twice or not at all, or that have too many values."""
        faults: list[tuple[Path, str]] = []
        names = [*keys.values(), *self._figure.where]
        faults += [((), f"{name} is used twice") for name in dict.fromkeys(names) if names.count(name) > 1]
        by = self._figure.by
        if by is not None and len(self._values[by]) > MAX_FIGURE_LINES:
            faults.append(
                (("by",), f"{by} has {len(self._values[by])} values; at most {MAX_FIGURE_LINES} can be drawn")
            )
        if self._crossed:  # Random or zipped points are drawn at all values of the other keys.
            faults += [
                ((), f"{name} is varied, too: set one of its values in where, or use it as by")
                for name, values in self._values.items()
                if name not in names and len(values) > 1
            ]
        return faults
