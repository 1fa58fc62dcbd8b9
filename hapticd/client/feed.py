"""Telemetry, without I/O: what a subscription subscribes to, and what it makes of each message."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Final, Generic, TypeVar, cast, get_args

import zmq

from hapticd.base import arguments
from hapticd.base.errors import HapticdError
from hapticd.protocol import messages
from hapticd.protocol.calls import Topic
from hapticd.protocol.places import ALIVE
from hapticd.protocol.results import GestureEnd, Status
from hapticd.system.paths import RuntimePaths

T = TypeVar("T")


class Feed(Generic[T]):
    """Turns telemetry messages into what a subscription yields.

    `state` comes 60 times a second. Subscriptions take effect in their order, so that the first message of
    any topic shows that those asked for before `state` are in effect. `status` comes every second, however
    little happens, so that silence means that the daemon is gone.
    """

    READY: Final = b"state"

    def __init__(
        self, topics: Sequence[Topic], convert: Callable[[Topic, dict[str, object]], T], newest: bool = False
    ) -> None:
        """`newest`: each item is asked for when it is read, so that those before it are never sent."""
        if not topics:
            raise arguments.wrong("telemetry", f"needs a topic or several; known: {', '.join(get_args(Topic))}")
        for topic in topics:
            arguments.one_of("topic", topic, get_args(Topic))
        self._wanted = frozenset(topic.encode() for topic in topics)
        self._convert = convert
        self.subscriptions: tuple[bytes, ...] = (*sorted((self._wanted | {ALIVE}) - {self.READY}), self.READY)
        self.on_demand: frozenset[bytes] = self._wanted - {ALIVE} if newest else frozenset()
        """To be subscribed to for each item, and unsubscribed from after it."""
        self.surplus = (frozenset({self.READY}) - self._wanted) | self.on_demand
        """To be unsubscribed from as soon as the first message came."""

    def accept(self, frames: list[bytes]) -> tuple[T, ...]:
        """What one message yields: one item, or none where it was not asked for."""
        if len(frames) != 2 or frames[0] not in self._wanted:
            return ()
        message = messages.decode_trusted(frames[1])
        if not isinstance(message, dict):
            raise messages.WireError(messages.Code.INVALID_REQUEST, f"telemetry {frames[0].decode()}: not a map")
        return (self._convert(cast(Topic, frames[0].decode()), message),)


class FeedSocket(Generic[T]):
    """A SUB socket and its feed: what blocking and asyncio subscriptions share."""

    def __init__(self, socket: zmq.Socket[Any], place: RuntimePaths, feed: Feed[T], timeout_s: float) -> None:
        self._place, self._feed, self._timeout_s = place, feed, timeout_s
        self._zmq = socket
        self._first: list[T] = []
        """Items that came before they were asked for."""
        self._ready = False
        socket.setsockopt(zmq.LINGER, 0)
        try:
            for topic in feed.subscriptions:
                socket.setsockopt(zmq.SUBSCRIBE, topic)
            socket.connect(place.telemetry_endpoint)
        except BaseException:
            socket.close()
            raise

    @property
    def closed(self) -> bool:
        return self._zmq.closed

    def close(self) -> None:
        """Ends the subscription; it may be closed twice."""
        self._zmq.close()

    def _accept(self, frames: list[bytes]) -> tuple[T, ...]:
        """What one message yields. The first one shows that all subscriptions are in effect."""
        if not self._ready:
            self._ready = True
            for topic in self._feed.surplus:
                self._zmq.setsockopt(zmq.UNSUBSCRIBE, topic)
        return self._feed.accept(frames)

    @contextmanager
    def _on_demand(self) -> Iterator[None]:
        """Of a subscription to the newest: the next item is asked for."""
        if not self.closed:
            for topic in self._feed.on_demand:
                self._zmq.setsockopt(zmq.SUBSCRIBE, topic)
        try:
            yield
        finally:
            if not self.closed:
                for topic in self._feed.on_demand:
                    self._zmq.setsockopt(zmq.UNSUBSCRIBE, topic)


def gesture_end(started_tick: int, topic: Topic, message: Mapping[str, object]) -> GestureEnd | None:
    """The end of the operator that this tick took, where a message of telemetry, or a status, tells of it.

    Raises HapticdError for a status of a daemon that knows nothing of such an operator.
    """
    if topic == "event":
        ours = message.get("event") == "gesture_end" and message.get("started_tick") == started_tick
        return cast(GestureEnd, message) if ours else None
    operator = cast(Status, message)["operator"]
    ends = [] if operator is None else operator["ends"]
    for end in ends:
        if end["started_tick"] == started_tick:
            return end
    last = None if operator is None else operator["started_tick"]
    forgotten = len(ends) == messages.GESTURE_ENDS and min(end["started_tick"] for end in ends) > started_tick
    if last is None or last < started_tick or forgotten:
        raise HapticdError(
            f"the daemon knows nothing of the operator that tick {started_tick} took: it was started anew since, or "
            f"{messages.GESTURE_ENDS} others ended"
        )
    return None
