"""One field of a report: its offset, its range and its unit, and whether its range suits its purpose.

layout.py refuses a range that is empty or does not fit into the field's bits. The checks in this module find ranges
that are useless for other reasons: force in one direction only, too few counts, too short or too long durations.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

MIN_MAGNITUDE_COUNTS: Final = 8
"""A magnitude must have at least this many counts from zero to full force."""
MIN_AXIS_COUNTS: Final = 32
"""An axis must have at least this many counts from one end to the other."""
MIN_COUNTS_PER_TURN: Final = 32
"""A direction must have at least this many counts per turn, so that its error is at most 6 degrees."""
MIN_EFFECT_DURATION_S: Final = 0.005
"""A shorter effect could not be renewed in time."""
MAX_EFFECT_DURATION_S: Final = 1.0
"""Longest duration, unless a longer one is configured: the effects of a killed daemon push until they end."""


@dataclass(frozen=True, slots=True)
class Field:
    """A field of a report that holds one number; bits are counted from the byte after the report id.

    `logical_min` and `logical_max` always fit into `bit_size` bits.
    """

    report_id: int
    """0 if reports have no ids."""
    bit_offset: int
    bit_size: int
    """1 to 32."""
    logical_min: int
    logical_max: int
    physical_min: int
    physical_max: int
    unit: int
    """Data of the Unit item: a nibble for the system of units, then exponents of length, mass, time, ..."""
    unit_exponent: int

    @property
    def is_signed(self) -> bool:
        """Whether the field holds a signed number, in two's complement."""
        return self.logical_min < 0

    def counts_when_on(self) -> int | None:
        """Return the count that sets a flag; None if its range has no such count.

        A single bit can always be set: some devices declare the range 0 to 0, and Linux sets the bit nevertheless.
        """
        if self.bit_size == 1:
            return -1 if self.is_signed else 1
        if self.logical_min <= 1 <= self.logical_max:
            return 1
        return self.logical_max or self.logical_min or None

    def seconds_per_count(self) -> float | None:
        """Return the time of one count, in s; None if the descriptor declares no unit of time."""
        if self.unit not in (0x1001, 0x1002, 0x1003, 0x1004) or self.logical_max == self.logical_min:
            return None
        if not -12 <= self.unit_exponent <= 7 or self.physical_max <= self.physical_min:
            return None
        step = (self.physical_max - self.physical_min) / (self.logical_max - self.logical_min)
        return step * 10.0**self.unit_exponent

    def counts_per_turn(self) -> float:
        """Return the counts of a full turn, for a field that holds a direction.

        The counts follow from the unit (degrees 0x14, radians 0x12), if the physical range in this unit is within 10 %
        of one turn. Otherwise the field's range counts as one turn, as in Linux, because many descriptors reset the
        unit before the field.
        """
        return (self.logical_max - self.logical_min) / (self._turns() or 1.0)

    def counts_at_north(self) -> float:
        """Return the count for an angle of zero, for a field that holds a direction.

        If the physical range is within 10 % of one turn in its unit, or of 360 times a power of ten, this is the count
        whose physical value is zero. Otherwise it is the count nearest to zero.
        """
        span = self.physical_max - self.physical_min
        is_turn = self._turns() is not None or any(0.9 <= span / (360.0 * 10**tens) <= 1.1 for tens in range(5))
        if is_turn and self.physical_min <= 0 <= self.physical_max:
            return self.logical_min - self.physical_min * (self.logical_max - self.logical_min) / span
        return min(max(0, self.logical_min), self.logical_max)

    def _turns(self) -> float | None:
        """Return the field's physical range in turns; None if it is not near one turn, or its unit is not an angle."""
        per_turn = {0x14: 360.0, 0x12: 2 * math.pi}.get(self.unit)
        if per_turn is None or not -12 <= self.unit_exponent <= 7:
            return None
        turns = (self.physical_max - self.physical_min) * 10.0**self.unit_exponent / per_turn
        return turns if 0.9 <= turns <= 1.1 else None


@dataclass(frozen=True, slots=True)
class Entry:
    """An entry of a choice, for example a command of Device Control. Writing `value` into `field` selects the entry."""

    field: Field
    value: int


@dataclass(frozen=True, slots=True)
class Choice:
    """A choice among named entries, for example among the commands of Device Control."""

    kind: str
    """"array": one field holds the value of the entry; "bits": each entry has its own field."""
    entries: Mapping[str, Entry]


# ---- Checks of ranges ------------------------------------------------------------------------------------------------


def magnitude_fault(field: Field) -> str | None:
    """Return why a field cannot hold the magnitude of a force; None if it can."""
    low, high = field.logical_min, field.logical_max
    if high <= 0:
        return f"its range, {low} to {high}, has no count above zero"
    if high - max(low, 0) < MIN_MAGNITUDE_COUNTS:
        return f"its range, {low} to {high}, has fewer than {MIN_MAGNITUDE_COUNTS} counts from none to full force"
    if low < 0 and -low < high / 2:
        return f"its range, {low} to {high}, has less than half of the full force in the negative direction"
    return None


def axis_fault(field: Field) -> str | None:
    """Return why a field cannot hold the position of a handle; None if it can."""
    if field.logical_max - field.logical_min < MIN_AXIS_COUNTS:
        return f"its range, {field.logical_min} to {field.logical_max}, has fewer than {MIN_AXIS_COUNTS} counts"
    return None


def angle_fault(field: Field) -> str | None:
    """Return why a field cannot hold the angle of a direction; None if it can."""
    if field.counts_per_turn() < MIN_COUNTS_PER_TURN:
        return (
            f"its range, {field.logical_min} to {field.logical_max}, has fewer than {MIN_COUNTS_PER_TURN} counts a turn"
        )
    return None


def duration_fault(field: Field, step_s: float, duration_s: float, wanted_s: float) -> str | None:
    """Return why an effect cannot have the duration `duration_s`, the nearest to `wanted_s`; None if it can.

    `field` holds the duration in counts of `step_s`.
    """
    range_s = f"Set Effect: Duration goes from {field.logical_min} to {field.logical_max} in counts of {step_s:g} s"
    if duration_s < MIN_EFFECT_DURATION_S:
        return (
            f"{range_s}: it holds no duration of {MIN_EFFECT_DURATION_S:g} s or more, so no effect could be renewed "
            "in time; device.hid.quirks: [infinite_duration] accepts it"
        )
    max_s = max(MAX_EFFECT_DURATION_S, 2.0 * wanted_s)
    if duration_s > max_s:
        return (
            f"{range_s}: its shortest effect would push for {duration_s:g} s after the daemon was killed, it must be "
            f"at most {max_s:g} s; device.hid.quirks: [infinite_duration] accepts it"
        )
    return None
