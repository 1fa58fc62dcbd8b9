"""The requests of one connection on their way to the daemon, one at a time.

A client that sends more than it may, or faster than the daemon answers, is not read from meanwhile: libzmq and TCP hold
it back. Nothing waits for it: every connection has a separate socket towards the daemon. Messages of streams pass at
once, or are dropped: late they are worth nothing.
"""

from __future__ import annotations

import asyncio
import logging
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import msgpack
import zmq

from hapticd.base.errors import quoted
from hapticd.bridge.accounts import Account
from hapticd.bridge.daemon_link import DaemonLink
from hapticd.protocol import messages, streams

ANSWER_S: Final = 30.0
"""A daemon that says nothing for so long has lost the request."""
_CONNECT_S: Final = 1.0
"""A daemon that restarts has this long to take a request."""
_GRACE_S: Final = 0.1
_STEPS: Final = 64
"""So many at once for one client."""
_LONGEST_ID: Final = 256
_PEEKED: Final = 64
_ID_KEYS: Final = (b"\xa2id", b"\xd9\x02id", b"\xda\x00\x02id", b"\xdb\x00\x00\x00\x02id")
_METHOD_KEYS: Final = (b"\xa6method", b"\xd9\x06method", b"\xda\x00\x06method", b"\xdb\x00\x00\x00\x06method")

_log = logging.getLogger("hapticd.bridge")


class Relay:
    """Between the socket of one client and the daemon's command socket. Belongs to the running event loop.

    Both sockets are checked whenever something happens to one of them, and as long as anything can be done: their
    descriptors tell of changes only.
    """

    def __init__(
        self,
        context: zmq.Context[Any],
        front: zmq.Socket[bytes],
        endpoint: str,
        link: DaemonLink,
        account: Account,
        largest: Callable[[], int],
        read: Callable[[], None],
        failed: Callable[[], None],
    ) -> None:
        """`largest`: the longest message, bytes; `read` is called for each, `failed` after a defect of ours."""
        self._context, self._front, self._endpoint, self._link = context, front, endpoint, link
        self._account, self._largest, self._read, self._failed = account, largest, read, failed
        self._loop = asyncio.get_running_loop()
        self._identity = b""
        self._reply: list[bytes] | None = None
        """For the client, which does not read just now."""
        self._request: _Request | None = None
        self._sent = False
        self._resting = False
        self._timer: asyncio.TimerHandle | None = None
        self._closed = False
        # First what may fail, where there are no descriptors left: the front is then closed by whoever opened it.
        self._back = self._open()
        self._loop.add_reader(int(front.getsockopt(zmq.FD)), self._look)
        self._look()

    def _open(self) -> zmq.Socket[bytes]:
        socket: zmq.Socket[bytes] = zmq.Socket(self._context, zmq.DEALER)
        socket.setsockopt(zmq.LINGER, 0)
        # What was meant for a daemon that died must not reach the next.
        socket.setsockopt(zmq.IMMEDIATE, 1)
        socket.connect(self._endpoint)
        self._loop.add_reader(int(socket.getsockopt(zmq.FD)), self._look)
        return socket

    def close(self) -> None:
        """Nothing is taken or sent from here on."""
        self._closed = True
        self._stop_timer()
        for socket in (self._front, self._back):
            self._loop.remove_reader(int(socket.getsockopt(zmq.FD)))
            socket.close()

    def daemon_lost(self) -> None:
        """The daemon is gone; an answer that is still on its way has a moment."""
        if self._sent:
            message = "the daemon behind it went away before it answered; the request may have been carried out"
            self._wait(_GRACE_S, lambda: self._give_up(message))

    # ---- what can be done --------------------------------------------------------------------------------------------

    def _look(self) -> None:
        try:
            for _ in range(_STEPS):
                if self._closed or not self._step():
                    return
            # Who streams without end must not keep the others waiting.
            self._loop.call_soon(self._look)
        except Exception:
            # A defect of ours costs this connection, nobody else's.
            _log.exception("%s: a connection failed", self._account.name)
            self._failed()

    def _step(self) -> bool:
        """Does one thing, if there is one. Both sockets are asked each time: a descriptor that reported something stays
        readable until its socket was."""
        front, back = _events(self._front), _events(self._back)
        if self._reply is not None:
            # Where the client does not read, everything else waits.
            return bool(front & zmq.POLLOUT) and self._send_reply(self._reply)
        if back & zmq.POLLIN:
            self._reply = self._back.recv_multipart(zmq.NOBLOCK)
            if self._sent:
                self._done()
            return True
        if self._request is not None:
            return not self._sent and not self._resting and self._pass_on(self._request, bool(back & zmq.POLLOUT))
        return bool(front & zmq.POLLIN) and self._take()

    def _send_reply(self, reply: list[bytes]) -> bool:
        try:
            self._front.send_multipart([self._identity, *reply], zmq.NOBLOCK)
        except zmq.ZMQError as error:
            if error.errno != zmq.EHOSTUNREACH:  # the client has gone, and the connection is about to end
                raise
        self._reply = None
        return True

    def _take(self) -> bool:
        self._identity, *frames = self._front.recv_multipart(zmq.NOBLOCK)
        self._read()
        _, body = messages.open_envelope(frames)
        answerable, id = (True, None) if body is None else peek(body)
        self._request = _Request(frames, answerable, id)
        size = sum(map(len, frames))
        if _log.isEnabledFor(logging.DEBUG):
            message = "no request" if body is None else method_in(body) or "a request without a method"
            _log.debug("%s: %s, %d bytes", self._account.name, message, size)
        if size > self._largest():
            message = f"the message has {size} bytes: at most {self._largest()} are taken by the bridge"
            self._refuse(_Request(frames, True, None), messages.Code.PARSE, message)
            return True
        if body is not None and streams.is_stream(body):
            self._stream(frames)
            return True
        wait_s = self._account.take_request()
        if wait_s:
            self._resting = True
            self._wait(wait_s, self._rested)
        return True

    def _stream(self, frames: list[bytes]) -> None:
        """Passes a message of a stream on, if the client may and a daemon takes it."""
        self._done()
        if self._account.take_stream():
            try:
                self._back.send_multipart(frames, zmq.NOBLOCK)
                self._account.streamed += 1
            except zmq.Again:
                self._account.streams_dropped += 1

    def _rested(self) -> None:
        self._resting = False
        self._look()

    def _pass_on(self, request: _Request, connected: bool) -> bool:
        if not connected:
            if self._timer is None:
                self._wait(_CONNECT_S, lambda: self._give_up(f"{self._link.away()}; nothing was carried out"))
            return False
        self._back.send_multipart(request.frames, zmq.NOBLOCK)
        if request.answerable:
            self._sent = True
            message = f"the daemon behind it did not answer within {ANSWER_S:g} s; the request may yet be carried out"
            self._wait(ANSWER_S, lambda: self._give_up(message))
        else:
            self._done()
        return True

    # ---- the end of a request ----------------------------------------------------------------------------------------

    def _done(self) -> None:
        self._stop_timer()
        self._request, self._sent = None, False

    def _give_up(self, message: str) -> None:
        """What the daemon may still answer belongs to nobody any more."""
        self._timer = None
        if self._request is None:
            return
        self._refuse(self._request, messages.Code.DAEMON_AWAY, message)
        self._loop.remove_reader(int(self._back.getsockopt(zmq.FD)))
        self._back.close()
        self._back = self._open()
        self._look()

    def _refuse(self, request: _Request, code: messages.Code, message: str) -> None:
        _log.debug("%s: refused, %d: %s", self._account.name, code, message)
        if request.answerable:
            delimited, _ = messages.open_envelope(request.frames)
            self._reply = messages.close_envelope(delimited, messages.error_reply(request.id, code, message))
        self._done()

    def _wait(self, after_s: float, call: Callable[[], None]) -> None:
        """There is one timer; a request waits for one thing at a time."""
        self._stop_timer()
        self._timer = self._loop.call_later(after_s, self._time, call)

    def _time(self, call: Callable[[], None]) -> None:
        self._timer = None
        call()

    def _stop_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None


@dataclass(slots=True)
class _Request:
    frames: list[bytes]
    answerable: bool
    id: messages.Id


def _events(socket: zmq.Socket[bytes]) -> int:
    return int(socket.getsockopt(zmq.EVENTS))


def peek(body: bytes) -> tuple[bool, messages.Id]:
    """Whether the daemon answers this body, and the id that its answer carries, as far as that shows without decoding.

    Only a map without `id` is not answered, and not always then.
    """
    try:
        found, id = _member(body, _ID_KEYS)
    except (ValueError, msgpack.UnpackException, RecursionError):
        return True, None
    return found, id if isinstance(id, str | int | float) and not isinstance(id, bool) else None


def method_in(body: bytes) -> str | None:
    """The method that a body names, as a line of the log shows it; None where none shows."""
    try:
        _, method = _member(body, _METHOD_KEYS)
    except (ValueError, msgpack.UnpackException, RecursionError):
        return None
    return (method if re.fullmatch(r"\w{1,64}", method) else quoted(method)) if isinstance(method, str) else None


def _member(body: bytes, keys: tuple[bytes, ...]) -> tuple[bool, object]:
    """Whether a map has one of these keys, and its value; skipping builds nothing, however much a header claims.

    Raises ValueError, msgpack.UnpackException or RecursionError for what is no such map.
    """
    unpacker = msgpack.Unpacker(max_buffer_size=max(len(body), 1))
    unpacker.feed(body)

    def skipped() -> bytes:
        start = unpacker.tell()
        unpacker.skip()
        return body[start : min(unpacker.tell(), start + _LONGEST_ID)]

    for _ in range(min(unpacker.read_map_header(), _PEEKED)):
        key, value = skipped(), skipped()
        if key in keys:
            return True, msgpack.unpackb(value)
    return False, None
