"""A number of a report: where it lies, what it may be, and whether its range is of use for what it is for.

A range that is empty or does not fit into its bits is refused where the field is found (layout.py). The checks here
are about what else makes a number useless: no force one way, steps that are coarser than a hand, an effect that cannot
be renewed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

LEAST_MAGNITUDES: Final = 8
"""Counts from no force to the full one."""
LEAST_POSITIONS: Final = 32
"""Counts from one end of an axis to the other."""
LEAST_ANGLES: Final = 32
"""Counts of a full turn: a direction is then at most 6 degrees off."""
SHORTEST_S: Final = 0.005
"""An effect that ends sooner could not be renewed in time."""
LONGEST_S: Final = 1.0
"""An effect that lasts longer, unless it is asked for, would push long after the daemon has gone."""


@dataclass(frozen=True, slots=True)
class Field:
    """Where a number lies in a report, bits counted after the report id, and what it may be.

    `logical_min` and `logical_max` always fit into `bit_size` bits.
    """

    report_id: int
    """0 where reports are not numbered."""
    bit_offset: int
    bit_size: int
    """1 to 32."""
    logical_min: int
    logical_max: int
    physical_min: int
    physical_max: int
    unit: int
    """A Unit item of HID: nibbles of system, length, mass, time, ..."""
    unit_exponent: int

    @property
    def is_signed(self) -> bool:
        return self.logical_min < 0

    def counts_when_on(self) -> int | None:
        """The number that sets a flag; None where none does. A single bit can be set whatever its range says: some
        devices give it the range 0 to 0, and Linux sets it."""
        if self.bit_size == 1:
            return -1 if self.is_signed else 1
        if self.logical_min <= 1 <= self.logical_max:
            return 1
        return self.logical_max or self.logical_min or None

    def seconds_per_count(self) -> float | None:
        """The physical size of a count where the unit is a time; None where the descriptor gives no time."""
        if self.unit not in (0x1001, 0x1002, 0x1003, 0x1004) or self.logical_max == self.logical_min:
            return None
        if not -12 <= self.unit_exponent <= 7 or self.physical_max <= self.physical_min:
            return None
        step = (self.physical_max - self.physical_min) / (self.logical_max - self.logical_min)
        return step * 10.0**self.unit_exponent

    def counts_per_turn(self) -> float:
        """Counts of a full turn, of a field that holds a direction.

        By its unit (degrees 0x14, radians 0x12) if the range is then a turn within a tenth. Else the range is one turn,
        as Linux takes it: many descriptors take the unit back before the field.
        """
        return (self.logical_max - self.logical_min) / (self._turns() or 1.0)

    def counts_at_north(self) -> float:
        """Counts of an angle of zero, of a field that holds a direction.

        Where the physical range is zero, if that is a turn by its unit, or is 360 of something. Else the counts are
        taken for the angle itself: zero, or what is nearest to it.
        """
        span = self.physical_max - self.physical_min
        is_turn = self._turns() is not None or any(0.9 <= span / (360.0 * 10**tens) <= 1.1 for tens in range(5))
        if is_turn and self.physical_min <= 0 <= self.physical_max:
            return self.logical_min - self.physical_min * (self.logical_max - self.logical_min) / span
        return min(max(0, self.logical_min), self.logical_max)

    def _turns(self) -> float | None:
        """The physical range in turns, if its unit is one of angles and it is about one turn."""
        per_turn = {0x14: 360.0, 0x12: 2 * math.pi}.get(self.unit)
        if per_turn is None or not -12 <= self.unit_exponent <= 7:
            return None
        turns = (self.physical_max - self.physical_min) * 10.0**self.unit_exponent / per_turn
        return turns if 0.9 <= turns <= 1.1 else None


@dataclass(frozen=True, slots=True)
class Entry:
    """A choice that can be made: `value` written into `field`."""

    field: Field
    value: int


@dataclass(frozen=True, slots=True)
class Choice:
    """One of several names: the value of an array, or a bit for each ("bits": those not chosen are 0)."""

    kind: str
    """array or bits."""
    entries: Mapping[str, Entry]


# ---- Is the range of use? --------------------------------------------------------------------------------------------


def magnitude_fault(field: Field) -> str | None:
    """Why a force cannot be told by this magnitude; None: it can."""
    least, most = field.logical_min, field.logical_max
    if most <= 0:
        return f"its range, {least} to {most}, ends without a force above zero"
    if most - max(least, 0) < LEAST_MAGNITUDES:
        return f"its range, {least} to {most}, has fewer than {LEAST_MAGNITUDES} counts from none to full force"
    if least < 0 and -least < most / 2:
        return f"its range, {least} to {most}, has less than half of the force the other way"
    return None


def axis_fault(field: Field) -> str | None:
    """Why this axis does not say where a handle is; None: it does."""
    if field.logical_max - field.logical_min < LEAST_POSITIONS:
        return f"its range, {field.logical_min} to {field.logical_max}, has fewer than {LEAST_POSITIONS} counts"
    return None


def angle_fault(field: Field) -> str | None:
    """Why a direction cannot be told by this angle; None: it can."""
    if field.counts_per_turn() < LEAST_ANGLES:
        return f"its range, {field.logical_min} to {field.logical_max}, has fewer than {LEAST_ANGLES} counts a turn"
    return None


def duration_fault(field: Field, step_s: float, duration_s: float, wanted_s: float) -> str | None:
    """Why effects of this duration, the nearest to the wanted one, are no good; None: they are."""
    told = f"Set Effect: Duration goes from {field.logical_min} to {field.logical_max} in counts of {step_s:g} s"
    if duration_s < SHORTEST_S:
        return (
            f"{told}: it holds no duration of {SHORTEST_S:g} s or more, so that no effect could be renewed in time; "
            "device.hid.quirks: [infinite_duration] does without"
        )
    most_s = max(LONGEST_S, 2.0 * wanted_s)
    if duration_s > most_s:
        return (
            f"{told}: its shortest effect would push for {duration_s:g} s after the daemon has gone, at most "
            f"{most_s:g} s is right; device.hid.quirks: [infinite_duration] accepts it"
        )
    return None
