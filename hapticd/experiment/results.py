"""Tables, pictures and notes of an analysis. Terminal, CSV files and HTML page show the same numbers."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import dataclass
from typing import Final, TypeAlias

from hapticd.analysis.statistics import Floats
from hapticd.base.yaml_source import Json

Cell: TypeAlias = str | int | float | None
"""A cell of a table of results; None for a missing value."""
MIN_SHOWN_P: Final = 1e-4
"""Smallest p value that is shown as a number. A smaller one is shown as "< 0.0001"."""


@dataclass(frozen=True, slots=True)
class ResultTable:
    """A table of results. The header of a column ends with its unit."""

    name: str
    """Name of the table, and of its CSV file without the suffix."""
    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    note: str = ""

    def text(self) -> list[tuple[str, ...]]:
        """Return the rows of the table as text: four digits, and "< 0.0001" for a p value below MIN_SHOWN_P."""
        are_p = [head == "p" or head.startswith("p ") for head in self.columns]
        return [
            tuple(p_text(cell) if is_p else cell_text(cell) for cell, is_p in zip(row, are_p, strict=True))
            for row in self.rows
        ]

    def of_text(self) -> tuple[bool, ...]:
        """Return for each column of the table whether it contains only texts, which are aligned left."""
        columns = list(zip(*self.rows, strict=True)) or [()] * len(self.columns)
        return tuple(all(isinstance(cell, str) for cell in column) for column in columns)

    def csv(self) -> str:
        """Return the table as CSV with all digits. A missing value is empty."""
        target = io.StringIO()
        writer = csv.writer(target, lineterminator="\n")
        writer.writerow(self.columns)
        writer.writerows([_csv_cell(cell) for cell in row] for row in self.rows)
        return target.getvalue()

    def to_dict(self) -> dict[str, Json]:
        """Return the table as JSON data. A number that is not finite becomes null."""
        rows: list[Json] = [
            [None if isinstance(cell, float) and not math.isfinite(cell) else cell for cell in row] for row in self.rows
        ]
        return {"title": self.title, "columns": list(self.columns), "rows": rows, "note": self.note}


@dataclass(frozen=True, slots=True)
class Dots:
    """A picture of values with intervals. Each series has a value for each of k labels, NaN if it is missing."""

    title: str
    labels: tuple[str, ...]
    series: tuple[tuple[str, Floats, Floats, Floats], ...]
    """Name of a series, its values (k,), and the lower and upper ends (k,) of their intervals."""
    axis: str
    """Label of the axis, with its unit."""
    chance: float | None = None
    """Value expected by chance, which is drawn as a line, or None."""


@dataclass(frozen=True, slots=True)
class Matrices:
    """A picture of matrices side by side, with values as colours. Each has shape (rows, columns); NaN is not drawn."""

    title: str
    rows: tuple[str, ...]
    columns: tuple[str, ...]
    panels: tuple[tuple[str, Floats], ...]
    unit: str
    row_label: str
    column_label: str


@dataclass(frozen=True, slots=True)
class Fitted:
    """A picture of a psychometric function, in percent, and of the answers to which it was fitted."""

    title: str
    levels: Floats
    percent: Floats
    low: Floats
    high: Floats
    curve_levels: Floats
    curve_percent: Floats
    threshold: tuple[float, float, float] | None
    """The threshold and the ends of its interval, or None if the answers do not determine a threshold."""
    level_label: str
    logarithmic: bool
    axis: str = "correct answers, %"


@dataclass(frozen=True, slots=True)
class PairedValues:
    """A picture with a line for each participant, over conditions. `values` has shape (participants, conditions)."""

    title: str
    conditions: tuple[str, ...]
    values: Floats
    axis: str


Picture: TypeAlias = Dots | Matrices | Fitted | PairedValues


@dataclass(frozen=True, slots=True)
class Section:
    """A section of an analysis: tables, pictures and notes on one topic."""

    tables: tuple[ResultTable, ...]
    pictures: tuple[Picture, ...] = ()
    notes: tuple[str, ...] = ()
    compares_published: bool = False
    """Whether the tables contain published results."""


def cell_text(cell: Cell) -> str:
    """Return a cell of a table as text: at most four digits, and a dash for a missing value."""
    if cell is None or (isinstance(cell, float) and math.isnan(cell)):
        return "-"
    if isinstance(cell, float):
        return f"{cell:.4g}"
    return str(cell)


def p_text(cell: Cell) -> str:
    """Return a p value as text: at most four digits, "< 0.0001" below MIN_SHOWN_P, and a dash if it is missing."""
    return f"< {MIN_SHOWN_P:.4f}" if isinstance(cell, float) and cell < MIN_SHOWN_P else cell_text(cell)


def _csv_cell(cell: Cell) -> str:
    if cell is None or (isinstance(cell, float) and math.isnan(cell)):
        return ""
    return repr(float(cell)) if isinstance(cell, float) else str(cell)
