"""The connection over which a client streams targets and forces, for both clients: nothing here waits for an answer.

It is one of its own, so that a message never stands behind a call. All streams of a client share it: to the daemon they
are one sender.
"""

from __future__ import annotations

import threading
import time
import warnings
from collections.abc import Callable, Mapping
from typing import Any, Final

import zmq

from hapticd.base.errors import HapticdError
from hapticd.client.methods import Send
from hapticd.protocol import calls, messages, places, streams
from hapticd.protocol.calls import DaemonNotRunning, ForcesOff, RemoteError
from hapticd.protocol.streams import Kind
from hapticd.system.paths import RuntimePaths

ASK_EVERY_S: Final = 0.5
"""One message of each kind in so long has an id: its answer says what is wrong."""
_WAITING: Final = 200
"""So many wait for a daemon that does not read just now; what comes then is dropped."""
_PROBE_EVERY_S: Final = 0.1
_LINGER_MS: Final = 1000


class Sender:
    """Sends the streams of one client. For any thread, one at a time."""

    def __init__(self, place: RuntimePaths, timeout_s: float, connect: Callable[[zmq.Socket[Any]], None]) -> None:
        """`connect` connects a DEALER to the daemon's commands."""
        self._place, self._timeout_s, self._connect = place, timeout_s, connect
        self._lock = threading.Lock()
        self._socket: zmq.Socket[bytes] | None = None
        self._seq: dict[Kind, int] = {"target": 0, "force": 0}
        self._ask_at_s: dict[Kind, float] = {}
        self._asked: set[int] = set()
        self._last_id = 0
        self._sent_s = self._probe_at_s = 0.0
        self.unsent = 0
        """Messages that were dropped here, as the daemon did not read those before; it counts them as lost."""

    def open(self) -> None:
        """Connects, once. Raises DaemonNotRunning."""
        with self._lock:
            if self._socket is not None:
                return
            places.probe(self._place)
            socket: zmq.Socket[bytes] = zmq.Context.instance().socket(zmq.DEALER)
            socket.setsockopt(zmq.SNDHWM, _WAITING)
            self._connect(socket)
            socket.setsockopt(zmq.LINGER, _LINGER_MS)  # the last force is zero
            if not socket.poll(int(1e3 * self._timeout_s), zmq.POLLOUT):
                socket.close(0)
                raise places.no_answer(self._place, self._timeout_s)
            self._socket = socket
            self._sent_s = time.monotonic()

    def send(self, send: Send) -> None:
        """Sends one message, or drops it where the queue is full. Raises DaemonNotRunning, and RemoteError for what the
        daemon answered to one before."""
        with self._lock:
            socket = self._open_socket()
            kind, now_s = send.kind, time.monotonic()
            seq = self._seq[kind]
            self._seq[kind] = seq + 1
            asks = now_s >= self._ask_at_s.get(kind, 0.0)
            if not asks:
                body = streams.write(kind, seq, send.x, send.y)
            else:
                self._ask_at_s[kind] = now_s + ASK_EVERY_S
                body = self._request(f"stream_{kind}", {"seq": seq, streams.VECTORS[kind]: [send.x, send.y]})
            try:
                socket.send(body, zmq.NOBLOCK)
                self._sent_s = now_s
            except zmq.Again:
                if asks:  # nobody got the question: the next message asks
                    self._asked.discard(self._last_id)
                    del self._ask_at_s[kind]
                self._not_taken(now_s)
            if self._asked:
                self._read(socket)

    def settle(self) -> None:
        """Waits until the daemon has what was sent: it answers what comes after that. Raises what it answered, or
        DaemonNotRunning."""
        with self._lock:
            socket = self._open_socket()
            deadline_s = time.monotonic() + self._timeout_s
            try:
                if not socket.poll(int(1e3 * self._timeout_s), zmq.POLLOUT):
                    raise places.no_answer(self._place, self._timeout_s)
                socket.send(self._request("get_config", {}), zmq.NOBLOCK)
                # Answers come in the order of the questions: one before it that has none went to a daemon that is gone.
                last = self._last_id
                while last in self._asked:
                    left_s = deadline_s - time.monotonic()
                    if left_s <= 0 or not socket.poll(int(1e3 * left_s) + 1):
                        raise places.no_answer(self._place, self._timeout_s)
                    self._read(socket)
            finally:
                self._asked.clear()

    def begin(self) -> None:
        """A new stream: its first message of each kind asks."""
        with self._lock:
            self._ask_at_s.clear()

    def _request(self, method: str, params: Mapping[str, object]) -> bytes:
        """The body of a message that is answered."""
        self._last_id += 1
        self._asked.add(self._last_id)
        return messages.request(self._last_id, method, params)

    def close(self) -> None:
        """What was sent still goes out, for a second at most. It may be closed twice, and is not opened again."""
        with self._lock:
            if self._socket is not None:
                self._socket.close()

    def _open_socket(self) -> zmq.Socket[bytes]:
        if self._socket is None or self._socket.closed:
            raise HapticdError("the stream is not open: use it in `with daemon.stream() as stream`")
        return self._socket

    def _not_taken(self, now_s: float) -> None:
        """The queue is full, or nobody is connected. Raises DaemonNotRunning."""
        self.unsent += 1
        try:
            if now_s - self._sent_s > self._timeout_s:
                raise places.no_answer(self._place, self._timeout_s)
            if now_s >= self._probe_at_s:
                self._probe_at_s = now_s + _PROBE_EVERY_S
                places.probe(self._place)
        except HapticdError:
            self._asked.clear()  # no answer comes from there any more
            raise

    def _read(self, socket: zmq.Socket[bytes]) -> None:
        while True:
            try:
                id, response = calls.decode_response(socket.recv(zmq.NOBLOCK))
            except zmq.Again:
                return
            if isinstance(id, int):
                self._asked.discard(id)
            if isinstance(response, RemoteError | DaemonNotRunning):
                raise response
            if isinstance(response, dict) and "warning" in response:
                # Of the line that sends, behind `send`, the stream's `_send` and the method.
                warnings.warn(ForcesOff(str(response["warning"])), stacklevel=5)


class StreamBase:
    """A stream of either client."""

    def __init__(self, sender: Sender) -> None:
        self._sender = sender
        self._pushed = False
        """Whether a force was streamed, which has to end."""

    @property
    def unsent(self) -> int:
        """Messages of this client that were dropped on our side, as the daemon did not read those before in time."""
        return self._sender.unsent

    def _send(self, send: Send) -> None:
        self._sender.send(send)
        self._pushed |= send.kind == "force"

    def _end(self) -> None:
        """Ends the force of this stream. Raises as `Sender.send`."""
        if self._pushed:
            self._pushed = False
            self._sender.send(Send("force", 0.0, 0.0))
