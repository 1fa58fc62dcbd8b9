"""Flags: fields that are on or off, and the number that sets them."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hapticd.hid.layout import Field


def number_of_on(field: Field) -> int | None:
    """The number that sets a flag; None where none does. A single bit can be set whatever its range says: some devices
    give it the range 0 to 0, and Linux sets it."""
    if field.bit_size == 1:
        return -1 if field.is_signed else 1
    if field.logical_min <= 1 <= field.logical_max:
        return 1
    return field.logical_max or field.logical_min or None
