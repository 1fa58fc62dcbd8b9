"""Points of a table over a speed or a force: they rise, and between two of them lies a value.

The tick finds the same points (csrc/tick/hd_strike_mode.c).
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Final

MAX_POINTS: Final = 16
"""HD_TUNE_POINTS."""
MIN_STEP: Final = 1e-6
"""Between two speeds (m/s), and between two forces (N)."""


def rising_faults(key: str, points: Sequence[float]) -> Iterator[str]:
    """What is wrong with the first of the points that does not lie MIN_STEP above the one before; `key` names them."""
    for index, (before, point) in enumerate(pairwise(points)):
        if point < before + MIN_STEP:
            yield (
                f"{key}[{index + 1}] must be at least {MIN_STEP:g} above the one before, {before:.15g}, is {point:.15g}"
            )
            return


def around(points: Sequence[float], value: float) -> tuple[int, int, float]:
    """The indices of the points around a value, and how far it is from the first to the second, 0 to 1. Beyond the
    outermost point both are that one."""
    end = bisect_right(points, value)
    if end in (0, len(points)):
        here = max(end - 1, 0)
        return here, here, 0.0
    return end - 1, end, (value - points[end - 1]) / (points[end] - points[end - 1])
