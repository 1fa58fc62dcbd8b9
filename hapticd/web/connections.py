"""The connections of browsers: how many there are, and how long each may take over what it does.

Whoever sends a request byte by byte, takes an answer byte by byte or sends nothing at all is let go. A WebSocket has
its own rules (page.py).
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from contextvars import ContextVar
from typing import Final, cast

from aiohttp import web
from aiohttp.typedefs import Handler, Middleware

MOST: Final = 128
REQUEST_S: Final = 30.0
"""From the connection, or the end of the last answer, to the whole head of the next request."""
ANSWER_S: Final = 30.0
_SWEEP_S: Final = 1.0
_GOES_ON: Final[ContextVar[Callable[[], None]]] = ContextVar("goes_on", default=lambda: None)


def goes_on() -> None:
    """For a handler that takes or sends a file: a part of it went over, the next one has as long again."""
    _GOES_ON.get()()


class Connections:
    """Those of one server. Belongs to the event loop."""

    def __init__(
        self, most: int = MOST, request_s: float = REQUEST_S, now: Callable[[], float] = time.monotonic
    ) -> None:
        self._most, self._request_s, self._now = most, request_s, now
        self._open: dict[_Connection, float] = {}
        """When each is to be let go; 0: never."""
        self.refused = 0
        self.let_go = 0

    def __len__(self) -> int:
        return len(self._open)

    def factory(self, server: Callable[[], asyncio.BaseProtocol]) -> Callable[[], asyncio.BaseProtocol]:
        """Of protocols for `create_server`, around those of aiohttp."""
        return lambda: _Connection(cast(asyncio.Protocol, server()), self)

    def opened(self, connection: _Connection) -> bool:
        """Whether there is room for it."""
        if len(self._open) >= self._most:
            self.refused += 1
            return False
        self._open[connection] = self._now() + self._request_s
        return True

    def closed(self, connection: _Connection) -> None:
        self._open.pop(connection, None)

    def sweep(self) -> None:
        """Lets go whoever took too long."""
        now = self._now()
        for connection, until in tuple(self._open.items()):
            if until and until < now:
                self.let_go += 1
                connection.abort()

    async def run(self) -> None:
        """Sweeps, until cancelled."""
        while True:
            await asyncio.sleep(_SWEEP_S)
            self.sweep()

    def middleware(self) -> Middleware:
        """Knows when a request has come whole, and when it is answered. The first of all."""

        @web.middleware
        async def timed(request: web.Request, handler: Handler) -> web.StreamResponse:
            found = request.transport.get_protocol() if request.transport is not None else None
            connection = found if isinstance(found, _Connection) and found in self._open else None
            if connection is None:
                return await handler(request)
            _GOES_ON.set(lambda: self._rearm(connection, ANSWER_S))
            self._open[connection] = 0.0 if request.path == "/socket" else self._now() + ANSWER_S
            try:
                response = await handler(request)
                if not isinstance(response, web.WebSocketResponse):
                    # To be sent still, which may be slow.
                    self._rearm(connection, ANSWER_S)
                return response
            except BaseException:
                self._rearm(connection, self._request_s)
                raise

        return timed

    def _rearm(self, connection: _Connection, left_s: float) -> None:
        if connection in self._open:
            self._open[connection] = self._now() + left_s


class _Connection(asyncio.Protocol):
    """aiohttp's protocol, with a word to Connections when it comes and goes."""

    def __init__(self, inner: asyncio.Protocol, connections: Connections) -> None:
        self._inner, self._connections = inner, connections
        self._transport: asyncio.Transport | None = None
        self._taken = False
        # What comes with every piece of data goes straight on.
        self.data_received = inner.data_received  # type: ignore[method-assign]
        self.pause_writing = inner.pause_writing  # type: ignore[method-assign]
        self.resume_writing = inner.resume_writing  # type: ignore[method-assign]

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)
        self._taken = self._connections.opened(self)
        if self._taken:
            self._inner.connection_made(transport)
        else:
            self.data_received = lambda data: None  # type: ignore[method-assign]
            self._transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        if self._taken:
            self._connections.closed(self)
            self._inner.connection_lost(exc)

    def eof_received(self) -> bool | None:
        return self._inner.eof_received() if self._taken else None

    def abort(self) -> None:
        """Ends it at once; what is not sent yet is lost."""
        if self._transport is not None:
            self._transport.abort()
