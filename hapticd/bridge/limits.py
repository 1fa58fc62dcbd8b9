"""How often a line is logged."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

from hapticd.base.token_bucket import Bucket
from hapticd.system.repeated_lines import Repeats

Clock = Callable[[], float]

_LINES: Final = 20.0
_LINES_PER_S: Final = 1.0


class Teller:
    """Tells a line of each kind at once, its repetitions as `repeats` says, and never many a second: whoever knocks at
    the door cannot fill the log."""

    def __init__(self, tell: Callable[[str], None], now: Clock = time.monotonic) -> None:
        self._tell, self._now = tell, now
        self._lines = Bucket(_LINES_PER_S, _LINES, now)
        self._until = 0.0
        self._repeats = Repeats(now, self._room)

    def __len__(self) -> int:
        """Kinds that are remembered."""
        return len(self._repeats)

    def __call__(self, kind: str, line: str) -> None:
        """`kind`: lines of one kind repeat each other."""
        self._repeats.note(kind, lambda since: self._tell(line + since.more))

    def flush(self) -> None:
        """Tells what was held back and is due."""
        self._repeats.flush()

    def _room(self) -> bool:
        now = self._now()
        if now < self._until:
            return False
        self._until = now + self._lines.take(1.0)
        return True
