"""A recording's file as columns of numbers, before it is read: what every kind of file gives."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from hapticd.analysis.statistics import Floats
from hapticd.base.errors import known_names, quoted

MAX_BYTES: Final = 2**29
MAX_SAMPLES: Final = 20_000_000
MAX_CHANNELS: Final = 64


@dataclass(frozen=True, slots=True)
class Table:
    """What a file holds, before it is read."""

    names: Sequence[str]
    """Of the columns, in their order."""
    read: Callable[[Sequence[int]], list[Floats]]
    """These columns as numbers."""
    units: Mapping[int, str]
    """What the file itself says of the units of its columns; nothing for most."""
    rate_hz: float | None = None
    others: Mapping[str, str] = field(default_factory=dict)
    """What else is in it, and why that is no column."""
    rounded: Callable[[int, Floats], float] = lambda which, values: 0.0
    """To how much a column's numbers are rounded, beyond what they show by themselves."""

    def place(self, column: str | int) -> int:
        """Of the column with this name, or this number from 1. Raises ValueError."""
        if isinstance(column, str) and column in self.names:
            if self.names.count(column) > 1:
                raise ValueError(f"has {self.names.count(column)} columns {quoted(column)}: say its number in the YAML")
            return self.names.index(column)
        number = str(column)
        if number in self.others:
            raise ValueError(f"{shown_name(number)} {self.others[number]}")
        if number.isascii() and number.isdigit() and len(number) < 6 and 1 <= int(number) <= len(self.names):
            return int(number) - 1
        raise ValueError(f"has no column {shown_name(number)}, {known_names(number, map(short_name, self.names))}")


def shown_name(text: str) -> str:
    return f"'{text}'" if text.isprintable() and len(text) <= 60 else quoted(text)


def short_name(name: str) -> str:
    return name if name.isprintable() and len(name) <= 60 else quoted(name)
