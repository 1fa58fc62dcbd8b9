"""What waits for subscribers that are behind: for each topic its newest messages, once for all of them.

So a message costs nothing for each of those who do not read, and a thousand of them take no more memory than one.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import Final

MESSAGES: Final = 400
"""Of a topic; eight seconds of samples."""
BYTES: Final = 10 * 1024 * 1024
"""Of a topic, the newest message not counted."""


class _Topic:
    """Its newest messages, each with its number among those of all topics; none while nobody waits for them."""

    __slots__ = ("bytes", "messages", "next", "waiting")

    def __init__(self) -> None:
        self.messages: deque[tuple[int, bytes]] = deque()
        self.bytes = 0
        self.next = 0
        """The number, in this topic, of the message that comes next."""
        self.waiting = 0
        """How many wait for messages of it."""

    @property
    def first(self) -> int:
        return self.next - len(self.messages)

    def put(self, number: int, data: bytes) -> None:
        self.messages.append((number, data))
        self.next += 1
        self.bytes += len(data)
        while len(self.messages) > MESSAGES or (self.bytes > BYTES and len(self.messages) > 1):
            self.bytes -= len(self.messages.popleft()[1])

    def leave(self) -> None:
        self.waiting -= 1
        if not self.waiting:
            self.messages.clear()
            self.bytes = 0


class Reader:
    """Somebody who is behind: what comes next of each topic, and how many it has lost."""

    __slots__ = ("_lost", "next")

    def __init__(self) -> None:
        self.next: dict[bytes, int] = {}
        self._lost = 0


class Backlog:
    """The messages of all topics, and those who wait for them."""

    def __init__(self, topics: Iterable[bytes]) -> None:
        self._topics = {topic: _Topic() for topic in topics}
        self._number = 0

    def put(self, topic: bytes, data: bytes) -> None:
        """A message, for those who are behind."""
        kept = self._topics[topic]
        if kept.waiting:
            kept.put(self._number, data)
            self._number += 1

    def waits(self, topic: bytes) -> bool:
        """Whether somebody is behind with it."""
        return self._topics[topic].waiting > 0

    def join(self, reader: Reader, topic: bytes) -> None:
        """`reader` wants what comes of it from now on."""
        if topic not in reader.next:
            kept = self._topics[topic]
            reader.next[topic] = kept.next
            kept.waiting += 1

    def leave(self, reader: Reader, topic: bytes) -> None:
        """`reader` wants no more of it."""
        if reader.next.pop(topic, None) is not None:
            self._topics[topic].leave()

    def take(self, reader: Reader) -> bytes | None:
        """The oldest message that `reader` has not had; None: it is not behind any more."""
        oldest: tuple[int, bytes, bytes] | None = None
        for topic in reader.next:
            kept = self._topics[topic]
            self._skip(reader, topic, kept)
            if (place := reader.next[topic] - kept.first) < len(kept.messages):
                number, data = kept.messages[place]
                if oldest is None or number < oldest[0]:
                    oldest = number, topic, data
        if oldest is None:
            return None
        _, topic, data = oldest
        reader.next[topic] += 1
        return data

    def lost(self, reader: Reader) -> int:
        """How many messages it lost since this was asked last."""
        for topic in reader.next:
            self._skip(reader, topic, self._topics[topic])
        lost, reader._lost = reader._lost, 0
        return lost

    def _skip(self, reader: Reader, topic: bytes, kept: _Topic) -> None:
        """What is there no more is lost."""
        if (lost := kept.first - reader.next[topic]) > 0:
            reader._lost += lost
            reader.next[topic] = kept.first

    def __len__(self) -> int:
        return sum(len(kept.messages) for kept in self._topics.values())
