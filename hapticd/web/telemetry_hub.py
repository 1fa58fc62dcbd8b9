"""The daemon's telemetry, received once and passed on to every page unchanged, and whether a daemon is connected."""

from __future__ import annotations

import asyncio
import contextlib
from collections import Counter
from collections.abc import Callable
from typing import Final, Protocol, cast

import msgpack
import zmq
import zmq.asyncio
from zmq.utils.monitor import recv_monitor_message

from hapticd.system.paths import RuntimePaths

HUB_TOPICS: Final = ("samples", "state", "event", "change", "status")
"""Topics of the daemon's telemetry."""
_HUB_MESSAGES_PER_TURN: Final = 32
"""Number of messages after which other tasks of the event loop run."""


class Subscriber(Protocol):
    """A receiver of the daemon's telemetry, which must not block."""

    def telemetry(self, topic: str, message: bytes) -> None:
        """Accept a message of telemetry: [topic, body] as one msgpack array."""


class TelemetryHub:
    """One subscription to the daemon's telemetry for all pages; it has only the topics that a page needs."""

    def __init__(self, place: RuntimePaths, changed: Callable[[bool], None] = lambda _: None) -> None:
        """Connect to the daemon at `place`. `changed` is called when the daemon connects or disconnects."""
        self._changed = changed
        self.daemon = False
        """Whether a daemon is connected."""
        self._connected = asyncio.Event()
        self._socket = zmq.asyncio.Context.instance().socket(zmq.SUB)
        self._socket.setsockopt(zmq.LINGER, 0)
        self._monitor = self._socket.get_monitor_socket(zmq.EVENT_DISCONNECTED | zmq.EVENT_HANDSHAKE_SUCCEEDED)
        self._socket.connect(place.telemetry_endpoint)
        self._wanted: Counter[str] = Counter()
        self._subscribers: dict[Subscriber, frozenset[str]] = {}

    def subscribe(self, subscriber: Subscriber, topics: frozenset[str]) -> None:
        """Pass messages of exactly `topics` to `subscriber` from now on; without topics, end its subscription."""
        before = self._subscribers.pop(subscriber, frozenset())
        if topics:
            self._subscribers[subscriber] = topics
        for topic in topics - before:
            self._wanted[topic] += 1
            if self._wanted[topic] == 1:
                self._socket.setsockopt(zmq.SUBSCRIBE, topic.encode())
        for topic in before - topics:
            self._wanted[topic] -= 1
            if self._wanted[topic] == 0:
                self._socket.setsockopt(zmq.UNSUBSCRIBE, topic.encode())

    async def await_daemon(self, wait_s: float) -> None:
        """Wait until a daemon is connected, but at most `wait_s`."""
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._connected.wait(), wait_s)

    async def run(self) -> None:
        """Receive telemetry until cancelled."""
        try:
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self._receive())
                tasks.create_task(self._watch())
        finally:
            self._socket.disable_monitor()
            self._monitor.close()
            self._socket.close()

    async def _receive(self) -> None:
        while True:
            for _ in range(_HUB_MESSAGES_PER_TURN):
                topic, body = await self._socket.recv_multipart()
                self._pass_on(topic.decode(), body)
            await asyncio.sleep(0)

    def _pass_on(self, topic: str, body: bytes) -> None:
        # The body is msgpack: an array header and the topic before it make one message of both.
        message = b"\x92" + cast(bytes, msgpack.packb(topic)) + body
        for subscriber, topics in self._subscribers.items():
            if topic in topics:
                subscriber.telemetry(topic, message)

    async def _watch(self) -> None:
        while True:
            event = await recv_monitor_message(self._monitor)
            connected = event["event"] == zmq.EVENT_HANDSHAKE_SUCCEEDED
            if connected != self.daemon:
                self.daemon = connected
                if connected:
                    self._connected.set()
                self._changed(connected)
