"""The boundary of a condition along one key: a scan for the first value at which it fails, then bisection."""

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


@dataclass(frozen=True, slots=True)
class Boundary:
    """Where the condition ceases to hold."""

    state: BoundaryState
    """`always`: it holds up to `end`; `never`: it does not hold at `start`."""
    holds_at: float | None
    """The last value at which it was seen to hold."""
    fails_at: float | None
    """The first at which it was seen not to."""
    tried: int


def boundary_columns(refine: SweepRefine, unit: str) -> tuple[Column, ...]:
    """What a refined study has besides its measures."""
    return (
        Column("boundary", "number", "measured", unit, f"Last {refine.key} at which the condition holds."),
        Column("boundary_fails", "number", "measured", unit, f"First {refine.key} at which it does not."),
        Column("boundary_state", "text", "measured", "", "found; always: it holds up to the end; never: nowhere."),
        Column("boundary_tried", "integer", "measured", "", "How many values were tried."),
    )


def holds(refine: SweepRefine, row: Row) -> bool:
    """Whether the condition holds of what was measured. Raises HapticdError where the column has no value."""
    condition = refine.holds
    column = condition.column if isinstance(condition, SweepCondition) else condition
    value = row[column]
    if value is None or isinstance(value, str):
        raise HapticdError(f"{column} has no value here, so that nothing can be said of refine.holds")
    if isinstance(condition, str):
        return bool(value)
    if condition.at_most is not None and not value <= condition.at_most:
        return False
    return condition.at_least is None or value >= condition.at_least


def boundary_of(refine: SweepRefine, at: Callable[[float], bool]) -> Boundary:
    """Searches from `start` towards `end`; `at(value)` says whether the condition holds.

    With `scan` steps, each is tried in turn from `start` on; the first that fails and the one before it are bisected
    until they are within `within` of each other, or neighbouring numbers.
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
    # Exponent and logarithm are avoided in the middle: a square root is the same on every machine.
    return math.sqrt(low) * math.sqrt(high) if part == 0.5 else low * (high / low) ** part


def _near(refine: SweepRefine, low: float, high: float) -> bool:
    width = abs(high - low)
    return width <= (refine.within if refine.spacing == "linear" else refine.within * min(abs(low), abs(high)))
