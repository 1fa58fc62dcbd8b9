"""The columns of a result: name, kind and unit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

Value: TypeAlias = bool | int | float | str | None
Row: TypeAlias = dict[str, Value]
"""One point, by column: `point` first, then what is varied, what is measured, and `error` last."""
Kind: TypeAlias = Literal["number", "integer", "boolean", "text"]
Role: TypeAlias = Literal["point", "varied", "measured", "error"]


@dataclass(frozen=True, slots=True)
class Column:
    """One column."""

    name: str
    kind: Kind
    role: Role
    unit: str = ""
    """As in `N/m`; empty: it has none."""
    description: str = ""


POINT_COLUMN: Final = Column("point", "text", "point", description="Identity of the point: 32 hexadecimal digits.")
ERROR_COLUMN: Final = Column("error", "text", "error", description="Why the point has no result; absent: it has one.")
