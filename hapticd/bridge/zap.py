"""The authenticator of ZeroMQ (RFC 27): asked once in each handshake whether a key is let in; `Gate.authorize` decides.

CURVE has proved by then that the other side holds the secret key; whose it is and what it may is for the gate. Without
a handler libzmq would let every key in, so the sockets are set to refuse where nobody answers (ZAP_ENFORCE_DOMAIN).
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Final

import zmq
import zmq.asyncio
from zmq.utils import z85

from hapticd.system.repeated_lines import Repeats

OK: Final = b"200"
LATER: Final = b"300"
"""No room now: libzmq closes the connection, and the client tries again."""
REFUSED: Final = b"400"

_ENDPOINT: Final = "inproc://zeromq.zap.01"
_VERSION: Final = b"1.0"

_log = logging.getLogger("hapticd.bridge")

Authorize = Callable[[str, str], bytes]
"""Of a socket's domain and a public key in Z85, the status."""


async def authenticate(socket: zmq.asyncio.Socket, authorize: Authorize) -> None:
    """Answers every handshake of this context, until cancelled."""
    repeats = Repeats()
    while True:
        frames: list[bytes] = await socket.recv_multipart()
        await socket.send_multipart(_answer(frames, authorize, repeats))
        repeats.flush()


def bind(context: zmq.asyncio.Context) -> zmq.asyncio.Socket:
    """The socket on which libzmq asks; it must be there before any other is bound."""
    socket = context.socket(zmq.REP)
    socket.setsockopt(zmq.LINGER, 0)
    socket.bind(_ENDPOINT)
    return socket


def _answer(frames: list[bytes], authorize: Authorize, repeats: Repeats) -> list[bytes]:
    # Version, request id, domain, address, routing id, mechanism, and CURVE's public key.
    version, request, domain, _, _, mechanism, *credentials = frames
    status = REFUSED
    if version == _VERSION and mechanism == b"CURVE" and len(credentials) == 1 and len(credentials[0]) == 32:
        try:
            status = authorize(domain.decode("ascii", "replace"), z85.encode(credentials[0]).decode())
        except Exception as error:
            # A defect of ours, or no descriptors left: it costs this connection, nobody else's.
            failure = error
            repeats.note("handshake", lambda since: _log.error("a handshake failed%s", since.more, exc_info=failure))
    return [_VERSION, request, status, b"", b"", b""]
