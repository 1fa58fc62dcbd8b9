"""The client for blocking code: `with hapticd.connect() as daemon: ...`.

Each method runs the coroutine of the same name in `methods.py` on the caller's thread (`run`). A lock protects the
DEALER socket for commands, so that threads may share a client. Each subscription has a separate SUB socket and belongs
to one thread.
"""

from __future__ import annotations

import inspect
import os
import threading
import time
from collections.abc import Awaitable, Callable, Coroutine
from contextlib import AbstractAsyncContextManager, AbstractContextManager
from typing import Any, Concatenate, Generic, ParamSpec, Self, TypeVar

import zmq

from hapticd.base import arguments
from hapticd.base.threads import in_background
from hapticd.client import methods, streams
from hapticd.client.base import connect_commands, milliseconds
from hapticd.client.methods import Response, Wait
from hapticd.protocol import calls
from hapticd.protocol.calls import REPLY_TIMEOUT_S
from hapticd.system.paths import RuntimePaths

P = ParamSpec("P")
T = TypeVar("T")
F = TypeVar("F", bound=Callable[..., Any])


def connect(
    runtime_dir: str | os.PathLike[str] | None = None,
    timeout_s: float = REPLY_TIMEOUT_S,
    *,
    wait_s: float = 0.0,
) -> Client:
    """Return a client of a daemon, to be used in `with`.

    `runtime_dir` is by default HAPTICD_RUNTIME_DIR, or else the runtime directory of the user; for a daemon on another
    machine it is a directory with forwarded sockets (docs/remote.md). `timeout_s` is the time that each call waits for
    its reply, `wait_s` the time to wait for a daemon that is starting, both in s. Raises DaemonNotRunning if no daemon
    listens.
    """
    return Client(runtime_dir, timeout_s, wait_s=wait_s)


# ---- Coroutines on the caller's thread -------------------------------------------------------------------------------


class _OnThread(methods.Client):
    """A client whose coroutines block instead of suspending, so that each runs to its end in one step."""

    def __init__(self, place: RuntimePaths, timeout_s: float = REPLY_TIMEOUT_S) -> None:
        super().__init__(place, timeout_s)
        self._lock = threading.Lock()
        # Opened by the first call: subscriptions do not need it.
        self._socket: zmq.Socket[bytes] | None = None

    def _open(self) -> zmq.Socket[bytes]:
        self._refuse_closed()
        socket: zmq.Socket[bytes] = zmq.Context.instance().socket(zmq.DEALER)
        socket.setsockopt(zmq.SNDTIMEO, milliseconds(self.timeout_s))
        socket.setsockopt(zmq.RCVTIMEO, milliseconds(self.timeout_s))
        connect_commands(socket, self.paths)
        self._socket = socket
        return socket

    async def _exchange(self, id: int, body: bytes) -> Response:
        with self._lock:
            socket = self._socket or self._open()
            deadline_s = time.monotonic() + self.timeout_s
            try:
                socket.send(body)
                # Replies to calls that were interrupted may arrive first.
                while True:
                    answered_id, response = calls.decode_response(socket.recv())
                    if answered_id in (id, None):
                        return response
                    if time.monotonic() > deadline_s:
                        raise zmq.Again
            except zmq.Again:
                # Closing the socket discards a late reply to this call.
                socket.close()
                self._socket = None
                raise

    async def _disconnect(self) -> None:
        with self._lock:
            if self._socket is not None:
                self._socket.close()
                self._socket = None

    def _subscriber(self) -> zmq.Socket[Any]:
        return zmq.Context.instance().socket(zmq.SUB)

    async def _receive(self, socket: zmq.Socket[Any], timeout_s: float) -> list[bytes]:
        socket.setsockopt(zmq.RCVTIMEO, milliseconds(timeout_s))
        return socket.recv_multipart()

    @staticmethod
    async def _in_thread(work: Callable[..., T], /, *given: Any) -> T:
        return work(*given)

    def _start(self, name: str, work: Callable[[Wait], Coroutine[Any, Any, None]]) -> Callable[[], Awaitable[None]]:
        stop = threading.Event()

        async def wait(seconds: float) -> bool:
            return stop.wait(seconds)

        done = in_background(name, lambda: run(work(wait)))

        async def end() -> None:
            stop.set()
            done.result()

        return end

    def _blocking(self) -> Client:
        return Client(self.paths.directory, self.timeout_s)


def run(coroutine: Coroutine[Any, Any, T]) -> T:
    """Run a coroutine of a blocking client and return its result."""
    try:
        coroutine.send(None)
    except StopIteration as end:
        result: T = end.value
        return result
    coroutine.close()
    raise RuntimeError(f"{coroutine} has paused, which a coroutine of a blocking client must not do")


def _like(method: F, described: Callable[..., Any]) -> F:
    """Return `method` with the name, the signature and the docstring of `described`, which it runs."""
    made: Any = method
    signature = inspect.signature(described)
    result = signature.return_annotation.replace("AsyncIterator", "Iterator")
    made.__signature__ = signature.replace(return_annotation=result)
    made.__annotations__ = {**described.__annotations__, "return": result}
    made.__name__, made.__qualname__, made.__doc__ = described.__name__, described.__qualname__, described.__doc__
    return method


def _method(
    described: Callable[Concatenate[methods.Client, P], Coroutine[Any, Any, T]],
) -> Callable[Concatenate[Client, P], T]:
    def method(self: Client, /, *args: P.args, **kwargs: P.kwargs) -> T:
        return run(described(self._client, *args, **kwargs))

    return _like(method, described)


def _block(
    described: Callable[Concatenate[methods.Client, P], AbstractAsyncContextManager[T]],
) -> Callable[Concatenate[Client, P], AbstractContextManager[T]]:
    def method(self: Client, /, *args: P.args, **kwargs: P.kwargs) -> AbstractContextManager[T]:
        return _Block(described(self._client, *args, **kwargs))

    return _like(method, described)


def _subscription(
    described: Callable[Concatenate[methods.Client, P], methods.Subscription[T]],
) -> Callable[Concatenate[Client, P], Subscription[T]]:
    def method(self: Client, /, *args: P.args, **kwargs: P.kwargs) -> Subscription[T]:
        return Subscription(described(self._client, *args, **kwargs))

    return _like(method, described)


class _Block(AbstractContextManager[T]):
    """A context manager for `with` that runs an asynchronous context manager of a blocking client."""

    def __init__(self, context: AbstractAsyncContextManager[T]) -> None:
        self._context = context

    def __enter__(self) -> T:
        return run(self._context.__aenter__())

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: Any) -> bool | None:
        return run(self._context.__aexit__(kind, error, trace))


# ---- The client ------------------------------------------------------------------------------------------------------


class Client:
    """The methods of the protocol, by the same names; each returns its result as a dictionary.

    Every method raises RemoteError if the daemon refuses the call, and DaemonNotRunning if no reply arrives within
    `timeout_s`. A failed call is not repeated.
    """

    def __init__(
        self,
        runtime_dir: str | os.PathLike[str] | None = None,
        timeout_s: float = REPLY_TIMEOUT_S,
        *,
        wait_s: float = 0.0,
    ) -> None:
        """Connect to a daemon; the arguments are those of `connect`."""
        timeout_s, wait_s = arguments.seconds("timeout_s", timeout_s), arguments.seconds("wait_s", wait_s, zero=True)
        self._client = run(_OnThread._connected(runtime_dir, timeout_s, wait_s))
        self.paths: RuntimePaths = self._client.paths

    @property
    def timeout_s(self) -> float:
        """Time that each call waits for its reply, in s."""
        return self._client.timeout_s

    @timeout_s.setter
    def timeout_s(self, timeout_s: float) -> None:
        self._client.timeout_s = timeout_s

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    close = _method(methods.Client.close)
    call = _method(methods.Client.call)
    get_status = _method(methods.Client.get_status)
    get_state = _method(methods.Client.get_state)
    state = _method(methods.Client.state)
    get_config = _method(methods.Client.get_config)
    get_scene = _method(methods.Client.get_scene)
    set_scene = _method(methods.Client.set_scene)
    update_scene = _method(methods.Client.update_scene)
    get_materials = _method(methods.Client.get_materials)
    set_materials = _method(methods.Client.set_materials)
    update_materials = _method(methods.Client.update_materials)
    apply = _method(methods.Client.apply)
    play = _method(methods.Client.play)
    reset = _method(methods.Client.reset)
    mark = _method(methods.Client.mark)
    set_forces = _method(methods.Client.set_forces)
    set_operator = _method(methods.Client.set_operator)
    wait_gesture = _method(methods.Client.wait_gesture)
    lease = _method(methods.Client.lease)
    reload = _method(methods.Client.reload)
    dump_flight = _method(methods.Client.dump_flight)
    hold_lease = _block(methods.Client.hold_lease)
    record = _block(methods.Client.record)
    samples = _subscription(methods.Client.samples)
    states = _subscription(methods.Client.states)
    events = _subscription(methods.Client.events)
    statuses = _subscription(methods.Client.statuses)
    telemetry = _subscription(methods.Client.telemetry)

    def stream(self) -> Stream:
        """Return a stream of targets or forces, as described by methods.Client.stream."""
        self._client._refuse_closed()
        return Stream(self._client._sender, None)

    stream = _like(stream, methods.Client.stream)


class Stream(streams.Stream[None]):
    """A stream of targets and forces, for `with daemon.stream() as stream`. Any thread may use it."""


class Subscription(Generic[T]):
    """An endless iterator over telemetry, subscribed from its creation until `close` or the end of `with`."""

    def __init__(self, subscription: methods.Subscription[T]) -> None:
        self._subscription = subscription
        try:
            run(subscription.__aenter__())
        except BaseException:
            self.close()
            raise

    @property
    def closed(self) -> bool:
        """Whether the subscription has ended."""
        return self._subscription.closed

    def close(self) -> None:
        """End the subscription. Closing it again has no effect."""
        self._subscription.close()

    def receive(self, timeout_s: float) -> T | None:
        """Return the next item of telemetry, as described by methods.Subscription.receive."""
        return run(self._subscription.receive(timeout_s))

    receive = _like(receive, methods.Subscription.receive)

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> T:
        try:
            return run(self._subscription.__anext__())
        except StopAsyncIteration:
            raise StopIteration from None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()
