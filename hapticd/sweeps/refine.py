"""The boundary of a condition along one key: a scan for the first value at which it is not met, then bisection."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

from hapticd.base.errors import HapticdError
from hapticd.sweeps.columns import Column, Row
from hapticd.sweeps.keys import SweepCondition, SweepRefine

BoundaryState: TypeAlias = Literal["found", "always", "never"]
MAX_BISECTIONS: Final = 200
"""Maximum number of bisections, even if the interval is still wider than `within`."""


@dataclass(frozen=True, slots=True)
class Boundary:
    """Result of the search for the value at which a condition ceases to hold."""

    state: BoundaryState
    """`always` if the condition holds up to `end`, `never` if it does not hold at `start`."""
    holds_at: float | None
    """The last tried value at which the condition holds, if any."""
    fails_at: float | None
    """The first tried value at which the condition fails, if any."""
    tried: int
    """Number of values that were tried."""


def boundary_columns(refine: SweepRefine, unit: str) -> tuple[Column, ...]:
    """Return the columns that a study with `refine` has in addition to its measures."""
    return (
        Column("boundary", "number", "measured", unit, f"Last {refine.key} at which the condition holds."),
        Column("boundary_fails", "number", "measured", unit, f"First {refine.key} at which it fails."),
        Column("boundary_state", "text", "measured", "", "found, always (holds up to the end) or never."),
        Column("boundary_tried", "integer", "measured", "", "Number of values that were tried."),
    )


def holds(refine: SweepRefine, row: Row) -> bool:
    """Return whether a measured row meets the condition. Raises HapticdError if the condition's column has no value."""
    condition = refine.holds
    column = condition.column if isinstance(condition, SweepCondition) else condition
    value = row[column]
    if value is None or isinstance(value, str):
        raise HapticdError(f"refine.holds cannot be evaluated: {column} has no value here")
    if isinstance(condition, str):
        return bool(value)
    if condition.at_most is not None and not value <= condition.at_most:
        return False
    return condition.at_least is None or value >= condition.at_least


def boundary_of(refine: SweepRefine, at: Callable[[float], bool]) -> Boundary:
    """Search from `start` to `end` for the boundary of a condition; `at(value)` returns whether the condition holds.

    First, the ends of `scan` intervals between `start` and `end` are tried in order. The interval in which the
    condition first fails is then bisected until it is narrower than `within`, or its ends are neighbouring floats.
    """
    tried = 1
    if not at(refine.start):
        return Boundary("never", None, refine.start, tried)
    last, first = refine.start, None
    for step in range(1, refine.scan + 1):
        value = refine.end if step == refine.scan else _between(refine, refine.start, refine.end, step / refine.scan)
        tried += 1
        if not at(value):
            first = value
            break
        last = value
    if first is None:
        return Boundary("always", last, None, tried)
    for _ in range(MAX_BISECTIONS):
        if _near(refine, last, first):
            break
        middle = _between(refine, last, first, 0.5)
        if middle in (last, first):
            break
        tried += 1
        if at(middle):
            last = middle
        else:
            first = middle
    return Boundary("found", last, first, tried)


def _between(refine: SweepRefine, low: float, high: float, part: float) -> float:
    if refine.spacing == "linear":
        return low + part * (high - low)
    # The middle is a product of square roots, which are correctly rounded on every machine; powers are not.
    return math.sqrt(low) * math.sqrt(high) if part == 0.5 else low * (high / low) ** part


def _near(refine: SweepRefine, low: float, high: float) -> bool:
    width = abs(high - low)
    return width <= (refine.within if refine.spacing == "linear" else refine.within * min(abs(low), abs(high)))
