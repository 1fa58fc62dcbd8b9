"""The client for asyncio: `async with hapticd.aio.connect() as daemon: ...`.

The methods are those of `hapticd.client.Client`, awaited; several calls may be under way at once. They stand in
`methods.py`.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import threading
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Generator, Mapping
from types import TracebackType
from typing import TYPE_CHECKING, Any, Concatenate, Final, Generic, ParamSpec, Self, TypeAlias, TypeVar, cast

import zmq
import zmq.asyncio

from hapticd.base import arguments
from hapticd.base.errors import HapticdError
from hapticd.client import methods
from hapticd.client.base import ClientBase, operator_tick, token_of
from hapticd.client.feed import Feed, FeedSocket, gesture_end
from hapticd.client.methods import Call, Listen, Send, documented
from hapticd.client.streams import StreamBase
from hapticd.protocol import calls, messages, places
from hapticd.protocol.calls import TIMEOUT_S, DaemonNotRunning, RemoteError, TelemetryLoss, TimedOut
from hapticd.protocol.results import GestureEnd
from hapticd.system.paths import RuntimePaths

if TYPE_CHECKING:
    from hapticd.client.background import Recorder

__all__ = [
    "Client",
    "Connecting",
    "DaemonNotRunning",
    "RemoteError",
    "Stream",
    "Subscription",
    "TelemetryLoss",
    "connect",
]

P = ParamSpec("P")
T = TypeVar("T")
Response: TypeAlias = object | RemoteError | DaemonNotRunning


def connect(
    runtime_dir: str | os.PathLike[str] | None = None,
    timeout_s: float = TIMEOUT_S,
    *,
    wait_s: float = 0.0,
) -> Connecting:
    """A client of the daemon at `runtime_dir` (by default where the environment says):
    `async with connect() as daemon`, or `daemon = await connect()`, which is to be closed.

    `timeout_s` is how long each call waits for its answer. `wait_s` is how long to wait for a daemon that is not ready
    yet. Raises DaemonNotRunning where nobody listens.

    Without `runtime_dir` HAPTICD_RUNTIME_DIR counts, then the user's own. A daemon on another machine is reached by a
    directory of forwarded sockets (docs/remote.md).
    """
    timeout_s, wait_s = arguments.seconds("timeout_s", timeout_s), arguments.seconds("wait_s", wait_s, zero=True)
    return Connecting(lambda: places.place_of(runtime_dir), timeout_s, wait_s)


class Connecting:
    """A client that is still to be connected: await it, or enter it."""

    def __init__(self, find: Callable[[], RuntimePaths], timeout_s: float, wait_s: float) -> None:
        self._find, self._timeout_s, self._wait_s = find, timeout_s, wait_s
        self._client: Client | None = None

    def __await__(self) -> Generator[Any, None, Client]:
        return self._connect().__await__()

    async def __aenter__(self) -> Client:
        self._client = await self._connect()
        return self._client

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._client is not None:
            await self._client.close()

    async def _connect(self) -> Client:
        place = self._find()
        try:
            if self._wait_s > 0:
                await _await_ready(place, self._wait_s)
                # The runtime directory may have been made meanwhile.
                place = self._find()
            await asyncio.to_thread(places.probe, place)
        except DaemonNotRunning as error:
            raise places.after_waiting(error, self._wait_s) from None
        return Client(place, self._timeout_s)


async def _await_ready(place: RuntimePaths, wait_s: float) -> None:
    given_up = threading.Event()
    try:
        await asyncio.to_thread(places.await_ready, place, wait_s, given_up.is_set)
    finally:
        given_up.set()


def _method(described: Callable[P, Call[T]]) -> Callable[Concatenate[Client, P], Coroutine[Any, Any, T]]:
    async def method(self: Client, /, *args: P.args, **kwargs: P.kwargs) -> T:
        return await self._ask(described(*args, **kwargs))

    return documented(method, described, "{}")


def _stream(described: Callable[P, Listen[T]]) -> Callable[Concatenate[Client, P], Subscription[T]]:
    def method(self: Client, /, *args: P.args, **kwargs: P.kwargs) -> Subscription[T]:
        return self._listen(described(*args, **kwargs), Subscription[T])

    return documented(method, described, "Subscription[{}]")


class _Sent:
    """What was sent already; whoever awaits it lets others run."""

    def __await__(self) -> Generator[Any, None, None]:
        return asyncio.sleep(0).__await__()


_SENT: Final = _Sent()


def _sent(described: Callable[P, Send]) -> Callable[Concatenate[Stream, P], Awaitable[None]]:
    def method(self: Stream, /, *args: P.args, **kwargs: P.kwargs) -> Awaitable[None]:
        self._send(described(*args, **kwargs))
        return _SENT

    return documented(method, described, "Awaitable[None]", "Stream")


class Client(ClientBase):
    """The daemon's methods, by their names in the protocol; each returns the protocol's result as a
    dictionary.

    Belongs to the event loop that was running when it was made. Every method raises RemoteError where the
    daemon refuses, and DaemonNotRunning where it does not answer within `timeout_s`.
    """

    def __init__(self, place: RuntimePaths, timeout_s: float = TIMEOUT_S) -> None:
        super().__init__(place, timeout_s)
        self._waiting: dict[int, asyncio.Future[Response]] = {}
        self._opening = asyncio.Lock()
        # Opened when it is first used: a subscription needs none.
        self._socket: zmq.asyncio.Socket | None = None
        self._reader: asyncio.Task[None] | None = None

    async def _opened(self) -> zmq.asyncio.Socket:
        async with self._opening:
            if self._socket is None:
                self._socket = zmq.asyncio.Context.instance().socket(zmq.DEALER)
                self._connect(self._socket)
                self._reader = asyncio.create_task(self._read(self._socket), name="hapticd-answers")
            return self._socket

    async def _read(self, socket: zmq.asyncio.Socket) -> None:
        try:
            while True:
                id, response = calls.decode_response(await socket.recv())
                # An error without an id says that some message was no call; ours are, so that it belongs to
                # none.
                future = self._waiting.pop(id, None) if isinstance(id, int) else None
                if future is not None and not future.done():
                    future.set_result(response)
        except HapticdError as error:
            for future in self._waiting.values():
                if not future.done():
                    future.set_exception(error)

    async def close(self) -> None:
        """Closes the client and its subscriptions; it may be closed twice."""
        self._closed = True
        if self._reader is not None:
            self._reader.cancel()
            await asyncio.gather(self._reader, return_exceptions=True)
        if self._socket is not None:
            self._socket.close()
        self._sender.close()
        for future in self._waiting.values():
            future.cancel()
        for subscription in self._subscriptions:
            subscription.close()
        self._subscriptions.clear()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def call(self, method: str, params: Mapping[str, object] | None = None) -> object:
        """Calls any method of the protocol by its name; returns its result."""
        id, body = self._encode(method, params)
        socket = await self._opened()
        future: asyncio.Future[Response] = asyncio.get_running_loop().create_future()
        self._waiting[id] = future
        try:
            async with asyncio.timeout(self.timeout_s):
                await socket.send(body)
                response = await future
        except TimeoutError:
            raise await asyncio.to_thread(places.no_answer, self.paths, self.timeout_s) from None
        finally:
            self._waiting.pop(id, None)
        return self._result(response, params)

    async def notify(self, method: str, params: Mapping[str, object] | None = None) -> None:
        """Has a method carried out without an answer: nobody learns whether it was."""
        self._refuse_closed()
        socket = await self._opened()
        async with asyncio.timeout(self.timeout_s):
            await socket.send(messages.notification(method, params))

    async def _ask(self, call: Call[T]) -> T:
        result = cast(T, await self.call(call.method, call.params))
        if call.method == "set_operator":
            self._operator_tick = operator_tick(result)
        return result

    # ---- methods -------------------------------------------------------------------------------------------

    get_status = _method(methods.get_status)
    get_state = _method(methods.get_state)
    state = _method(methods.state)
    get_config = _method(methods.get_config)
    get_scene = _method(methods.get_scene)
    set_scene = _method(methods.set_scene)
    update_scene = _method(methods.update_scene)
    get_materials = _method(methods.get_materials)
    set_materials = _method(methods.set_materials)
    update_materials = _method(methods.update_materials)
    apply = _method(methods.apply)
    play = _method(methods.play)
    reset = _method(methods.reset)
    mark = _method(methods.mark)
    set_forces = _method(methods.set_forces)
    set_operator = _method(methods.set_operator)

    async def wait_gesture(self, timeout_s: float | None = None) -> GestureEnd:
        """Waits until the hand has done what this client last sent by `set_operator`; returns the event
        `gesture_end`, at once where it is over already.

        Where another operator took its place before the end, by whomever, the event has `completed` false. Raises
        TimedOut after `timeout_s` (None: however long it takes), and DaemonNotRunning for a daemon that goes away.
        """
        started_tick = self._gesture_to_wait_for(timeout_s)
        try:
            async with asyncio.timeout(timeout_s):
                return await self._gesture_end(started_tick)
        except TimeoutError:
            raise TimedOut(f"wait_gesture: the hand was still under way after {timeout_s:g} s") from None

    async def _gesture_end(self, started_tick: int) -> GestureEnd:
        # Who listens first and then asks misses no end.
        async with self.telemetry("event", "status") as messages:
            end = gesture_end(started_tick, "status", cast("dict[str, object]", await self.get_status()))
            while end is None:
                end = gesture_end(started_tick, *await anext(messages))
            return end

    def stream(self) -> Stream:
        self._refuse_closed()
        return Stream(self._sender)

    stream = documented(stream, methods.stream, "Stream")

    lease = _method(methods.lease)
    reload = _method(methods.reload)
    dump_flight = _method(methods.dump_flight)

    @contextlib.asynccontextmanager
    async def hold_lease(self, duration_s: float = 1.0) -> AsyncIterator[str]:
        """Holds a lease while the block runs, and gives its token.

        A task renews it three times within `duration_s`, as long as the event loop is not held up. Raises
        at the end of the block where the lease was lost meanwhile.
        Warns (ForcesOff) where a fault keeps the forces off until `set_forces(True)`.
        """
        token = token_of(await self.lease(duration_s))
        lost: list[HapticdError] = []

        async def renew() -> None:
            try:
                while True:
                    await asyncio.sleep(duration_s / 3)
                    # A daemon that is away may come back in time; if not, its answer says that the lease
                    # lapsed.
                    with contextlib.suppress(DaemonNotRunning):
                        await self.lease(duration_s, token)
            except HapticdError as error:
                lost.append(error)

        task = asyncio.create_task(renew(), name="hapticd-lease")
        try:
            yield token
        except BaseException:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
            with contextlib.suppress(HapticdError):  # what went wrong in the block is reported
                await self.lease(0, token)
            raise
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        if lost:
            raise lost[0]
        await self.lease(0, token)

    @contextlib.asynccontextmanager
    async def record(
        self, path: str | os.PathLike[str], overwrite: bool = False, **notes: object
    ) -> AsyncIterator[Recorder]:
        """Records every tick and every event while the block runs, into `path`: .npz, or an export of it.

        A thread records, so that the event loop may be held up. The rest is as for `hapticd.client.Client.record`.
        """
        from hapticd.client.background import Recorder
        from hapticd.client.blocking import Client as Blocking

        recorder = Recorder(lambda: Blocking.at(self.paths, self.timeout_s), path, overwrite, notes)
        try:
            await asyncio.to_thread(recorder.begin)
            yield recorder
        except BaseException:
            with contextlib.suppress(HapticdError):  # what went wrong in the block is reported
                await asyncio.to_thread(recorder.end)
            raise
        await asyncio.to_thread(recorder.end)

    # ---- telemetry -----------------------------------------------------------------------------------------

    samples = _stream(methods.samples)
    states = _stream(methods.states)
    events = _stream(methods.events)
    statuses = _stream(methods.statuses)
    telemetry = _stream(methods.telemetry)


class Stream(StreamBase):
    """Targets and forces, in `async with daemon.stream() as stream`. A message is sent when the method is called: to
    await it lets other tasks run, and is not needed."""

    target = _sent(methods.target)
    force = _sent(methods.force)

    async def __aenter__(self) -> Self:
        await asyncio.to_thread(self._sender.open)
        self._sender.begin()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self._end()
            await asyncio.to_thread(self._sender.settle)
        else:
            with contextlib.suppress(HapticdError):  # what went wrong in the block is reported
                self._end()


class Subscription(FeedSocket[T], Generic[T]):
    """An endless asynchronous iterator over telemetry, until `close` or the end of `async with`.

    It is in effect from the entry into `async with`, or else from the first item on.
    """

    def __init__(self, place: RuntimePaths, feed: Feed[T], timeout_s: float) -> None:
        self._socket = zmq.asyncio.Context.instance().socket(zmq.SUB)
        super().__init__(self._socket, place, feed, timeout_s)

    async def _receive(self) -> tuple[T, ...]:
        """What the next message yields."""
        try:
            async with asyncio.timeout(self._timeout_s):
                frames = await self._socket.recv_multipart()
        except TimeoutError:
            raise await asyncio.to_thread(places.no_telemetry, self._place, self._timeout_s) from None
        return self._accept(frames)

    async def _begin(self) -> None:
        """Waits for the first message of a daemon."""
        while not self._ready:
            items = await self._receive()
            self._first += () if self._feed.on_demand else items

    async def _drain(self) -> None:
        """Of a subscription to the newest: what came since the last item is dropped."""
        while self._feed.on_demand and not self.closed and await self._socket.poll(0):
            await self._socket.recv_multipart()

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> T:
        if self._feed.on_demand:
            await self._begin()
            await self._drain()
        if self._first:
            return self._first.pop(0)
        with self._on_demand():
            while not self.closed:
                if items := await self._receive():
                    return items[0]
        raise StopAsyncIteration

    async def __aenter__(self) -> Self:
        await self._begin()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
