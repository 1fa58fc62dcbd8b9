"""The client for asyncio: `async with hapticd.aio.connect() as daemon: ...`.

It runs the coroutines of `methods.py` on an event loop; several calls may run at the same time.
"""

from __future__ import annotations

import asyncio
import os
from collections.abc import Awaitable, Callable, Coroutine, Generator
from typing import Any, TypeVar, cast

import zmq
import zmq.asyncio

from hapticd.base import arguments
from hapticd.base.errors import HapticdError
from hapticd.client import blocking, methods
from hapticd.client.base import connect_commands, milliseconds
from hapticd.client.methods import Response, Wait
from hapticd.protocol import calls
from hapticd.protocol.calls import REPLY_TIMEOUT_S
from hapticd.system.paths import RuntimePaths

T = TypeVar("T")


def connect(
    runtime_dir: str | os.PathLike[str] | None = None,
    timeout_s: float = REPLY_TIMEOUT_S,
    *,
    wait_s: float = 0.0,
) -> Connecting:
    """Return a client of a daemon, to be used in `async with`, or awaited and closed.

    `runtime_dir` is by default HAPTICD_RUNTIME_DIR, or else the runtime directory of the user; for a daemon on another
    machine it is a directory with forwarded sockets (docs/remote.md). `timeout_s` is the time that each call waits for
    its reply, `wait_s` the time to wait for a daemon that is starting, both in s. Raises DaemonNotRunning if no daemon
    listens.
    """
    timeout_s, wait_s = arguments.seconds("timeout_s", timeout_s), arguments.seconds("wait_s", wait_s, zero=True)
    return Connecting(lambda: Client._connected(runtime_dir, timeout_s, wait_s))


class Connecting:
    """A client that is not yet connected: await the object, or use it in `async with`."""

    def __init__(self, connected: Callable[[], Coroutine[Any, Any, Client]]) -> None:
        self._connected = connected
        self._client: Client | None = None

    def __await__(self) -> Generator[Any, None, Client]:
        return self._connected().__await__()

    async def __aenter__(self) -> Client:
        self._client = await self
        return self._client

    async def __aexit__(self, *error: object) -> None:
        if self._client is not None:
            await self._client.close()


class Client(methods.Client):
    """The methods of the protocol, by the same names; each returns its result as a dictionary.

    A client belongs to the event loop in which it was created. Every method raises RemoteError if the daemon refuses
    the call, and DaemonNotRunning if no reply arrives within `timeout_s`.
    """

    def __init__(self, place: RuntimePaths, timeout_s: float = REPLY_TIMEOUT_S) -> None:
        super().__init__(place, timeout_s)
        self._waiting: dict[int, asyncio.Future[Response]] = {}
        # Opened by the first call: subscriptions do not need it.
        self._socket: zmq.asyncio.Socket | None = None
        self._reader: asyncio.Task[None] | None = None

    def _opened(self) -> zmq.asyncio.Socket:
        self._refuse_closed()
        if self._socket is None:
            self._socket = zmq.asyncio.Context.instance().socket(zmq.DEALER)
            connect_commands(self._socket, self.paths)
            self._reader = asyncio.create_task(self._read(self._socket), name="hapticd-answers")
        return self._socket

    async def _read(self, socket: zmq.asyncio.Socket) -> None:
        try:
            while True:
                id, response = calls.decode_response(await socket.recv())
                # An error without an id is about a message that is not a call; this client sends only calls.
                future = self._waiting.get(id) if isinstance(id, int) else None
                if future is not None and not future.done():
                    future.set_result(response)
        except HapticdError as error:
            for future in self._waiting.values():
                if not future.done():
                    future.set_exception(error)

    async def _exchange(self, id: int, body: bytes) -> Response:
        socket = self._opened()
        future: asyncio.Future[Response] = asyncio.get_running_loop().create_future()
        self._waiting[id] = future
        try:
            async with asyncio.timeout(self.timeout_s):
                await socket.send(body)
                return await future
        except TimeoutError:
            raise zmq.Again from None
        finally:
            del self._waiting[id]

    async def _disconnect(self) -> None:
        if self._reader is not None:
            self._reader.cancel()
            await asyncio.gather(self._reader, return_exceptions=True)
        if self._socket is not None:
            self._socket.close()
        for future in self._waiting.values():
            future.cancel()

    def _subscriber(self) -> zmq.Socket[Any]:
        return zmq.asyncio.Context.instance().socket(zmq.SUB)

    async def _receive(self, socket: zmq.Socket[Any], timeout_s: float) -> list[bytes]:
        # asyncio.timeout could cancel recv_multipart after it has taken a message, which would be lost.
        awaited = cast(zmq.asyncio.Socket, socket)
        if not await awaited.poll(milliseconds(timeout_s)):
            raise zmq.Again
        return await awaited.recv_multipart(zmq.NOBLOCK)

    @staticmethod
    async def _in_thread(work: Callable[..., T], /, *given: Any) -> T:
        return await asyncio.to_thread(work, *given)

    def _start(self, name: str, work: Callable[[Wait], Coroutine[Any, Any, None]]) -> Callable[[], Awaitable[None]]:
        async def wait(seconds: float) -> bool:
            await asyncio.sleep(seconds)
            return False

        async def end() -> None:
            task.cancel()
            await asyncio.wait((task,))
            if not task.cancelled():
                task.result()

        task = asyncio.create_task(work(wait), name=name)
        return end

    def _blocking(self) -> blocking.Client:
        return blocking.Client(self.paths.directory, self.timeout_s)
