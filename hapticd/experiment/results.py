"""What an analysis consists of: tables, pictures and notes, as plain numbers that terminal, CSV and page show alike."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import dataclass
from typing import Final, TypeAlias

from hapticd.analysis.statistics import Floats
from hapticd.base.yaml_source import Json

Cell: TypeAlias = str | int | float | None
LEAST_P: Final = 1e-4


@dataclass(frozen=True, slots=True)
class ResultTable:
    """Rows of figures. A column's unit stands in its head."""

    name: str
    """Of its CSV file."""
    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    note: str = ""

    def text(self) -> list[tuple[str, ...]]:
        """The rows as people read them: a p less than LEAST_P is no number of its own."""
        are_p = [head == "p" or head.startswith("p ") for head in self.columns]
        return [
            tuple(p_text(cell) if is_p else cell_text(cell) for cell, is_p in zip(row, are_p, strict=True))
            for row in self.rows
        ]

    def of_text(self) -> tuple[bool, ...]:
        """Of each column whether it holds texts, which stand on the left, and no numbers."""
        columns = list(zip(*self.rows, strict=True)) or [()] * len(self.columns)
        return tuple(all(isinstance(cell, str) for cell in column) for column in columns)

    def csv(self) -> str:
        """All digits; what is missing is empty."""
        target = io.StringIO()
        writer = csv.writer(target, lineterminator="\n")
        writer.writerow(self.columns)
        writer.writerows([_csv_cell(cell) for cell in row] for row in self.rows)
        return target.getvalue()

    def to_dict(self) -> dict[str, Json]:
        rows: list[Json] = [
            [None if isinstance(cell, float) and not math.isfinite(cell) else cell for cell in row] for row in self.rows
        ]
        return {"title": self.title, "columns": list(self.columns), "rows": rows, "note": self.note}


@dataclass(frozen=True, slots=True)
class Dots:
    """Values with their intervals, one group beside another: (k,) of each series, nan where it has none."""

    title: str
    labels: tuple[str, ...]
    series: tuple[tuple[str, Floats, Floats, Floats], ...]
    """Name, values, low and high ends."""
    axis: str
    """What is drawn, with its unit."""
    chance: float | None = None


@dataclass(frozen=True, slots=True)
class Matrices:
    """Tables of numbers as colours, side by side: (rows, columns) each; nan is left empty."""

    title: str
    rows: tuple[str, ...]
    columns: tuple[str, ...]
    panels: tuple[tuple[str, Floats], ...]
    unit: str
    row_label: str
    column_label: str


@dataclass(frozen=True, slots=True)
class Fitted:
    """A psychometric function through proportions."""

    title: str
    levels: Floats
    percent: Floats
    low: Floats
    high: Floats
    curve_levels: Floats
    curve_percent: Floats
    threshold: tuple[float, float, float] | None
    """With the ends of its interval; None: the answers determine none."""
    level_label: str
    logarithmic: bool
    axis: str = "correct answers, %"


@dataclass(frozen=True, slots=True)
class PairedValues:
    """One line a participant from condition to condition: (participants, conditions)."""

    title: str
    conditions: tuple[str, ...]
    values: Floats
    axis: str


Picture: TypeAlias = Dots | Matrices | Fitted | PairedValues


@dataclass(frozen=True, slots=True)
class Section:
    """Tables and pictures of one matter."""

    tables: tuple[ResultTable, ...]
    pictures: tuple[Picture, ...] = ()
    notes: tuple[str, ...] = ()
    compares_published: bool = False
    """Whether published figures stand in the tables."""


def cell_text(cell: Cell) -> str:
    """Four digits at most; a dash for what is missing."""
    if cell is None or (isinstance(cell, float) and math.isnan(cell)):
        return "-"
    if isinstance(cell, float):
        return f"{cell:.4g}"
    return str(cell)


def p_text(cell: Cell) -> str:
    """As cell_text, of a probability."""
    return f"< {LEAST_P:.4f}" if isinstance(cell, float) and cell < LEAST_P else cell_text(cell)


def _csv_cell(cell: Cell) -> str:
    if cell is None or (isinstance(cell, float) and math.isnan(cell)):
        return ""
    return repr(float(cell)) if isinstance(cell, float) else str(cell)
