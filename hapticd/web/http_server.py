"""aiohttp's server on one port, with the time limits of `connections.py`."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Final

from aiohttp import web

from hapticd.web.application import Site, application
from hapticd.web.connections import REQUEST_TIMEOUT_S, Connections
from hapticd.web.listening import Listening
from hapticd.web.security import Guard
from hapticd.web.sessions import Sessions

_SHUTDOWN_TIMEOUT_S: Final = 0.3
"""Time that handlers and TLS connections have to end when the server stops."""


@asynccontextmanager
async def serving(at: Listening, sessions: Sessions, site: Site, connections: Connections) -> AsyncIterator[Guard]:
    """Answer HTTP requests while the context lasts; yield the guard, which decides on the access of browsers."""
    guard = Guard(at.hosts, sessions, at.passwords, at.socket.getsockname()[1], at.tls is not None)
    runner = web.AppRunner(
        application(guard, connections, site),
        access_log=None,
        shutdown_timeout=_SHUTDOWN_TIMEOUT_S,
        keepalive_timeout=REQUEST_TIMEOUT_S,
    )
    await runner.setup()
    try:
        assert runner.server is not None
        server = await asyncio.get_running_loop().create_server(
            connections.factory(runner.server),
            sock=at.socket,
            ssl=at.tls,
            ssl_handshake_timeout=REQUEST_TIMEOUT_S if at.tls is not None else None,
            ssl_shutdown_timeout=_SHUTDOWN_TIMEOUT_S if at.tls is not None else None,
        )
        try:
            yield guard
        finally:
            server.close()
    finally:
        await runner.cleanup()
