"""Lines of the log that repeat each other: the first at once, those that follow as sums at doubling intervals.

    14:03:22  40 periods missed
    14:03:23  1,210 periods missed (12.1 %), 31 times, in the last 1 s
    14:03:25  2,377 periods missed (11.9 %), 58 times, in the last 2 s
    14:03:29  ...

The interval doubles with each line, from one second to an hour. Whoever was quiet for five minutes begins again.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Final

from hapticd.base import wording

SHORTEST_S: Final = 1.0
LONGEST_S: Final = 3600.0
STATE_S: Final = 60.0
"""The longest interval for changes of a state that somebody has to know of: a fault, a lost device."""
QUIET_S: Final = 300.0
"""After so long without one, what is held back is logged, and the next is a first one again."""

_log = logging.getLogger("hapticd")


@dataclass(frozen=True, slots=True)
class Since:
    """What a line sums up: all of its kind since the line before."""

    times: int = 1
    seconds: float = 0.0
    """Since the line before; 0 for a line that is logged at once."""
    amounts: Mapping[str, int] = field(default_factory=dict)
    """Numbers that were added up."""

    @property
    def window(self) -> str:
        """`in the last 64 s`; empty for a line that is logged at once."""
        return f"in the last {wording.duration(round(self.seconds) or self.seconds)}" if self.seconds else ""

    @property
    def more(self) -> str:
        """What follows a line that shows the newest of several: ` (and 12 more in the last 64 s)`, ` (once in the last
        64 s)`."""
        parts = [f"and {self.times - 1:,} more"] if self.times > 1 else ["once"] if self.seconds else []
        parts += [self.window] if self.seconds else []
        return f" ({' '.join(parts)})" if parts else ""


@dataclass(slots=True)
class _Kind:
    """A kind of line that was logged, and what came since."""

    logged_s: float
    interval_s: float
    longest_s: float
    newest_s: float
    waiting: Callable[[Since], None] | None = None
    times: int = 0
    amounts: dict[str, int] = field(default_factory=dict)

    def over(self, now_s: float) -> bool:
        """Whether the next is a first one again."""
        quiet_s = now_s - self.newest_s
        return self.waiting is None and quiet_s >= QUIET_S and now_s - self.logged_s >= SHORTEST_S


class Repeats:
    """Says which lines are logged. For any thread; one calls `flush` now and then, ten times a second say."""

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s = now_s
        self._lock = threading.RLock()
        self._kinds: dict[str, _Kind] = {}

    def line(self, kind: str, level: int, text: str, longest_s: float = LONGEST_S) -> None:
        """Has a line logged of which the newest of several is shown, with their number."""
        self.note(kind, lambda since: _log.log(level, "%s%s", text, since.more), longest_s=longest_s)

    def note(
        self,
        kind: str,
        log: Callable[[Since], None],
        amounts: Mapping[str, int] | None = None,
        longest_s: float = LONGEST_S,
    ) -> None:
        """Has `log` called now, or later with the sum of those that came until then. Of several the newest is called.

        Lines of one kind repeat each other.
        """
        with self._lock:
            now_s = self._now_s()
            known = self._kinds.get(kind)
            if known is None or known.over(now_s):
                known = self._kinds[kind] = _Kind(now_s, 0.0, longest_s, now_s)
            known.waiting, known.newest_s = log, now_s
            known.times += 1
            for name, amount in (amounts or {}).items():
                known.amounts[name] = known.amounts.get(name, 0) + amount
            if now_s - known.logged_s >= known.interval_s:
                self._log(known, now_s, at_once=known.times == 1)

    def flush(self) -> None:
        """Logs the sums that are due, and forgets who was quiet."""
        with self._lock:
            now_s = self._now_s()
            for kind, known in list(self._kinds.items()):
                if known.over(now_s):
                    del self._kinds[kind]
                elif now_s - known.logged_s >= known.interval_s or now_s - known.newest_s >= QUIET_S:
                    self._log(known, now_s)

    def finish(self) -> None:
        """Logs all that is held back, at the end."""
        with self._lock:
            now_s = self._now_s()
            for known in self._kinds.values():
                self._log(known, now_s)

    def _log(self, known: _Kind, now_s: float, at_once: bool = False) -> None:
        if known.waiting is None:
            return
        since = Since(known.times, 0.0 if at_once else now_s - known.logged_s, known.amounts)
        log, known.waiting, known.times, known.amounts = known.waiting, None, 0, {}
        known.logged_s, known.interval_s = now_s, min(max(2 * known.interval_s, SHORTEST_S), known.longest_s)
        log(since)
