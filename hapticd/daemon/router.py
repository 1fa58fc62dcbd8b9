"""The command socket, a ZeroMQ ROUTER: receives requests and sends answers."""

from __future__ import annotations

import socket
import time
from dataclasses import dataclass
from typing import Final

from hapticd.base import codec
from hapticd.daemon.peers import Limits, Peer, Peers
from hapticd.protocol import messages, zmtp

MAX_MESSAGE_BYTES: Final = 64 * 1024 * 1024
"""Largest size of a message, all frames together; a longer message ends its connection."""
MAX_MESSAGE_FRAMES: Final = 1024
"""Largest number of frames of a message; a message with more ends its connection."""
MAX_RECEIVE_OVERTIME_S: Final = 0.02
"""Time beyond its timeout for which `receive` may read incomplete messages before it returns."""

COMMAND_SOCKET_LIMITS: Final = Limits(zmtp.Bounds(MAX_MESSAGE_FRAMES, MAX_MESSAGE_BYTES, messages.MAX_BODY_BYTES))


@dataclass(slots=True)
class Request:
    """A received message and the peer that gets the answer."""

    peer: Peer
    delimited: bool
    """Whether an empty frame precedes the body, and must precede the answer."""
    body: bytes | None
    """The body, empty or shortened if it was too long; None: the message has a wrong number of frames."""
    size: int
    """Length of the message, in bytes."""

    @property
    def too_long(self) -> bool:
        """Whether the body was too long to be stored."""
        return self.body is not None and len(self.body) < self.size


class Router(Peers):
    """The clients of the command socket. For one thread."""

    kind = b"ROUTER"
    partners = frozenset((b"DEALER", b"REQ", b"ROUTER"))

    def __init__(self, listening: socket.socket, limits: Limits = COMMAND_SOCKET_LIMITS) -> None:
        super().__init__(listening, limits)

    def receive(self, timeout_s: float) -> Request | None:
        """Return the next request; peers are served in turn.

        Returns None when `wake` is called, or after `timeout_s`, at most MAX_RECEIVE_OVERTIME_S later if peers send.
        """
        until_s = time.monotonic() + timeout_s
        while True:
            came = self._turn(timeout_s)
            if came is not None:
                peer, event = came
                if isinstance(event, zmtp.Message):
                    delimited, body = messages.open_envelope(event.frames)
                    return Request(peer, delimited, body, event.size)
                self._end(peer, "unexpected command")
            if self._woken:
                self._woken = False
                return None
            timeout_s = until_s - time.monotonic()
            if timeout_s <= (0 if self._idle else -MAX_RECEIVE_OVERTIME_S):
                self._repeats.flush()
                return None

    def send(self, peer: Peer, delimited: bool, body: bytes | codec.Encoded) -> None:
        """Send an answer after the earlier answers to this peer; drop it if the peer has disconnected."""
        if peer.closed:
            return
        first, *rest = (body,) if isinstance(body, bytes) else body.parts
        delimiter = zmtp.header(0, zmtp.MORE_FLAG) if delimited else b""
        self._send(peer, delimiter + zmtp.header(len(body), 0) + first, *rest)
