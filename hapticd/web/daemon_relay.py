"""The connection of one page to the daemon: passes on requests and answers unchanged.

Only the method and the id of a request and the id of an answer are read. The daemon checks everything else.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from typing import Any, Final, cast

import msgpack
import zmq
import zmq.asyncio

from hapticd.base.errors import HapticdError
from hapticd.client.base import connect_commands
from hapticd.protocol import messages, places
from hapticd.protocol.calls import REPLY_TIMEOUT_S
from hapticd.protocol.messages import Code, Id, Request
from hapticd.system.paths import RuntimePaths

_CONNECT_TIMEOUT_S: Final = 1.0
"""Time that a request waits for a daemon to connect, which may be starting."""


class DaemonRelay:
    """The connection of one page to the daemon. Only the running event loop may use it."""

    def __init__(self, place: RuntimePaths, answer: Callable[[bytes], None]) -> None:
        """Connect to the daemon at `place`. `answer` is called with every answer for the page."""
        self._place, self._answer = place, answer
        self._under_way: dict[Id, asyncio.TimerHandle] = {}
        self._waiting: deque[tuple[Id, bytes, float]] = deque()
        """Calls that wait for a daemon, each with the time at which it fails."""
        self._sender: asyncio.Task[None] | None = None
        self._socket = zmq.asyncio.Context.instance().socket(zmq.DEALER)
        connect_commands(self._socket, place)
        self._reader = asyncio.create_task(self._read(), name="page-answers")

    def __len__(self) -> int:
        """Return the number of calls of the page that the daemon has not answered."""
        return len(self._under_way)

    def is_id_free(self, request: Request) -> bool:
        """Return whether no unanswered call of the page has the id of this request."""
        return request.id not in self._under_way

    def notify(self, body: bytes) -> bool:
        """Pass a notification on to the daemon; return False if no daemon accepted it."""
        return not self._waiting and self._send(body)

    def call(self, request: Request, body: bytes) -> None:
        """Pass a call on to the daemon, in the order of calls; the answer or an error goes to the function `answer`."""
        loop = asyncio.get_running_loop()
        self._under_way[request.id] = loop.call_later(REPLY_TIMEOUT_S, self._fail, request.id, None)
        if self._waiting or not self._send(body):
            self._waiting.append((request.id, body, loop.time() + _CONNECT_TIMEOUT_S))
            if self._sender is None or self._sender.done():
                self._sender = asyncio.create_task(self._send_waiting(), name="page-calls")

    def _send(self, body: bytes) -> bool:
        # With NOBLOCK, and no other send under way, the future is done at once.
        sent = cast("asyncio.Future[None]", self._socket.send(body, zmq.NOBLOCK))
        try:
            sent.result()
        except zmq.Again:
            return False
        return True

    async def _send_waiting(self) -> None:
        loop = asyncio.get_running_loop()
        while self._waiting:
            id, body, until_s = self._waiting[0]
            if not self._send(body):
                left_s = until_s - loop.time()
                if left_s > 0.0:
                    # pyzmq's type annotations lack the flags.
                    await cast(Any, self._socket).poll(1 + int(1e3 * left_s), zmq.POLLOUT)
                    continue
                self._fail(id, await asyncio.to_thread(places.no_answer, self._place, _CONNECT_TIMEOUT_S))
            self._waiting.popleft()

    def _fail(self, id: Id, problem: HapticdError | None) -> None:
        timer = self._under_way.pop(id, None)
        if timer is None:
            return
        timer.cancel()
        text = problem or f"the daemon at {self._place.directory} did not answer within {REPLY_TIMEOUT_S:g} s"
        self._answer(messages.error_reply(id, Code.DAEMON_AWAY, str(text)))

    async def _read(self) -> None:
        while True:
            body = await self._socket.recv()
            timer = self._under_way.pop(id_of(body), None)
            if timer is not None:  # else the call has timed out and was answered with an error
                timer.cancel()
                self._answer(body)

    async def close(self) -> None:
        """Close the connection. The daemon still carries out the calls under way; their answers are dropped."""
        tasks = [task for task in (self._reader, self._sender) if task is not None]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        for timer in self._under_way.values():
            timer.cancel()
        self._under_way.clear()
        self._socket.close()


def id_of(body: bytes) -> Id:
    """Return the id in the msgpack body of an answer of the daemon; None if there is no id."""
    scanner = msgpack.Unpacker(max_buffer_size=max(len(body), 1), raw=False)
    scanner.feed(body)
    for _ in range(scanner.read_map_header()):
        if scanner.unpack() == "id":
            id: Id = scanner.unpack()
            return id
        scanner.skip()
    return None
