"""The command socket: frames in, frames out, one request at a time.

A blocking receive in a thread of its own, because it measured as the fastest way in (docs/adr/0002). Between requests
it beats, so that the servo knows that somebody serves commands.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from typing import Final, NamedTuple

import zmq

from hapticd import wire
from hapticd.dispatch import Dispatch
from hapticd.engine import Engine
from hapticd.repeats import Since

BEAT_EVERY_MS: Final = 100
LARGEST_MESSAGE: Final = 64 * 1024 * 1024
"""A longer message closes the connection that it came from."""

_log = logging.getLogger(__name__)


_WAKE: Final = "inproc://wake"


class Received(NamedTuple):
    """A message: who sent it, whether the answer is delimited, and the body (None: of the wrong form)."""

    peer: bytes
    delimited: bool
    body: bytes | None


class Transport:
    """Messages of the command socket in and out. `wake` is for any thread, the rest for the one that serves."""

    def __init__(self, context: zmq.Context[zmq.Socket[bytes]]) -> None:
        """`wake` reaches it, clients do not yet: bind `socket`. Raises zmq.ZMQError."""
        self._context = context
        self.socket = context.socket(zmq.ROUTER)
        self.socket.setsockopt(zmq.LINGER, 0)
        self.socket.setsockopt(zmq.MAXMSGSIZE, LARGEST_MESSAGE)
        self.socket.setsockopt(zmq.RCVTIMEO, BEAT_EVERY_MS)
        self.socket.bind(_WAKE)

    def receive(self) -> Received | None:
        """The next message; None where none came in time, or `wake` was called."""
        try:
            peer, *frames = self.socket.recv_multipart()
        except zmq.Again:
            return None
        return Received(peer, *wire.open_envelope(frames))

    def send(self, peer: bytes, delimited: bool, body: bytes) -> bool:
        """Sends an answer; False where its peer does not read."""
        try:
            self.socket.send_multipart([peer, *wire.close_envelope(delimited, body)], zmq.NOBLOCK)
        except zmq.Again:
            return False
        return True

    def wake(self) -> None:
        """Ends `receive` in the thread that serves."""
        with self._context.socket(zmq.DEALER) as socket:
            socket.connect(_WAKE)
            socket.send(b"")

    def close(self) -> None:
        self.socket.close()


def serve(
    transport: Transport,
    engine: Engine,
    dispatch: Dispatch,
    stop: threading.Event,
    between: Callable[[], None] = lambda: None,
) -> None:
    """Answers requests until `stop` is set; calls `between` between them, ten times a second at least."""
    repeats = dispatch.repeats
    while not stop.is_set():
        repeats.flush()
        engine.beat()
        engine.look_after()
        between()
        dispatch.turn()
        received = transport.receive()
        if received is None:
            continue
        if stop.is_set():
            break
        peer, delimited, body = received

        def reply(answer: bytes, peer: bytes = peer, delimited: bool = delimited) -> None:
            if not transport.send(peer, delimited, answer):
                repeats.note("unread", _tell_unread)

        dispatch.take(body, reply)
    repeats.finish()


def _tell_unread(since: Since) -> None:
    _log.warning(
        "a client does not read its answers: %s dropped%s",
        "one was" if since.times == 1 else f"{since.times:,} were",
        f" {since.window}" if since.window else "",
    )
