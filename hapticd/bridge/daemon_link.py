"""The daemon as the bridge sees it: its newest status, whether it is there, and telemetry while somebody listens."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Any, Final

import zmq
import zmq.asyncio
from zmq.utils.monitor import recv_monitor_message

from hapticd.base.errors import HapticdError
from hapticd.protocol import calls, messages, places
from hapticd.system.paths import RuntimePaths

STALE_S: Final = 3.0
"""The daemon tells its status every second; where it did not for so long, it is away."""
_BURST: Final = 32
_PILED_UP_S: Final = 0.1
"""So many messages of telemetry in less time have piled up; a daemon sends them in a quarter of a second."""
_REST_S: Final = 0.02


class DaemonLink:
    """Belongs to the running event loop. `lost` is called when the daemon is gone, `publish` with each message of its
    telemetry while `listen` says so."""

    def __init__(
        self,
        context: zmq.asyncio.Context,
        paths: RuntimePaths,
        lost: Callable[[], None],
        publish: Callable[[list[bytes]], None],
    ) -> None:
        self._context, self._paths = context, paths
        self._lost, self._publish = lost, publish
        self._status: dict[str, Any] = {}
        self._status_at = -STALE_S
        self._gone = False
        """The connection has ended, and there is no other yet."""
        self._feed: asyncio.Task[None] | None = None
        self._broken: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    @property
    def status(self) -> dict[str, Any] | None:
        """The result of get_status, a second old at the most; None where the daemon is away."""
        return self._status if time.monotonic() - self._status_at < STALE_S else None

    def missing(self) -> str | None:
        """Why the daemon's command socket takes nobody; None where it does."""
        problem = self._probe()
        return None if problem is None else str(problem)

    def _probe(self) -> HapticdError | None:
        try:
            places.probe(self._paths)
        except HapticdError as error:
            return error
        return None

    def away(self) -> str:
        """Why the daemon does not answer, for who asked from another machine, where our paths mean nothing."""
        missing = self._probe()
        if missing is None or isinstance(missing, calls.DaemonNotRunning):
            return "the daemon behind it does not answer"
        return "it may not use the sockets of the daemon behind it"

    async def run(self) -> None:
        """Listens for the status, until cancelled."""
        with self._subscriber(b"status") as socket:
            monitor = socket.get_monitor_socket(zmq.EVENT_DISCONNECTED | zmq.EVENT_HANDSHAKE_SUCCEEDED)
            try:
                async with asyncio.TaskGroup() as tasks:
                    tasks.create_task(self._read_status(socket))
                    tasks.create_task(self._read_monitor(monitor))
                    tasks.create_task(self._whole())
            finally:
                socket.disable_monitor()
                monitor.close()

    async def _read_status(self, socket: zmq.asyncio.Socket) -> None:
        while True:
            _, body = await socket.recv_multipart()
            status = messages.decode_trusted(body)
            assert isinstance(status, dict)
            if not self._gone:  # else it was on its way, and says nothing of now
                self._status, self._status_at = status, time.monotonic()

    async def _read_monitor(self, monitor: zmq.asyncio.Socket) -> None:
        while True:
            event = (await recv_monitor_message(monitor))["event"]
            self._gone = event == zmq.EVENT_DISCONNECTED
            if self._gone:
                self._status_at = -STALE_S
                self._lost()

    def listen(self, wanted: bool) -> None:
        """Whether telemetry is wanted. Each time all of it is subscribed to at once, so that subscriptions of
        clients take effect in the order that the protocol promises."""
        if wanted and self._feed is None:
            self._feed = asyncio.create_task(self._read_feed(), name="feed")
            self._feed.add_done_callback(self._ended)
        elif not wanted and self._feed is not None:
            self._feed.cancel()
            self._feed = None

    async def _read_feed(self) -> None:
        with self._subscriber(b"") as socket:
            loop = asyncio.get_running_loop()
            while True:
                begin = loop.time()
                for _ in range(_BURST):
                    self._publish(await socket.recv_multipart())
                # What has piled up while this process had to wait is received without giving way to anybody, and is
                # more than a connection keeps: its bytes must go on their way in between.
                if loop.time() - begin < _PILED_UP_S:
                    await asyncio.sleep(_REST_S)

    def _ended(self, feed: asyncio.Task[None]) -> None:
        if not feed.cancelled() and not self._broken.done():
            self._broken.set_exception(feed.exception() or RuntimeError("the feed ended"))

    async def _whole(self) -> None:
        """Fails if the feed does: a bridge without telemetry is to be restarted."""
        await self._broken

    def _subscriber(self, topic: bytes) -> zmq.asyncio.Socket:
        socket = self._context.socket(zmq.SUB)
        socket.setsockopt(zmq.LINGER, 0)
        socket.setsockopt(zmq.SUBSCRIBE, topic)
        socket.connect(self._paths.telemetry_endpoint)
        return socket
