"""The connection over which a client streams targets and forces, for both clients: nothing here waits for an answer.

It is one of its own, so that a message never stands behind a call. All streams of a client share it: to the daemon they
are one sender.
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
from hapticd.client.base import connect_commands, warn
from hapticd.protocol import calls, messages, places, streams
from hapticd.protocol.calls import ForcesOff, RemoteError
from hapticd.protocol.streams import MAX_COMPONENT_BY_KIND, Kind
from hapticd.system.paths import RuntimePaths

Sent = TypeVar("Sent")
"""What `target` and `force` return: None, or with asyncio AlreadySent."""

ASK_EVERY_S: Final = 0.5
"""One message of each kind in so long has an id: its answer says what is wrong."""
_WAITING: Final = 200
"""So many wait for a daemon that does not read just now; what comes then is dropped."""
_PROBE_EVERY_S: Final = 0.1
_LINGER_MS: Final = 1000


class Sender:
    """Sends the streams of one client. For any thread, one at a time."""

    def __init__(self, place: RuntimePaths, timeout_s: float) -> None:
        self._place, self._timeout_s = place, timeout_s
        self._lock = threading.Lock()
        self._socket: zmq.Socket[bytes] | None = None
        self._seq: dict[Kind, int] = {"target": 0, "force": 0}
        self._ask_at_s: dict[Kind, float] = {}
        self._last_id = 0
        self._sent_s = self._probe_at_s = 0.0
        self.unsent = 0
        """Messages that were dropped here, as the daemon did not read those before; it counts them as lost."""

    def open(self) -> None:
        """Begins a stream: its first message of each kind asks. Connects, once. Raises DaemonNotRunning."""
        with self._lock:
            self._ask_at_s.clear()
            if self._socket is not None:
                return
            places.probe(self._place)
            socket: zmq.Socket[bytes] = zmq.Context.instance().socket(zmq.DEALER)
            socket.setsockopt(zmq.SNDHWM, _WAITING)
            connect_commands(socket, self._place)
            socket.setsockopt(zmq.LINGER, _LINGER_MS)  # the last force is zero
            if not socket.poll(int(1e3 * self._timeout_s), zmq.POLLOUT):
                socket.close(0)
                raise places.no_answer(self._place, self._timeout_s)
            self._socket = socket
            self._sent_s = time.monotonic()

    def send(self, kind: Kind, x: float, y: float) -> None:
        """Sends one message, or drops it where the queue is full. Raises DaemonNotRunning, and RemoteError for what the
        daemon answered to one before."""
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
                self._not_taken(now_s)
            else:
                self._sent_s = now_s
                if asks:  # where nobody got the question, the next message asks
                    self._ask_at_s[kind] = now_s + ASK_EVERY_S
            while socket.poll(0):
                self._read(socket)

    def settle(self) -> None:
        """Waits until the daemon has what was sent: it answers what comes after that. Raises what it answered, or
        DaemonNotRunning."""
        with self._lock:
            socket = self._opened()
            deadline_s = time.monotonic() + self._timeout_s
            if socket.poll(int(1e3 * self._timeout_s), zmq.POLLOUT):
                socket.send(self._request("get_config", {}), zmq.NOBLOCK)
                # Answers come in the order of the questions.
                while (left_s := deadline_s - time.monotonic()) > 0 and socket.poll(int(1e3 * left_s) + 1):
                    if self._read(socket) == self._last_id:
                        return
            raise places.no_answer(self._place, self._timeout_s)

    def _request(self, method: str, params: Mapping[str, object]) -> bytes:
        """The body of a message that is answered."""
        self._last_id += 1
        return messages.request(self._last_id, method, params)

    def close(self) -> None:
        """What was sent still goes out, for a second at most. It may be closed twice, and is not opened again."""
        with self._lock:
            if self._socket is not None:
                self._socket.close()

    def _opened(self) -> zmq.Socket[bytes]:
        if self._socket is None or self._socket.closed:
            raise HapticdError("the stream is not open: use it in `with daemon.stream() as stream`")
        return self._socket

    def _not_taken(self, now_s: float) -> None:
        """The queue is full, or nobody is connected. Raises DaemonNotRunning."""
        self.unsent += 1
        if now_s - self._sent_s > self._timeout_s:
            raise places.no_answer(self._place, self._timeout_s)
        if now_s >= self._probe_at_s:
            self._probe_at_s = now_s + _PROBE_EVERY_S
            places.probe(self._place)

    def _read(self, socket: zmq.Socket[bytes]) -> object:
        """The id of an answer. Raises the error in it."""
        id, response = calls.decode_response(socket.recv())
        if isinstance(response, RemoteError):
            raise response
        if isinstance(response, dict) and "warning" in response:
            warn(ForcesOff(str(response["warning"])))
        return id


class AlreadySent:
    """A message that was sent already; whoever awaits it lets other tasks run."""

    def __await__(self) -> Generator[Any, None, None]:
        from asyncio import sleep  # which a blocking client does without

        return sleep(0).__await__()


class Stream(Generic[Sent]):
    """Targets and forces, in `with daemon.stream() as stream`, with asyncio in `async with`. For any thread.

    A message is sent when the method is called. With asyncio it may be awaited, which lets other tasks run.
    """

    def __init__(self, sender: Sender, sent: Sent) -> None:
        """`sent`: what `target` and `force` return."""
        self._sender, self._sent = sender, sent
        self._pushed = False
        """Whether a force was streamed, which has to end."""

    @property
    def unsent(self) -> int:
        """Messages of this client that were dropped on our side, as the daemon did not read those before in time."""
        return self._sender.unsent

    def target(self, x: float, y: float) -> Sent:
        """Where the simulated hand wants to be, m. Raises DaemonNotRunning, and RemoteError for a message before."""
        most = MAX_COMPONENT_BY_KIND["target"]
        self._sender.send("target", arguments.within("x", x, most, "m"), arguments.within("y", y, most, "m"))
        return self._sent

    def force(self, fx: float, fy: float) -> Sent:
        """A force that is added to the rendered one, N. Raises DaemonNotRunning, and RemoteError for a message
        before."""
        most = MAX_COMPONENT_BY_KIND["force"]
        self._sender.send("force", arguments.within("fx", fx, most, "N"), arguments.within("fy", fy, most, "N"))
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

        return await to_thread(self.__enter__)

    async def __aexit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: Any) -> None:
        from asyncio import to_thread

        self._end_force(error)  # at once, whatever the threads are busy with
        if error is None:
            await to_thread(self._sender.settle)

    def _end_force(self, error: BaseException | None) -> None:
        """Raises as `Sender.send`, unless something went wrong in the block, which is reported."""
        if self._pushed:
            self._pushed = False
            with nullcontext() if error is None else suppress(HapticdError):
                self._sender.send("force", 0.0, 0.0)
