"""The daemon's telemetry, received once and passed on to every page as it came; and whether there is a daemon."""

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

TOPICS: Final = ("samples", "state", "event", "change", "status")
_AT_ONCE: Final = 32
"""So many messages, then others get their turn."""


class Taker(Protocol):
    """Who gets telemetry: it is never waited for."""

    def telemetry(self, topic: str, message: bytes) -> None: ...


class TelemetryHub:
    """One subscription to the daemon; topics that no page wants are not subscribed to."""

    def __init__(self, place: RuntimePaths, changed: Callable[[bool], None] = lambda _: None) -> None:
        """`changed` is called when the daemon comes or goes."""
        self._changed = changed
        self.daemon = False
        """Whether a daemon is there."""
        self._there = asyncio.Event()
        self._socket = zmq.asyncio.Context.instance().socket(zmq.SUB)
        self._socket.setsockopt(zmq.LINGER, 0)
        self._monitor = self._socket.get_monitor_socket(zmq.EVENT_DISCONNECTED | zmq.EVENT_HANDSHAKE_SUCCEEDED)
        self._socket.connect(place.telemetry_endpoint)
        self._wanted: Counter[str] = Counter()
        self._takers: dict[Taker, frozenset[str]] = {}

    def subscribe(self, taker: Taker, topics: frozenset[str]) -> None:
        """From now on `taker` gets the messages of these topics, each [topic, body] as one msgpack array."""
        before = self._takers.pop(taker, frozenset())
        if topics:
            self._takers[taker] = topics
        for topic in topics - before:
            self._wanted[topic] += 1
            if self._wanted[topic] == 1:
                self._socket.setsockopt(zmq.SUBSCRIBE, topic.encode())
        for topic in before - topics:
            self._wanted[topic] -= 1
            if self._wanted[topic] == 0:
                self._socket.setsockopt(zmq.UNSUBSCRIBE, topic.encode())

    async def found(self, wait_s: float) -> None:
        """Returns once a daemon was there, or none came for so long."""
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._there.wait(), wait_s)

    async def run(self) -> None:
        """Until cancelled."""
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
            for _ in range(_AT_ONCE):
                topic, body = await self._socket.recv_multipart()
                self._pass_on(topic.decode(), body)
            await asyncio.sleep(0)

    def _pass_on(self, topic: str, body: bytes) -> None:
        # The body is msgpack already: an array header and the topic before it make one message of both.
        message = b"\x92" + cast(bytes, msgpack.packb(topic)) + body
        for taker, topics in self._takers.items():
            if topic in topics:
                taker.telemetry(topic, message)

    async def _watch(self) -> None:
        while True:
            event = await recv_monitor_message(self._monitor)
            there = event["event"] == zmq.EVENT_HANDSHAKE_SUCCEEDED
            if there != self.daemon:
                self.daemon = there
                if there:
                    self._there.set()
                self._changed(there)
