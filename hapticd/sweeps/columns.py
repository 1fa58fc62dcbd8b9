"""The columns of a result table: name, kind and unit."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

from hapticd.base.errors import HapticdError, collapse_whitespace

Value: TypeAlias = bool | int | float | str | None
Row: TypeAlias = dict[str, Value]
"""The values of one point by column name: `point`, varied keys, measured columns, `error`, in this order."""
Kind: TypeAlias = Literal["number", "integer", "boolean", "text"]
Role: TypeAlias = Literal["point", "varied", "measured", "error"]


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a result table, with one value for each point."""

    name: str
    kind: Kind
    role: Role
    unit: str = ""
    """Unit, for example `N/m`; empty for a column without a unit."""
    description: str = ""


POINT_COLUMN: Final = Column("point", "text", "point", description="Identity of the point: 32 hexadecimal digits.")
"""The first column of every row."""
ERROR_COLUMN: Final = Column("error", "text", "error", description="Why the point has no result; null if it has one.")
"""The last column of every row."""


def row_of(columns: Sequence[Column], given: Mapping[str, Value], measured: Callable[[], Row]) -> Row:
    """Return the row of a point: the values `given` and those that `measured` computes, None in all other columns.

    If `measured` raises an error, its columns are None, and the column `error` has the reason.
    """
    row: Row = dict.fromkeys(column.name for column in columns)
    row |= given
    try:
        row |= measured()
    except (HapticdError, MemoryError, ArithmeticError) as error:
        row[ERROR_COLUMN.name] = collapse_whitespace(str(error)) or type(error).__name__
    return row
