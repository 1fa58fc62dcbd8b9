"""The keys of `figures` in the YAML file of a sweep.

hapticd.sweeps.figure_faults checks them against the columns of the study.
"""

from __future__ import annotations

from typing import Annotated, Final, Literal, TypeAlias

from pydantic import BeforeValidator, Field, Strict, StringConstraints

from hapticd.base.model import CheckedTogether
from hapticd.experiment.plain_values import PlainScalar, as_list

FigureKind: TypeAlias = Literal["map", "line", "table"]
ColumnName: TypeAlias = Annotated[str, StringConstraints(min_length=1, max_length=512)]
Words: TypeAlias = Annotated[str, StringConstraints(min_length=1, max_length=200)]

MAX_FIGURE_COLUMNS: Final = 12


Columns: TypeAlias = Annotated[
    tuple[ColumnName, ...],
    Strict(False),
    BeforeValidator(as_list),
    Field(min_length=1, max_length=MAX_FIGURE_COLUMNS),
]

_ALLOWED_KEYS: Final[dict[FigureKind, tuple[str, ...]]] = {
    "map": ("x", "y", "color", "axis_label", "by", "overlay", "legend"),
    "line": ("x", "y", "axis_label", "by", "overlay"),
    "table": ("best", "columns"),
}
"""For each kind of figure, the keys that it may have besides those of every kind."""
_REQUIRED_KEYS: Final[dict[FigureKind, tuple[str, ...]]] = {"map": ("x", "y", "color"), "line": ("x", "y"), "table": ()}
"""For each kind of figure, the keys that it must have."""


class SweepFigure(CheckedTogether):
    """One figure of a study's results, or a table of some of its rows."""

    kind: FigureKind = Field(
        description="`map`: a measured column as a color over two varied keys; `line`: over one; `table`: some rows."
    )
    title: Words | None = Field(default=None, description="Title; by default made of the drawn columns and their axes.")
    x: ColumnName | None = Field(default=None, description="A varied key.")
    y: Columns | None = Field(
        default=None,
        description="In a map: another varied key. In a line figure: a measured column, or several of one unit.",
    )
    color: Columns | None = Field(
        default=None, description="In a map: a measured column, or several of one unit, each in a panel."
    )
    axis_label: Words | None = Field(
        default=None,
        description="Label of the axis of measured values, without the unit; by default made of the columns.",
    )
    by: ColumnName | None = Field(
        default=None, description="A varied key whose values have a line each, or in a map a panel each."
    )
    overlay: Columns | None = Field(
        default=None, description="Measured columns in the unit of y that are drawn as dashed lines."
    )
    legend: Annotated[dict[ColumnName, Words], Field(max_length=MAX_FIGURE_COLUMNS)] | None = Field(
        default=None, description="In a map of texts: for each text its words in the legend, in this order."
    )
    where: dict[ColumnName, PlainScalar] = Field(
        default={},
        description="Values of varied keys: only points with these values are drawn. In a table, of any column.",
    )
    best: Annotated[dict[ColumnName, Literal["least", "most"]], Field(max_length=MAX_FIGURE_COLUMNS)] | None = Field(
        default=None,
        description="In a table: only rows that are Pareto-optimal; for each column whether the least or most is best.",
    )
    columns: Annotated[tuple[ColumnName, ...], Strict(False), Field(min_length=1)] | None = Field(
        default=None, description="In a table: its columns, by default all."
    )

    def cross_faults(self) -> list[str]:
        """Return the faults that concern several keys of the figure together."""
        given = {name for names in _ALLOWED_KEYS.values() for name in names if getattr(self, name)}
        faults = [f"kind: {self.kind} needs {name}" for name in _REQUIRED_KEYS[self.kind] if name not in given]
        faults += [f"{name} is not a key of kind: {self.kind}" for name in sorted(given - {*_ALLOWED_KEYS[self.kind]})]
        if self.kind == "map" and self.y is not None and len(self.y) > 1:
            faults.append("y of a map must be one varied key")
        several = self.y if self.kind == "line" else self.color
        if self.by is not None and several is not None and len(several) > 1:
            faults.append("by cannot be combined with several columns")
        return faults
