"""A token bucket: so much at once, and so much a second."""

from __future__ import annotations

import time
from collections.abc import Callable


class Bucket:
    """May be overdrawn: who took too much waits until it is even again."""

    def __init__(self, per_s: float, burst: float, now: Callable[[], float] = time.monotonic) -> None:
        self._per_s, self._burst, self._now = per_s, burst, now
        self._level, self._at = burst, now()

    def take(self, amount: float) -> float:
        """Takes it; returns how long to wait before anything more is taken, s."""
        self._fill()
        self._level -= amount
        return max(0.0, -self._level / self._per_s)

    def take_if_there(self, amount: float) -> bool:
        """Takes it where that overdraws nothing; whether it did."""
        self._fill()
        there = self._level >= amount
        self._level -= amount if there else 0.0
        return there

    def _fill(self) -> None:
        now = self._now()
        self._level = min(self._burst, self._level + (now - self._at) * self._per_s)
        self._at = now
