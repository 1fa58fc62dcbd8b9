"""The queue of messages to a page: answers, news and telemetry.

Answers and news are sent first and in order; a page that reads them too slowly is closed. Telemetry is sent after them;
beyond a limit its oldest messages are dropped.
"""

from __future__ import annotations

import asyncio
from collections import Counter, deque
from typing import Final

MAX_WAITING_ANSWERS: Final = 512
"""Maximum number of waiting answers and news; beyond it the page is closed."""
MAX_WAITING_ANSWER_BYTES: Final = 16 << 20
"""Maximum size of the waiting answers and news; beyond it the page is closed."""
MAX_WAITING_BY_TOPIC: Final = {"samples": 100, "state": 1, "status": 1, "event": 500, "change": 100}
"""Messages of each topic that may wait: two seconds of samples, but only the newest state and status.

Older messages are dropped. The page sees the gap in `first_tick`, and gets the news {"dropped": {...}}.
"""


class OutboxFullError(Exception):
    """Too many answers or news wait for a page that does not read them."""


class _Waiting:
    """A message of telemetry that waits to be sent; after it was dropped, `message` is empty."""

    __slots__ = ("message", "topic")

    def __init__(self, topic: str, message: bytes) -> None:
        self.topic, self.message = topic, message


class Outbox:
    """The queue of messages to one page. Only the event loop may use it."""

    def __init__(self) -> None:
        self._answers: deque[bytes] = deque()
        self._answer_bytes = 0
        self._telemetry: deque[_Waiting] = deque()
        self._of_topic: dict[str, deque[_Waiting]] = {topic: deque() for topic in MAX_WAITING_BY_TOPIC}
        self._something = asyncio.Event()
        self.dropped: Counter[str] = Counter()
        """Number of dropped messages of telemetry, by topic."""

    def __len__(self) -> int:
        return len(self._answers) + sum(map(len, self._of_topic.values()))

    def answer(self, message: bytes) -> None:
        """Queue an answer to a call, or news. Raises OutboxFullError if too many of them wait."""
        if len(self._answers) >= MAX_WAITING_ANSWERS or self._answer_bytes + len(message) > MAX_WAITING_ANSWER_BYTES:
            raise OutboxFullError
        self._answers.append(message)
        self._answer_bytes += len(message)
        self._something.set()

    def telemetry(self, topic: str, message: bytes) -> None:
        """Queue a message of telemetry, and drop the oldest of its topic if too many wait."""
        waiting, kept = _Waiting(topic, message), self._of_topic[topic]
        if len(kept) >= MAX_WAITING_BY_TOPIC[topic]:
            kept.popleft().message = b""
            self.dropped[topic] += 1
            if len(self._telemetry) > 2 * sum(MAX_WAITING_BY_TOPIC.values()):
                self._telemetry = deque(each for each in self._telemetry if each.message)
        kept.append(waiting)
        self._telemetry.append(waiting)
        self._something.set()

    def close(self) -> None:
        """Drop all waiting messages, up to 20 MB, which the garbage collector would free late."""
        self._answers.clear()
        self._answer_bytes = 0
        self._telemetry.clear()
        for kept in self._of_topic.values():
            kept.clear()

    async def next(self) -> bytes:
        """Wait for the next message to send, and return it."""
        while True:
            if self._answers:
                message = self._answers.popleft()
                self._answer_bytes -= len(message)
                return message
            while self._telemetry:
                waiting = self._telemetry.popleft()
                if waiting.message:
                    self._of_topic[waiting.topic].popleft()
                    return waiting.message
            self._something.clear()
            await self._something.wait()
