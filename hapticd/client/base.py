"""What the blocking and the asyncio client share, without I/O."""

from __future__ import annotations

import threading
import warnings
from collections.abc import Callable, Mapping
from typing import Any, TypeVar, cast

import zmq

from hapticd.base import arguments
from hapticd.base.errors import HapticdError
from hapticd.client.feed import Feed, FeedSocket
from hapticd.client.methods import Listen
from hapticd.client.streams import Sender
from hapticd.protocol import calls
from hapticd.protocol.calls import DaemonNotRunning, ForcesOff, RemoteError
from hapticd.protocol.results import LeaseResult
from hapticd.system.paths import RuntimePaths

T = TypeVar("T")
S = TypeVar("S", bound=FeedSocket[Any])


def connect_commands(socket: zmq.Socket[Any], place: RuntimePaths) -> None:
    """Connects a DEALER socket to the commands of a daemon."""
    socket.setsockopt(zmq.LINGER, 0)
    # Nothing waits in a queue for a daemon that is not there: what was meant for a dead one must not reach the next.
    socket.setsockopt(zmq.IMMEDIATE, 1)
    socket.connect(place.command_endpoint)


class ClientBase:
    """A client's place, its calls and its subscriptions."""

    def __init__(self, place: RuntimePaths, timeout_s: float) -> None:
        self.paths: RuntimePaths = place
        self.timeout_s = timeout_s
        self._lock = threading.Lock()
        self._last_id = 0
        self._subscriptions: list[FeedSocket[Any]] = []
        self._closed = False
        self._sender = Sender(place, timeout_s, self._connect)
        self._operator_tick: int | None = None
        """At which the last operator was set here."""

    def _refuse_closed(self) -> None:
        if self._closed:
            raise HapticdError("the client is closed")

    def _encode(self, method: str, params: Mapping[str, object] | None) -> tuple[int, bytes]:
        """The id of the next call, and its body."""
        self._refuse_closed()
        self._last_id += 1
        return self._last_id, calls.encode_request(self._last_id, method, params)

    def _result(self, response: object | RemoteError | DaemonNotRunning, params: Mapping[str, object] | None) -> object:
        """The result of a call, or its error raised."""
        return calls.result_of(response, params)

    def _connect(self, socket: zmq.Socket[Any]) -> None:
        connect_commands(socket, self.paths)

    def _listen(self, listen: Listen[T], subscription: Callable[[RuntimePaths, Feed[T], float], S]) -> S:
        """A subscription that is closed with the client."""
        self._refuse_closed()
        timeout_s = self.timeout_s if listen.timeout_s is None else arguments.seconds("timeout_s", listen.timeout_s)
        made = subscription(self.paths, listen.feed, timeout_s)
        with self._lock:
            self._subscriptions = [other for other in self._subscriptions if not other.closed]
            self._subscriptions.append(made)
        return made

    def _gesture_to_wait_for(self, timeout_s: float | None) -> int:
        """The tick at which the operator was set whose end is waited for."""
        if self._operator_tick is None:
            raise HapticdError("wait_gesture: this client has called no set_operator yet")
        if timeout_s is not None:
            arguments.seconds("timeout_s", timeout_s, zero=True)
        return self._operator_tick


def token_of(lease: LeaseResult) -> str:
    """The token of a lease that is to be held. Raises HapticdError for one of no duration; ForcesOff warns."""
    token = lease["token"]
    if token is None:
        raise HapticdError("duration_s: must be more than 0 to hold a lease")
    if "warning" in lease:
        # Of the line with `with` in it, behind the context manager that asks.
        warnings.warn(ForcesOff(lease["warning"]), stacklevel=4)
    return token


def operator_tick(result: object) -> int:
    """The tick in the result of set_operator."""
    return cast("Mapping[str, int]", result)["tick"]
