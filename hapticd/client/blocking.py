"""The client for ordinary, blocking code: `with hapticd.connect() as daemon: ...`.

One DEALER socket for commands, used under a lock, so that a client may be shared between threads; each
subscription has a separate SUB socket and belongs to one thread. Its methods stand in `methods.py`.
"""

from __future__ import annotations

import math
import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from types import TracebackType
from typing import TYPE_CHECKING, Concatenate, Generic, ParamSpec, Self, TypeVar, cast

import zmq

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

__all__ = ["Client", "DaemonNotRunning", "RemoteError", "Stream", "Subscription", "TelemetryLoss", "connect"]

P = ParamSpec("P")
T = TypeVar("T")


def connect(
    runtime_dir: str | os.PathLike[str] | None = None,
    timeout_s: float = TIMEOUT_S,
    *,
    wait_s: float = 0.0,
) -> Client:
    """A client of the daemon at `runtime_dir` (by default where the environment says), to be used in `with`.

    `timeout_s` is how long each call waits for its answer. `wait_s` is how long to wait for a daemon that is not ready
    yet. Raises DaemonNotRunning where nobody listens.

    Without `runtime_dir` HAPTICD_RUNTIME_DIR counts, then the user's own. A daemon on another machine is reached by a
    directory of forwarded sockets (docs/remote.md).
    """
    return Client(runtime_dir, timeout_s, wait_s=wait_s)


def _method(described: Callable[P, Call[T]]) -> Callable[Concatenate[Client, P], T]:
    def method(self: Client, /, *args: P.args, **kwargs: P.kwargs) -> T:
        return self._ask(described(*args, **kwargs))

    return documented(method, described, "{}")


def _stream(described: Callable[P, Listen[T]]) -> Callable[Concatenate[Client, P], Subscription[T]]:
    def method(self: Client, /, *args: P.args, **kwargs: P.kwargs) -> Subscription[T]:
        return self._listen(described(*args, **kwargs), Subscription[T])

    return documented(method, described, "Subscription[{}]")


def _sent(described: Callable[P, Send]) -> Callable[Concatenate[Stream, P], None]:
    def method(self: Stream, /, *args: P.args, **kwargs: P.kwargs) -> None:
        self._send(described(*args, **kwargs))

    return documented(method, described, "None", "Stream")


class Client(ClientBase):
    """The daemon's methods, by their names in the protocol; each returns the protocol's result as a
    dictionary.

    Every method raises RemoteError where the daemon refuses, and DaemonNotRunning where it does not answer
    within `timeout_s`; such a call is not repeated later automatically.
    """

    def __init__(
        self,
        runtime_dir: str | os.PathLike[str] | None = None,
        timeout_s: float = TIMEOUT_S,
        *,
        wait_s: float = 0.0,
    ) -> None:
        """As `connect`."""
        timeout_s, wait_s = arguments.seconds("timeout_s", timeout_s), arguments.seconds("wait_s", wait_s, zero=True)
        place = places.place_of(runtime_dir)
        try:
            if wait_s > 0:
                places.await_ready(place, wait_s)
                # The runtime directory may have been made meanwhile.
                place = places.place_of(runtime_dir)
            self._begin(place, timeout_s)
        except DaemonNotRunning as error:
            raise places.after_waiting(error, wait_s) from None

    def _begin(self, place: RuntimePaths, timeout_s: float) -> None:
        super().__init__(place, timeout_s)
        # Opened when it is first used: a subscription needs none.
        self._socket: zmq.Socket[bytes] | None = None
        places.probe(place)

    @classmethod
    def at(cls, place: RuntimePaths, timeout_s: float) -> Self:
        """A client of the daemon at a place that is known."""
        client = cls.__new__(cls)
        client._begin(place, timeout_s)
        return client

    def _open(self) -> zmq.Socket[bytes]:
        socket: zmq.Socket[bytes] = zmq.Context.instance().socket(zmq.DEALER)
        socket.setsockopt(zmq.SNDTIMEO, _milliseconds(self.timeout_s))
        socket.setsockopt(zmq.RCVTIMEO, _milliseconds(self.timeout_s))
        self._connect(socket)
        return socket

    def close(self) -> None:
        """Closes the client and its subscriptions; it may be closed twice."""
        with self._lock:
            self._closed = True
            if self._socket is not None:
                self._socket.close()
            self._sender.close()
            subscriptions, self._subscriptions = self._subscriptions, []
        for subscription in subscriptions:
            subscription.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def call(self, method: str, params: Mapping[str, object] | None = None) -> object:
        """Calls any method of the protocol by its name; returns its result."""
        with self._lock:
            id, body = self._encode(method, params)
            socket = self._socket = self._socket or self._open()
            try:
                socket.send(body)
                response_id, response = calls.decode_response(socket.recv())
                if response_id != id and response_id is not None:
                    response = self._skip_to(socket, id)
            except zmq.Again:
                # The call may still be under way; its answer goes with the socket.
                socket.close()
                self._socket = None
                raise places.no_answer(self.paths, self.timeout_s) from None
        return self._result(response, params)

    def notify(self, method: str, params: Mapping[str, object] | None = None) -> None:
        """Has a method carried out without an answer: nobody learns whether it was."""
        with self._lock:
            self._refuse_closed()
            socket = self._socket = self._socket or self._open()
            try:
                socket.send(messages.notification(method, params))
            except zmq.Again:
                raise places.no_answer(self.paths, self.timeout_s) from None

    def _ask(self, call: Call[T]) -> T:
        result = cast(T, self.call(call.method, call.params))
        if call.method == "set_operator":
            self._operator_tick = operator_tick(result)
        return result

    def _skip_to(self, socket: zmq.Socket[bytes], id: int) -> object | RemoteError | DaemonNotRunning:
        """The answer to `id`, past those to calls that were interrupted."""
        deadline = time.monotonic() + self.timeout_s
        while time.monotonic() < deadline:
            response_id, response = calls.decode_response(socket.recv())
            if response_id == id or response_id is None:
                return response
        raise zmq.Again

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

    def wait_gesture(self, timeout_s: float | None = None) -> GestureEnd:
        """Waits until the hand has done what this client last sent by `set_operator`; returns the event
        `gesture_end`, at once where it is over already.

        Where another operator took its place before the end, by whomever, the event has `completed` false. Raises
        TimedOut after `timeout_s` (None: however long it takes), and DaemonNotRunning for a daemon that goes away.
        """
        started_tick = self._gesture_to_wait_for(timeout_s)
        deadline = math.inf if timeout_s is None else time.monotonic() + timeout_s
        # Who listens first and then asks misses no end.
        with self.telemetry("event", "status") as messages:
            end = gesture_end(started_tick, "status", cast("dict[str, object]", self.get_status()))
            while end is None:
                left_s = deadline - time.monotonic()
                message = messages.receive(max(0.0, min(left_s, self.timeout_s)))
                if message is not None:
                    end = gesture_end(started_tick, *message)
                elif left_s <= self.timeout_s:
                    raise TimedOut(f"wait_gesture: the hand was still under way after {timeout_s:g} s")
                else:
                    raise places.no_telemetry(self.paths, self.timeout_s)
        return end

    def stream(self) -> Stream:
        self._refuse_closed()
        return Stream(self._sender)

    stream = documented(stream, methods.stream, "Stream")

    lease = _method(methods.lease)
    reload = _method(methods.reload)
    dump_flight = _method(methods.dump_flight)

    @contextmanager
    def hold_lease(self, duration_s: float = 1.0) -> Iterator[str]:
        """Holds a lease while the block runs, and gives its token.

        A thread with a separate connection renews it three times within `duration_s`; it dies with the
        process, and the forces fade. Raises at the end of the block where the lease was lost meanwhile.
        Warns (ForcesOff) where a fault keeps the forces off until `set_forces(True)`.
        """
        token = token_of(self.lease(duration_s))
        stop = threading.Event()
        lost: list[HapticdError] = []

        def renew() -> None:
            try:
                with self.at(self.paths, duration_s / 3) as renewer:
                    while not stop.wait(duration_s / 3):
                        # A daemon that is away may come back in time; if not, its answer says that the
                        # lease lapsed.
                        with suppress(DaemonNotRunning):
                            renewer.lease(duration_s, token)
            except HapticdError as error:
                lost.append(error)

        thread = threading.Thread(target=renew, name="hapticd-lease", daemon=True)
        thread.start()
        try:
            yield token
        except BaseException:
            stop.set()
            thread.join()
            with suppress(HapticdError):  # what went wrong in the block is reported
                self.lease(0, token)
            raise
        stop.set()
        thread.join()
        if lost:
            raise lost[0]
        self.lease(0, token)

    @contextmanager
    def record(self, path: str | os.PathLike[str], overwrite: bool = False, **notes: object) -> Iterator[Recorder]:
        """Records every tick and every event while the block runs, into `path`: .npz, or an export of it.

        A thread with a separate connection records. The first sample is taken before the block begins, and what the
        block did last is in the file. `notes` are kept in it as they are, whatever JSON can hold. Gives a Recorder,
        whose `result` is there after the block. Raises HapticdError before the block where `path` is there already
        (unless `overwrite`) or cannot be written, and at its end where the recording ended before. Warns
        (MissedPeriods) at its end where the servo missed too many periods.
        """
        from hapticd.client.background import Recorder

        recorder = Recorder(lambda: self.at(self.paths, self.timeout_s), path, overwrite, notes)
        try:
            recorder.begin()
            yield recorder
        except BaseException:
            with suppress(HapticdError):  # what went wrong in the block is reported
                recorder.end()
            raise
        recorder.end()

    # ---- telemetry -----------------------------------------------------------------------------------------

    samples = _stream(methods.samples)
    states = _stream(methods.states)
    events = _stream(methods.events)
    statuses = _stream(methods.statuses)
    telemetry = _stream(methods.telemetry)


class Stream(StreamBase):
    """Targets and forces, in `with daemon.stream() as stream`. For any thread."""

    target = _sent(methods.target)
    force = _sent(methods.force)

    def __enter__(self) -> Self:
        self._sender.open()
        self._sender.begin()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self._end()
            self._sender.settle()
        else:
            with suppress(HapticdError):  # what went wrong in the block is reported
                self._end()


class Subscription(FeedSocket[T], Generic[T]):
    """An endless iterator over telemetry, in effect from its creation until `close` or the end of `with`."""

    def __init__(self, place: RuntimePaths, feed: Feed[T], timeout_s: float) -> None:
        self._socket: zmq.Socket[bytes] = zmq.Context.instance().socket(zmq.SUB)
        super().__init__(self._socket, place, feed, timeout_s)
        try:
            self._begin()
        except BaseException:
            self.close()
            raise

    def _begin(self) -> None:
        """Waits for the first message of a daemon."""
        deadline = time.monotonic() + self._timeout_s
        while not self._ready:
            try:
                items = self._receive(deadline)
            except zmq.Again:
                raise places.no_telemetry(self._place, self._timeout_s) from None
            self._first += () if self._feed.on_demand else items

    def _receive(self, deadline: float) -> tuple[T, ...]:
        """What the next message yields. Raises zmq.Again."""
        self._socket.setsockopt(zmq.RCVTIMEO, _milliseconds(max(0.0, deadline - time.monotonic())))
        return self._accept(self._socket.recv_multipart())

    def _drain(self) -> None:
        """Of a subscription to the newest: what came since the last item is dropped."""
        with suppress(zmq.Again):
            while self._feed.on_demand:
                self._socket.recv_multipart(zmq.NOBLOCK)

    def receive(self, timeout_s: float) -> T | None:
        """The next item, or None where none comes within `timeout_s`, in seconds. 0: only what has come already.

        Raises InvalidError for a `timeout_s` that is negative or not finite. Unlike the iterator it raises nothing
        where the daemon is silent.
        """
        timeout_s = arguments.seconds("timeout_s", timeout_s, zero=True)
        if self._first:
            return self._first.pop(0)
        deadline = time.monotonic() + timeout_s
        self._drain()
        with self._on_demand(), suppress(zmq.Again):
            while True:
                if items := self._receive(deadline):
                    return items[0]
        return None

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> T:
        if self._first:
            return self._first.pop(0)
        if self.closed:
            raise StopIteration
        self._drain()
        with self._on_demand():
            while not self.closed:
                try:
                    items = self._receive(time.monotonic() + self._timeout_s)
                except zmq.Again:
                    raise places.no_telemetry(self._place, self._timeout_s) from None
                if items:
                    return items[0]
        raise StopIteration

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _milliseconds(timeout_s: float) -> int:
    return min(int(timeout_s * 1e3 + 0.999), 2**31 - 1)
