"""Limits of one page: messages, bytes, calls and streamed messages a second, and calls under way."""

from __future__ import annotations

from typing import Final

from hapticd.web.token_bucket import Bucket

MAX_STREAMS_PER_S: Final = 2000.0
"""Maximum rate of streamed messages; messages beyond it are refused."""
MAX_CALLS_PER_S: Final = 200.0
"""Maximum rate of calls; calls beyond it are refused."""
MAX_PENDING_CALLS: Final = 64
"""Maximum number of calls that wait for their answer; calls beyond it are refused."""
MAX_MESSAGES_PER_S: Final = 8000.0
"""Maximum rate at which messages are read; further messages wait in network buffers."""
MAX_RECEIVED_BYTES_PER_S: Final = 8.0 * (1 << 20)
"""Maximum rate at which bytes are read; further bytes wait in network buffers."""


class PageLimits:
    """The limits of one page: rates of its messages and calls, and its calls under way."""

    def __init__(self) -> None:
        self.streams = Bucket(MAX_STREAMS_PER_S, MAX_STREAMS_PER_S / 4)
        self.calls = Bucket(MAX_CALLS_PER_S, MAX_CALLS_PER_S)
        self._messages = Bucket(MAX_MESSAGES_PER_S, MAX_MESSAGES_PER_S / 4)
        self._bytes = Bucket(MAX_RECEIVED_BYTES_PER_S, MAX_RECEIVED_BYTES_PER_S)

    def pace(self, size: int) -> float:
        """Count a message of `size` bytes, and return how long to wait before the next one is read, in s."""
        return max(self._messages.take(1.0), self._bytes.take(size))
