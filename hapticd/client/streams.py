"""The connection over which both kinds of client stream targets and forces, without waiting for replies.

It is separate from the connection for calls, so that a message never waits for a call. All streams of a client share
it; so the daemon sees one sender.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Generator, Mapping
from contextlib import nullcontext, suppress
from typing import Any, Final, Generic, Self, TypeVar

import zmq

from hapticd.base import arguments
from hapticd.base.errors import HapticdError
from hapticd.client.base import Owner, connect_commands, warn
from hapticd.protocol import calls, messages, places, streams
from hapticd.protocol.calls import ForcesOff, RemoteError
from hapticd.protocol.streams import MAX_COMPONENT_BY_KIND, Kind
from hapticd.system.paths import RuntimePaths

Sent = TypeVar("Sent")
"""Type of the result of `target` and `force`: None, or with asyncio AlreadySent."""

REPLY_REQUEST_PERIOD_S: Final = 0.5
"""Period in which one message of each kind requests a reply, which reports errors."""
_MAX_QUEUED_MESSAGES: Final = 200
"""Largest number of messages queued while the daemon does not read; further ones are dropped."""
_PROBE_PERIOD_S: Final = 0.1
"""Shortest time between two checks whether a daemon listens."""
_CLOSE_LINGER_MS: Final = 1000
"""Longest time after `close` in which queued messages are still sent."""


class Sender:
    """Sends streamed targets of the simulated hand and forces of one client; thread-safe."""

    def __init__(self, place: RuntimePaths, timeout_s: float, owner: Owner) -> None:
        self._place, self._timeout_s, self.owner = place, timeout_s, owner
        self._lock = threading.Lock()
        self._socket: zmq.Socket[bytes] | None = None
        self._seq: dict[Kind, int] = {"target": 0, "force": 0}
        self._ask_at_s: dict[Kind, float] = {}
        self._last_id = 0
        self._sent_s = self._probe_at_s = 0.0
        self.unsent = 0
        """Number of messages dropped because the queue was full. The daemon counts them as lost."""

    def open(self) -> None:
        """Begin a stream, whose first message of each kind requests a reply; connect if necessary.

        Raises DaemonNotRunning.
        """
        self.owner.refuse_fork()
        with self._lock:
            self._ask_at_s.clear()
            if self._socket is not None:
                return
            places.probe(self._place)
            socket: zmq.Socket[bytes] = zmq.Context.instance().socket(zmq.DEALER)
            socket.setsockopt(zmq.SNDHWM, _MAX_QUEUED_MESSAGES)
            connect_commands(socket, self._place)
            socket.setsockopt(zmq.LINGER, _CLOSE_LINGER_MS)  # so that the last message, a force of zero, is sent
            if not socket.poll(int(1e3 * self._timeout_s), zmq.POLLOUT):
                socket.close(0)
                raise places.no_answer(self._place, self._timeout_s)
            self._socket = socket
            self._sent_s = time.monotonic()

    def send(self, kind: Kind, x: float, y: float) -> None:
        """Send a target or a force, or drop it if the queue is full.

        Raises DaemonNotRunning, or RemoteError if the daemon has refused an earlier message.
        """
        self.owner.refuse_fork()
        with self._lock:
            socket, now_s = self._opened(), time.monotonic()
            seq = self._seq[kind]
            self._seq[kind] = seq + 1
            asks = now_s >= self._ask_at_s.get(kind, 0.0)
            if asks:
                body = self._request(f"stream_{kind}", {"seq": seq, streams.VECTOR_PARAM_BY_KIND[kind]: [x, y]})
            else:
                body = streams.write(kind, seq, x, y)
            try:
                socket.send(body, zmq.NOBLOCK)
            except zmq.Again:
                self._not_queued(now_s)
            else:
                self._sent_s = now_s
                if asks:  # if the message was dropped, the next one requests the reply
                    self._ask_at_s[kind] = now_s + REPLY_REQUEST_PERIOD_S
            while socket.poll(0):
                self._read(socket)

    def settle(self) -> None:
        """Wait until the daemon has processed all sent messages: send a request and wait for its reply.

        Raises RemoteError if the daemon has refused a message, or DaemonNotRunning.
        """
        self.owner.refuse_fork()
        with self._lock:
            socket = self._opened()
            deadline_s = time.monotonic() + self._timeout_s
            if socket.poll(int(1e3 * self._timeout_s), zmq.POLLOUT):
                socket.send(self._request("get_config", {}), zmq.NOBLOCK)
                # Replies arrive in the order of the requests.
                while (left_s := deadline_s - time.monotonic()) > 0 and socket.poll(int(1e3 * left_s) + 1):
                    if self._read(socket) == self._last_id:
                        return
            raise places.no_answer(self._place, self._timeout_s)

    def _request(self, method: str, params: Mapping[str, object]) -> bytes:
        """Return the body of a request with a new id, `_last_id`, so that the daemon replies."""
        self._last_id += 1
        return messages.request(self._last_id, method, params)

    def close(self) -> None:
        """Close the connection for good. Queued messages are still sent for up to a second."""
        with self._lock:
            if self._socket is not None:
                self._socket.close()

    def _opened(self) -> zmq.Socket[bytes]:
        if self._socket is None or self._socket.closed:
            raise HapticdError("the stream is not open: use it in `with daemon.stream() as stream`")
        return self._socket

    def _not_queued(self, now_s: float) -> None:
        """Count a message that was dropped. Raises DaemonNotRunning if no daemon listens or reads."""
        self.unsent += 1
        if now_s - self._sent_s > self._timeout_s:
            raise places.no_answer(self._place, self._timeout_s)
        if now_s >= self._probe_at_s:
            self._probe_at_s = now_s + _PROBE_PERIOD_S
            places.probe(self._place)

    def _read(self, socket: zmq.Socket[bytes]) -> object:
        """Return the id of the next reply of the daemon. Raises the error in the reply."""
        id, response = calls.decode_response(socket.recv())
        if isinstance(response, RemoteError):
            raise response
        if isinstance(response, dict) and "warning" in response:
            warn(ForcesOff(str(response["warning"])))
        return id


class AlreadySent:
    """An awaitable for a message that is already sent; to await it lets other tasks run."""

    def __await__(self) -> Generator[Any, None, None]:
        from asyncio import sleep  # not imported for a blocking client

        return sleep(0).__await__()


class Stream(Generic[Sent]):
    """A stream of targets and forces, for `with daemon.stream() as stream`, or `async with` in asyncio.

    A message is sent when a method is called, from any thread. In asyncio, await the call to let other tasks run.
    """

    def __init__(self, sender: Sender, sent: Sent) -> None:
        """Create a stream whose methods `target` and `force` return `sent`."""
        self._sender, self._sent = sender, sent
        self._pushed = False
        """Whether a force was streamed, so that the end of the block has to send a force of zero."""

    @property
    def unsent(self) -> int:
        """Number of messages that this client has dropped because the daemon did not read earlier ones in time."""
        return self._sender.unsent

    def target(self, x: float, y: float) -> Sent:
        """Send a target position of the simulated hand, in m.

        Raises DaemonNotRunning, or RemoteError if the daemon has refused an earlier message.
        """
        limit_m = MAX_COMPONENT_BY_KIND["target"]
        self._sender.send("target", arguments.within("x", x, limit_m, "m"), arguments.within("y", y, limit_m, "m"))
        return self._sent

    def force(self, fx: float, fy: float) -> Sent:
        """Send a force, in N, that the daemon adds to the rendered force of the scene.

        Raises DaemonNotRunning, or RemoteError if the daemon has refused an earlier message.
        """
        limit_n = MAX_COMPONENT_BY_KIND["force"]
        self._sender.send("force", arguments.within("fx", fx, limit_n, "N"), arguments.within("fy", fy, limit_n, "N"))
        self._pushed = True
        return self._sent

    def __enter__(self) -> Self:
        self._sender.open()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: Any) -> None:
        self._end_force(error)
        if error is None:
            self._sender.settle()

    async def __aenter__(self) -> Self:
        from asyncio import to_thread

        self._sender.owner.refuse_fork()  # the event loop has no threads in the child
        return await to_thread(self.__enter__)

    async def __aexit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: Any) -> None:
        from asyncio import to_thread

        self._end_force(error)  # not in a thread, which might have to wait
        if error is None:
            self._sender.owner.refuse_fork()
            await to_thread(self._sender.settle)

    def _end_force(self, error: BaseException | None) -> None:
        """Send a force of zero if a force was streamed. Raises HapticdError, unless the block raised `error`."""
        if self._pushed:
            self._pushed = False
            with nullcontext() if error is None else suppress(HapticdError):
                self._sender.send("force", 0.0, 0.0)
