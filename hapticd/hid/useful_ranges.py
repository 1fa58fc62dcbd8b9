"""Whether a field's logical range is of use for what the field does: a magnitude, an axis, an angle, a duration.

A range that is empty or does not fit into its bits is refused where the field is found (layout.py). Here stands what
else makes a number useless: no force one way, steps that are coarser than a hand, an effect that cannot be renewed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from hapticd.hid.layout import Field

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
