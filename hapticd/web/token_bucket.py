"""A token bucket: limits a rate per second and allows bursts."""

from __future__ import annotations

import time
from collections.abc import Callable


class Bucket:
    """A token bucket that `take` may overdraw."""

    def __init__(self, per_s: float, burst: float, now: Callable[[], float] = time.monotonic) -> None:
        """Begin with a full bucket of `burst` tokens, which gets `per_s` tokens a second."""
        self._per_s, self._burst, self._now = per_s, burst, now
        self._level, self._at = burst, now()

    def take(self, amount: float) -> float:
        """Take `amount` tokens, even if there are fewer; return the time in s until the number of tokens is 0 again."""
        self._fill()
        self._level -= amount
        return max(0.0, -self._level / self._per_s)

    def try_take(self, amount: float) -> bool:
        """Take `amount` tokens and return True; if there are fewer, take none and return False."""
        self._fill()
        there = self._level >= amount
        self._level -= amount if there else 0.0
        return there

    def _fill(self) -> None:
        now = self._now()
        self._level = min(self._burst, self._level + (now - self._at) * self._per_s)
        self._at = now
