"""How much a page may ask: messages and bytes, calls and streamed messages a second, calls under way."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

from hapticd.web.token_bucket import Bucket

STREAMS_PER_S: Final = 2000.0
CALLS_PER_S: Final = 200.0
UNDER_WAY: Final = 64
"""Calls that wait for their answer, and may go on waiting while others are refused."""
MESSAGES_PER_S: Final = 8000.0
BYTES_PER_S: Final = 8.0 * (1 << 20)
"""What comes faster is read later: the page's own network buffers fill, and nobody else notices."""


class PageLimits:
    """Those of one page."""

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self.streams = Bucket(STREAMS_PER_S, STREAMS_PER_S / 4, now)
        self.calls = Bucket(CALLS_PER_S, CALLS_PER_S, now)
        self._messages = Bucket(MESSAGES_PER_S, MESSAGES_PER_S / 4, now)
        self._bytes = Bucket(BYTES_PER_S, BYTES_PER_S, now)

    def pace(self, size: int) -> float:
        """Notes a message of so many bytes; returns how long to wait before the next one is read, s."""
        return max(self._messages.take(1.0), self._bytes.take(size))
