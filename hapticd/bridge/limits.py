"""How fast a client may be, and how often a line is told."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable
from typing import Final

Clock = Callable[[], float]

TOLD_EVERY_S: Final = 60.0
_REMEMBERED: Final = 256
_LINES: Final = 20.0
_LINES_PER_S: Final = 1.0


class Bucket:
    """A token bucket that may be overdrawn: who took too much waits until it is even again."""

    def __init__(self, per_s: float, burst: float, now: Clock = time.monotonic) -> None:
        self._per_s, self._burst, self._now = per_s, burst, now
        self._level, self._at = burst, now()

    def take(self, amount: float) -> float:
        """Takes it; returns how long to wait before anything more is taken, s."""
        now = self._now()
        self._level = min(self._burst, self._level + (now - self._at) * self._per_s) - amount
        self._at = now
        return max(0.0, -self._level / self._per_s)


class Teller:
    """Tells a line of each kind at once, its repetitions once a minute, and never many a second: whoever knocks at the
    door cannot fill the log."""

    def __init__(self, tell: Callable[[str], None], now: Clock = time.monotonic) -> None:
        self._tell, self._now = tell, now
        self._kinds: OrderedDict[str, tuple[float, int]] = OrderedDict()
        self._lines = Bucket(_LINES_PER_S, _LINES, now)
        self._until = 0.0

    def __call__(self, kind: str, line: str) -> None:
        """`kind`: lines of one kind repeat each other."""
        now = self._now()
        told_at, unsaid = self._kinds.pop(kind, (-TOLD_EVERY_S, 0))
        if now - told_at < TOLD_EVERY_S or now < self._until:
            self._kinds[kind] = (told_at, unsaid + 1)
        else:
            self._kinds[kind] = (now, 0)
            self._until = now + self._lines.take(1.0)
            self._tell(f"{line} ({unsaid} more of these were not told)" if unsaid else line)
        while len(self._kinds) > _REMEMBERED:
            self._kinds.popitem(last=False)
