"""Parts of an analysis: tables, pictures and notes. Terminal, CSV files and HTML page show the same numbers."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import dataclass
from typing import Final, TypeAlias

from hapticd.analysis.statistics import Floats
from hapticd.base.yaml_source import Json

Cell: TypeAlias = str | int | float | None
"""A value of a table; None if it is missing."""
MIN_SHOWN_P: Final = 1e-4
"""A smaller p value is shown as "< 0.0001"."""


@dataclass(frozen=True, slots=True)
class ResultTable:
    """A table of results. The header of a column ends with its unit."""

    name: str
    """Name of its CSV file, without the suffix."""
    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    note: str = ""

    def text(self) -> list[tuple[str, ...]]:
        """Return the rows as text, with four digits. A p value below MIN_SHOWN_P is shown as "< 0.0001"."""
        are_p = [head == "p" or head.startswith("p ") for head in self.columns]
        return [
            tuple(p_text(cell) if is_p else cell_text(cell) for cell, is_p in zip(row, are_p, strict=True))
            for row in self.rows
        ]

    def of_text(self) -> tuple[bool, ...]:
        """Return for each column whether it contains only texts, which are aligned left."""
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
    """A picture of values with intervals. Each series has arrays of shape (k,), nan for missing values."""

    title: str
    labels: tuple[str, ...]
    series: tuple[tuple[str, Floats, Floats, Floats], ...]
    """Name, values, lower and upper ends of the intervals."""
    axis: str
    """Label of the axis, with its unit."""
    chance: float | None = None
    """Level of chance, which is drawn as a line, or None."""


@dataclass(frozen=True, slots=True)
class Matrices:
    """A picture of matrices as colours, side by side. Each has shape (rows, columns); nan stays empty."""

    title: str
    rows: tuple[str, ...]
    columns: tuple[str, ...]
    panels: tuple[tuple[str, Floats], ...]
    unit: str
    row_label: str
    column_label: str


@dataclass(frozen=True, slots=True)
class Fitted:
    """A picture of a psychometric function and the proportions that it was fitted to, in percent."""

    title: str
    levels: Floats
    percent: Floats
    low: Floats
    high: Floats
    curve_levels: Floats
    curve_percent: Floats
    threshold: tuple[float, float, float] | None
    """The threshold and the ends of its interval, or None if the answers do not determine it."""
    level_label: str
    logarithmic: bool
    axis: str = "correct answers, %"


@dataclass(frozen=True, slots=True)
class PairedValues:
    """A picture with one line per participant over the conditions. `values` has shape (participants, conditions)."""

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
    """Whether the tables contain published values."""


def cell_text(cell: Cell) -> str:
    """Return a cell as text: at most four digits, a dash for a missing value."""
    if cell is None or (isinstance(cell, float) and math.isnan(cell)):
        return "-"
    if isinstance(cell, float):
        return f"{cell:.4g}"
    return str(cell)


def p_text(cell: Cell) -> str:
    """Return a p value as text, like cell_text, but "< 0.0001" for one below MIN_SHOWN_P."""
    return f"< {MIN_SHOWN_P:.4f}" if isinstance(cell, float) and cell < MIN_SHOWN_P else cell_text(cell)


def _csv_cell(cell: Cell) -> str:
    if cell is None or (isinstance(cell, float) and math.isnan(cell)):
        return ""
    return repr(float(cell)) if isinstance(cell, float) else str(cell)
