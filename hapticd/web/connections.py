"""The connections of browsers: their number and their time limits.

A connection that sends a request or reads a response too slowly, or sends nothing, is closed. A WebSocket has separate
rules (page.py).
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from contextvars import ContextVar
from typing import Final, cast

from aiohttp import web
from aiohttp.typedefs import Handler, Middleware

MAX_BROWSER_CONNECTIONS: Final = 128
"""Maximum number of connections of all browsers together; docs/web.md states it."""
REQUEST_TIMEOUT_S: Final = 30.0
"""Time from the connection, or from the last response, until the headers of the next request must be complete."""
RESPONSE_TIMEOUT_S: Final = 30.0
"""Time in which a response, or the next block of a file, must be transferred."""
_SWEEP_INTERVAL_S: Final = 1.0
"""Interval at which overdue connections are closed."""
_DEADLINE_EXTENDER: Final[ContextVar[Callable[[], None]]] = ContextVar("deadline_extender", default=lambda: None)
"""Extends the deadline of the current request; Connections.middleware sets it."""


def extend_deadline() -> None:
    """Give the current request another RESPONSE_TIMEOUT_S; handlers call this function after each block of a file."""
    _DEADLINE_EXTENDER.get()()


class Connections:
    """The browser connections of one server. Only the event loop may use them."""

    def __init__(self, limit: int = MAX_BROWSER_CONNECTIONS, now: Callable[[], float] = time.monotonic) -> None:
        """Allow `limit` connections of browsers, each of which must send a request within REQUEST_TIMEOUT_S."""
        self._limit, self._now = limit, now
        self._open: dict[_Connection, float] = {}
        """The time at which each open connection is closed; 0: never."""
        self.refused = 0
        """Connections refused because there were too many."""
        self.timed_out = 0
        """Connections closed because they took too long."""

    def __len__(self) -> int:
        return len(self._open)

    def factory(self, server: Callable[[], asyncio.BaseProtocol]) -> Callable[[], asyncio.BaseProtocol]:
        """Return a factory of protocols for `create_server` that wrap the protocols of aiohttp's `server`."""
        return lambda: _Connection(cast(asyncio.Protocol, server()), self)

    def opened(self, connection: _Connection) -> bool:
        """Add a new connection and return True; if the maximum number is open, return False."""
        if len(self._open) >= self._limit:
            self.refused += 1
            return False
        self._open[connection] = self._now() + REQUEST_TIMEOUT_S
        return True

    def closed(self, connection: _Connection) -> None:
        """Remove a closed connection."""
        self._open.pop(connection, None)

    def sweep(self) -> None:
        """Close the connections whose deadline has passed."""
        now = self._now()
        for connection, until in tuple(self._open.items()):
            if until and until < now:
                self.timed_out += 1
                connection.abort()

    async def run(self) -> None:
        """Close overdue connections once a second until cancelled."""
        while True:
            await asyncio.sleep(_SWEEP_INTERVAL_S)
            self.sweep()

    def middleware(self) -> Middleware:
        """Return the middleware that limits the time of each response; it must come before all other middlewares."""

        @web.middleware
        async def timed(request: web.Request, handler: Handler) -> web.StreamResponse:
            protocol = request.transport.get_protocol() if request.transport is not None else None
            connection = protocol if isinstance(protocol, _Connection) and protocol in self._open else None
            if connection is None:
                return await handler(request)
            _DEADLINE_EXTENDER.set(lambda: self._rearm(connection, RESPONSE_TIMEOUT_S))
            self._open[connection] = 0.0 if request.path == "/socket" else self._now() + RESPONSE_TIMEOUT_S
            try:
                response = await handler(request)
                if not isinstance(response, web.WebSocketResponse):
                    # The response must still be sent, which may be slow.
                    self._rearm(connection, RESPONSE_TIMEOUT_S)
                return response
            except BaseException:
                self._rearm(connection, REQUEST_TIMEOUT_S)
                raise

        return timed

    def _rearm(self, connection: _Connection, left_s: float) -> None:
        if connection in self._open:
            self._open[connection] = self._now() + left_s


class _Connection(asyncio.Protocol):
    """aiohttp's protocol, wrapped to report opened and closed connections."""

    def __init__(self, inner: asyncio.Protocol, connections: Connections) -> None:
        self._inner, self._connections = inner, connections
        self._transport: asyncio.Transport | None = None
        self._accepted = False
        # The callbacks for data are aiohttp's own, which saves a call for each piece of data.
        self.data_received = inner.data_received  # type: ignore[method-assign]
        self.pause_writing = inner.pause_writing  # type: ignore[method-assign]
        self.resume_writing = inner.resume_writing  # type: ignore[method-assign]

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)
        self._accepted = self._connections.opened(self)
        if self._accepted:
            self._inner.connection_made(transport)
        else:
            self.data_received = lambda data: None  # type: ignore[method-assign]
            self._transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        if self._accepted:
            self._connections.closed(self)
            self._inner.connection_lost(exc)

    def eof_received(self) -> bool | None:
        return self._inner.eof_received() if self._accepted else None

    def abort(self) -> None:
        """Close the connection at once; unsent data is lost."""
        if self._transport is not None:
            self._transport.abort()
