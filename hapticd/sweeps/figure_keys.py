"""The keys of `figures`: what a study has drawn of its results.

Faults between a figure and the columns of the study are found by hapticd.sweeps.figure_faults.
"""

from __future__ import annotations

from typing import Annotated, Final, Literal, TypeAlias

from pydantic import BeforeValidator, Field, Strict, StringConstraints

from hapticd.base.model import CheckedTogether
from hapticd.experiment.plain_values import PlainScalar

FigureKind: TypeAlias = Literal["map", "line", "table"]
ColumnName: TypeAlias = Annotated[str, StringConstraints(min_length=1, max_length=512)]
Words: TypeAlias = Annotated[str, StringConstraints(min_length=1, max_length=200)]

MAX_FIGURE_COLUMNS: Final = 12
"""So many columns are drawn in one figure."""


def _as_columns(value: object) -> object:
    return [value] if isinstance(value, str) else value


Columns: TypeAlias = Annotated[
    tuple[ColumnName, ...],
    Strict(False),
    BeforeValidator(_as_columns),
    Field(min_length=1, max_length=MAX_FIGURE_COLUMNS),
]

_ALLOWED_KEYS: Final[dict[FigureKind, tuple[str, ...]]] = {
    "map": ("x", "y", "color", "axis_label", "by", "overlay", "legend"),
    "line": ("x", "y", "axis_label", "by", "overlay"),
    "table": ("best", "columns"),
}
_REQUIRED_KEYS: Final[dict[FigureKind, tuple[str, ...]]] = {"map": ("x", "y", "color"), "line": ("x", "y"), "table": ()}


class SweepFigure(CheckedTogether):
    """One figure of a study's results, or a table of some of its rows."""

    kind: FigureKind = Field(
        description="`map`: a measured column as a color over two varied keys; `line`: over one; `table`: some rows."
    )
    title: Words | None = Field(default=None, description="By default what is drawn over what.")
    x: ColumnName | None = Field(default=None, description="A varied key.")
    y: Columns | None = Field(
        default=None, description="Of a map: another varied key. Of lines: a measured column, or several of one unit."
    )
    color: Columns | None = Field(
        default=None, description="Of a map: a measured column, or several of one unit, each in a panel."
    )
    axis_label: Words | None = Field(
        default=None,
        description="Words at the axis of measured values, without the unit; by default the columns' own.",
    )
    by: ColumnName | None = Field(
        default=None, description="A varied key whose values have a line each, or a panel each in a map."
    )
    overlay: Columns | None = Field(
        default=None, description="Measured columns in the unit of y, drawn over the figure as dashed lines."
    )
    legend: Annotated[dict[ColumnName, Words], Field(max_length=MAX_FIGURE_COLUMNS)] | None = Field(
        default=None, description="Of a map of texts: by text, in the order of the legend, the words for it."
    )
    where: dict[ColumnName, PlainScalar] = Field(
        default={},
        description="By varied key: the value whose points are drawn; of a table, by any column.",
    )
    best: Annotated[dict[ColumnName, Literal["least", "most"]], Field(max_length=MAX_FIGURE_COLUMNS)] | None = Field(
        default=None,
        description="Of a table: rows alone that no other row beats, by column whether less or more of it is better.",
    )
    columns: Annotated[tuple[ColumnName, ...], Strict(False), Field(min_length=1)] | None = Field(
        default=None, description="Of a table: its columns, by default all."
    )

    def cross_faults(self) -> list[str]:
        given = {name for names in _ALLOWED_KEYS.values() for name in names if getattr(self, name)}
        faults = [f"kind: {self.kind} needs {name}" for name in _REQUIRED_KEYS[self.kind] if name not in given]
        faults += [
            f"{name} does not belong to kind: {self.kind}" for name in sorted(given - {*_ALLOWED_KEYS[self.kind]})
        ]
        if self.kind == "map" and self.y is not None and len(self.y) > 1:
            faults.append("y of a map is one varied key")
        several = self.y if self.kind == "line" else self.color
        if self.by is not None and several is not None and len(several) > 1:
            faults.append("several columns and by do not go together: one of them has the lines or panels")
        return faults
