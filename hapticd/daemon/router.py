"""The command socket, a ROUTER: requests in, answers out."""

from __future__ import annotations

import socket
import time
from dataclasses import dataclass
from typing import Final

from hapticd.base import codec
from hapticd.daemon.peers import Limits, Peer, Peers
from hapticd.protocol import messages, zmtp

LARGEST_MESSAGE: Final = 64 * 1024 * 1024
"""A longer message ends the connection that it came from."""
MOST_FRAMES: Final = 1024
"""A message of more parts does, too."""

LONGEST_LOOK_S: Final = 0.02
"""So long peers may go on sending parts of messages before somebody else has the thread."""

LIMITS: Final = Limits(zmtp.Bounds(MOST_FRAMES, LARGEST_MESSAGE, messages.MAX_BODY_BYTES))


@dataclass(slots=True)
class Request:
    """A message that came, and where the answer goes."""

    peer: Peer
    delimited: bool
    """Whether an empty frame stands before the body; then one does before the answer's."""
    body: bytes | None
    """None: its frames are not those of a request."""
    size: int
    """Bytes that it had."""

    @property
    def too_long(self) -> bool:
        """Whether its body was too long to be kept."""
        return self.body is not None and len(self.body) < self.size


class Router(Peers):
    """What requests come from, to one thread."""

    kind = b"ROUTER"
    partners = frozenset((b"DEALER", b"REQ", b"ROUTER"))

    def __init__(self, listening: socket.socket, limits: Limits = LIMITS) -> None:
        super().__init__(listening, limits)

    def receive(self, timeout_s: float) -> Request | None:
        """The next request of whose turn it is; None after so long if no peer is sending anything, after LONGEST_LOOK_S
        more in any case, or once somebody calls `wake`."""
        until_s = time.monotonic() + timeout_s
        while True:
            came = self._turn(timeout_s)
            if came is not None:
                peer, event = came
                if isinstance(event, zmtp.Message):
                    delimited, body = messages.open_envelope(event.frames)
                    return Request(peer, delimited, body, event.size)
                self._end(peer, "a command out of place")
            if self._woken:
                self._woken = False
                return None
            timeout_s = until_s - time.monotonic()
            if timeout_s <= (0 if self._idle else -LONGEST_LOOK_S):
                self._repeats.flush()
                return None

    def send(self, peer: Peer, delimited: bool, body: bytes | codec.Encoded) -> None:
        """An answer, after those that were sent to this peer before. It is dropped if the peer has left."""
        if peer.closed:
            return
        first, *rest = (body,) if isinstance(body, bytes) else body.parts
        delimiter = zmtp.header(0, zmtp.MORE_FLAG) if delimited else b""
        self._send(peer, delimiter + zmtp.header(len(body), 0) + first, *rest)
