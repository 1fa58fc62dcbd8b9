"""The boundary of a condition along one key: a scan finds the first interval with a failure, bisection narrows it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

from hapticd.base.errors import HapticdError
from hapticd.sweeps.columns import Column, Row
from hapticd.sweeps.keys import SweepCondition, SweepRefine

BoundaryState: TypeAlias = Literal["found", "always", "never"]
BOUNDARY_COLUMN: Final = "boundary"
"""Column with the last value at which the condition of `refine` holds."""
BOUNDARY_FAILS_COLUMN: Final = "boundary_fails"
"""Column with the first value at which the condition of `refine` fails."""
BOUNDARY_STATE_COLUMN: Final = "boundary_state"
"""Column with a BoundaryState: whether the boundary was found."""
MAX_BISECTIONS: Final = 200
"""Maximum number of bisections. The search then ends, even if the interval is wider than `within`."""


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
        Column(BOUNDARY_COLUMN, "number", "measured", unit, f"Last {refine.key} at which the condition holds."),
        Column(BOUNDARY_FAILS_COLUMN, "number", "measured", unit, f"First {refine.key} at which it fails."),
        Column(BOUNDARY_STATE_COLUMN, "text", "measured", "", "found, always (holds up to the end) or never."),
        Column("boundary_tried", "integer", "measured", "", "Number of values that were tried."),
    )


def boundary_row(found: Boundary) -> Row:
    """Return the values of the columns of `boundary_columns`."""
    names = (BOUNDARY_COLUMN, BOUNDARY_FAILS_COLUMN, BOUNDARY_STATE_COLUMN, "boundary_tried")
    return dict(zip(names, (found.holds_at, found.fails_at, found.state, found.tried), strict=True))


def holds(refine: SweepRefine, row: Row) -> bool:
    """Return whether a measured row meets the condition. Raises HapticdError if the condition's column has no value."""
    condition = refine.holds
    column = condition.column if isinstance(condition, SweepCondition) else condition
    value = row[column]
    if value is None or isinstance(value, str):
        raise HapticdError(f"refine.holds cannot be evaluated: {column} has no value at this point")
    if isinstance(condition, str):
        return bool(value)
    if condition.at_most is not None and not value <= condition.at_most:
        return False
    return condition.at_least is None or value >= condition.at_least


def boundary_of(refine: SweepRefine, at: Callable[[float], bool]) -> Boundary:
    """Search from `start` to `end` for the boundary of a condition; `at(value)` returns whether the condition holds.

    First, the ends of `scan` intervals from `start` to `end` are tried in order. The first interval at whose end the
    condition fails is then bisected, until it is narrower than `within` or its ends are neighbouring floats.
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
