"""What waits to be sent to a page: answers, news and telemetry, of which the oldest is dropped.

Answers go first, and in their order. They are bounded, too: a page that reads none of them is closed.
"""

from __future__ import annotations

import asyncio
from collections import Counter, deque
from typing import Final

MOST_ANSWERS: Final = 512
MOST_ANSWER_BYTES: Final = 16 << 20
KEPT: Final = {"samples": 100, "state": 1, "status": 1, "event": 500, "change": 100}
"""Messages of each topic that wait at most: two seconds of samples, of states only the newest. Older ones are dropped;
the page sees the gap in `first_tick`, and is told by {"dropped": {...}}."""


class Overflow(Exception):
    """More answers wait than may: the page does not read them."""


class _Waiting:
    """A message of telemetry, None once a newer one took its place."""

    __slots__ = ("message", "topic")

    def __init__(self, topic: str, message: bytes) -> None:
        self.topic, self.message = topic, message


class Outbox:
    """The queue of one page. Belongs to the event loop."""

    def __init__(self) -> None:
        self._answers: deque[bytes] = deque()
        self._answer_bytes = 0
        self._telemetry: deque[_Waiting] = deque()
        self._of_topic: dict[str, deque[_Waiting]] = {topic: deque() for topic in KEPT}
        self._something = asyncio.Event()
        self.dropped: Counter[str] = Counter()
        """Messages of telemetry that the page never got, by topic."""

    def __len__(self) -> int:
        """Messages that wait."""
        return len(self._answers) + sum(map(len, self._of_topic.values()))

    def answer(self, message: bytes) -> None:
        """Raises Overflow where too much waits already."""
        if len(self._answers) >= MOST_ANSWERS or self._answer_bytes + len(message) > MOST_ANSWER_BYTES:
            raise Overflow
        self._answers.append(message)
        self._answer_bytes += len(message)
        self._something.set()

    def telemetry(self, topic: str, message: bytes) -> None:
        """Never waits, never grows: the oldest of the same topic makes room."""
        waiting, kept = _Waiting(topic, message), self._of_topic[topic]
        if len(kept) >= KEPT[topic]:
            kept.popleft().message = b""
            self.dropped[topic] += 1
            if len(self._telemetry) > 2 * sum(KEPT.values()):
                self._telemetry = deque(each for each in self._telemetry if each.message)
        kept.append(waiting)
        self._telemetry.append(waiting)
        self._something.set()

    def close(self) -> None:
        """Drops what waits, up to 20 MB: a page that is gone is in cycles, which the garbage collector finds late."""
        self._answers.clear()
        self._answer_bytes = 0
        self._telemetry.clear()
        for kept in self._of_topic.values():
            kept.clear()

    async def next(self) -> bytes:
        """The message that is to be sent now."""
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
