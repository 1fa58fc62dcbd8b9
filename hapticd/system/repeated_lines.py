"""Rate limit for repeated lines of the log: the first is logged at once, later ones as sums at doubling intervals.

    14:03:22  40 periods missed
    14:03:23  1,210 periods missed (12.1 %), 31 times, in the last 1 s
    14:03:25  2,377 periods missed (11.9 %), 58 times, in the last 2 s
    14:03:29  ...

The interval doubles with each line, from one second to an hour. After five minutes without a line of a kind, its next
line is logged at once again.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Final

from hapticd.base import wording

MIN_REPEAT_INTERVAL_S: Final = 1.0
"""Shortest interval between two lines of one kind."""
MAX_REPEAT_INTERVAL_S: Final = 3600.0
"""Longest interval between two lines of one kind, unless the caller sets a shorter one."""
MAX_STATE_INTERVAL_S: Final = 60.0
"""Longest interval between two lines about a state that users must know: a fault, a lost device."""
FORGET_AFTER_S: Final = 300.0
"""If no line of a kind came for this time, one line sums up the suppressed ones, and the next is logged at once."""

_log = logging.getLogger("hapticd")


@dataclass(frozen=True, slots=True)
class Since:
    """What one logged line sums up: the number of lines, the time, and the amounts since the previous logged line."""

    times: int = 1
    """Number of lines that the logged line stands for, itself included."""
    seconds: float = 0.0
    """Time since the previous logged line; 0 for a line that is logged at once."""
    amounts: Mapping[str, int] = field(default_factory=dict)
    """Sum of each amount that was passed to `Repeats.note`, by its name."""

    @property
    def window(self) -> str:
        """The time since the previous line as text, `in the last 64 s`; empty for a line that is logged at once."""
        return f"in the last {wording.duration(round(self.seconds) or self.seconds)}" if self.seconds else ""

    @property
    def more(self) -> str:
        """The suffix of a line that stands for several, such as ` (and 12 more in the last 64 s)`; else empty.

        After an interval a single line has the suffix ` (once in the last 64 s)`.
        """
        parts = [f"and {self.times - 1:,} more"] if self.times > 1 else ["once"] if self.seconds else []
        parts += [self.window] if self.seconds else []
        return f" ({' '.join(parts)})" if parts else ""


@dataclass(slots=True)
class _Kind:
    """State of one kind of line: when a line of this kind was last logged, and the sum of lines since then."""

    logged_s: float
    interval_s: float
    max_interval_s: float
    newest_s: float
    waiting: Callable[[Since], None] | None = None
    times: int = 0
    amounts: dict[str, int] = field(default_factory=dict)

    def has_expired(self, now_s: float) -> bool:
        """Return whether the next line of this kind is logged at once, as if it were the first."""
        quiet_s = now_s - self.newest_s
        return self.waiting is None and quiet_s >= FORGET_AFTER_S and now_s - self.logged_s >= MIN_REPEAT_INTERVAL_S


class Repeats:
    """Rate limit for the lines of a log, usable from any thread. Sums that are due are logged by the next `flush`."""

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s = now_s
        self._lock = threading.RLock()
        self._kinds: dict[str, _Kind] = {}

    def line(self, kind: str, level: int, text: str, max_interval_s: float = MAX_REPEAT_INTERVAL_S) -> None:
        """Log `text` now, or later with the number of lines of its kind, unless a newer text replaces it before."""
        self.note(kind, lambda since: _log.log(level, "%s%s", text, since.more), max_interval_s=max_interval_s)

    def note(
        self,
        kind: str,
        log: Callable[[Since], None],
        amounts: Mapping[str, int] | None = None,
        max_interval_s: float = MAX_REPEAT_INTERVAL_S,
    ) -> None:
        """Call `log` now, or later with the sum of all notes of its kind, unless a newer `log` replaces it before.

        `amounts` are added up by their names. `max_interval_s` is the longest interval between two lines.
        """
        with self._lock:
            now_s = self._now_s()
            known = self._kinds.get(kind)
            if known is None or known.has_expired(now_s):
                known = self._kinds[kind] = _Kind(now_s, 0.0, max_interval_s, now_s)
            known.waiting, known.newest_s = log, now_s
            known.times += 1
            for name, amount in (amounts or {}).items():
                known.amounts[name] = known.amounts.get(name, 0) + amount
            if now_s - known.logged_s >= known.interval_s:
                self._log(known, now_s, at_once=known.times == 1)

    def flush(self) -> None:
        """Log the sums of repeated lines that are due, and forget kinds without a line for FORGET_AFTER_S."""
        with self._lock:
            now_s = self._now_s()
            for kind, known in list(self._kinds.items()):
                if known.has_expired(now_s):
                    del self._kinds[kind]
                elif now_s - known.logged_s >= known.interval_s or now_s - known.newest_s >= FORGET_AFTER_S:
                    self._log(known, now_s)

    def finish(self) -> None:
        """Log all remaining sums of repeated lines, at the end of the process."""
        with self._lock:
            now_s = self._now_s()
            for known in self._kinds.values():
                self._log(known, now_s)

    def _log(self, known: _Kind, now_s: float, at_once: bool = False) -> None:
        if known.waiting is None:
            return
        since = Since(known.times, 0.0 if at_once else now_s - known.logged_s, known.amounts)
        log, known.waiting, known.times, known.amounts = known.waiting, None, 0, {}
        known.logged_s = now_s
        known.interval_s = min(max(2 * known.interval_s, MIN_REPEAT_INTERVAL_S), known.max_interval_s)
        log(since)
