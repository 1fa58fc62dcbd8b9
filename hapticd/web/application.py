"""The HTTP routes: the static page, the WebSocket, the login page."""

from __future__ import annotations

import asyncio
import logging
import mimetypes
import socket as network
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from aiohttp import web

from hapticd.client.asynchronous import Client
from hapticd.system.paths import RuntimePaths
from hapticd.web import page_calls, page_methods, yaml_methods
from hapticd.web.connections import Connections
from hapticd.web.page import MAX_PAGE_MESSAGE_BYTES, PAGE_READ_TIMEOUT_S, Method, Page
from hapticd.web.recording_methods import Recordings
from hapticd.web.security import MAX_FORM_BYTES, Guard
from hapticd.web.telemetry_hub import TelemetryHub

STATIC_FOLDER: Final = Path(__file__).parent / "static"
"""Folder of the page's HTML, scripts and styles."""
MAX_OPEN_PAGES: Final = 32
"""Maximum number of open pages; docs/web.md states it."""
_PING_INTERVAL_S: Final = 2.0 * PAGE_READ_TIMEOUT_S
"""Time from the last message of a page to a ping. aiohttp waits half this time for the pong."""
_CLOSE_TIMEOUT_S: Final = 5.0
"""Time that a page has to answer a closing frame."""
_SEND_BUFFER_BYTES: Final = 256 << 10
"""Size of the kernel's send buffer of a page. A larger buffer would only hold older data for a slow page."""

WEB_PAGE_METHODS: Final[dict[str, Method]] = {
    **page_methods.BASE_PAGE_METHODS,
    **yaml_methods.YAML_PAGE_METHODS,
}
"""Methods of this process that a page may call, by name, except the methods for recordings.

Each group of methods is a table in a separate file.
"""

_log = logging.getLogger("hapticd.web")


@dataclass
class Pages:
    """The open pages, their common connection to the daemon, and the methods that they may call."""

    place: RuntimePaths
    hub: TelemetryHub
    control: Client
    """Separate connection to the daemon for the leases and stops of all pages, which other calls cannot delay."""
    demo: bool
    new_address: Callable[[], str]
    recordings: Recordings | None = None
    """Recordings of this process; None: pages cannot record."""
    methods: Mapping[str, Method] = field(default_factory=lambda: WEB_PAGE_METHODS)
    """Methods of this process that pages may call, except the methods for recordings."""
    daemon_methods: frozenset[str] = page_calls.DAEMON_METHODS
    """Methods of the daemon that pages may call."""
    open: set[Page] = field(default_factory=set)
    _lives: set[asyncio.Task[None]] = field(default_factory=set)

    def send_news(self, news: dict[str, object]) -> None:
        """Send news (changed state of this process) to all open pages."""
        for page in tuple(self.open):
            page.send_news(news)

    def end(self, why: str) -> None:
        """Begin to close all open pages, and send them the reason `why`."""
        for page in tuple(self.open):
            page.end(why)

    async def serve(self, request: web.Request) -> web.StreamResponse:
        """Serve the WebSocket of a page until it closes."""
        if len(self.open) >= MAX_OPEN_PAGES:
            return web.Response(status=503, text=f"{MAX_OPEN_PAGES} pages are already open: close one\n")
        if request.transport is not None:
            connection = request.transport.get_extra_info("socket")
            connection.setsockopt(network.SOL_SOCKET, network.SO_SNDBUF, _SEND_BUFFER_BYTES)
        response = web.WebSocketResponse(
            max_msg_size=MAX_PAGE_MESSAGE_BYTES, compress=False, heartbeat=_PING_INTERVAL_S, timeout=_CLOSE_TIMEOUT_S
        )
        try:
            await response.prepare(request)
        except ConnectionError:  # the browser has disconnected
            return response
        page = Page(
            response,
            self.place,
            self.hub,
            self.control,
            {**self.methods, **(self.recordings.methods() if self.recordings is not None else {})},
            demo=self.demo,
            new_address=self.new_address,
            daemon_methods=self.daemon_methods,
        )
        page.send_news({"daemon": self.hub.daemon})
        self.open.add(page)
        self.send_news({"pages": len(self.open)})
        # A separate task, so that the page releases its resources even if this handler is cancelled.
        task = asyncio.create_task(self._life(page), name="page")
        self._lives.add(task)
        task.add_done_callback(self._lives.discard)
        try:
            await asyncio.shield(task)
        finally:
            page.end("the connection ended")
            if request.transport is not None:
                request.transport.abort()  # does not wait for a browser that does not read
        return response

    async def _life(self, page: Page) -> None:
        try:
            await page.serve()
        except Exception:
            _log.exception("a page failed")
        finally:
            self.open.discard(page)
            self.send_news({"pages": len(self.open)})

    async def close(self) -> None:
        """Close all pages, and return once they have released their resources."""
        self.end("The server of this page ends.")
        await asyncio.gather(*self._lives)

    def add_routes(self, app: web.Application) -> None:
        """Add the routes of the WebSocket, and of downloads and uploads of recordings."""
        app.router.add_get("/socket", self.serve)
        if self.recordings is not None:
            self.recordings.add_routes(app)


@dataclass(frozen=True, slots=True)
class Site:
    """The page and the routes that one port serves to browsers with access."""

    index: Path
    """HTML file of the page at /."""
    add_routes: Callable[[web.Application], None]
    """Adds the routes that the page at / requests, except static/."""


def application(guard: Guard, connections: Connections, site: Site) -> web.Application:
    """Return the aiohttp application that answers the HTTP requests of browsers."""
    mimetypes.add_type("text/javascript", ".mjs")
    mimetypes.add_type("text/javascript", ".js")

    async def index(_: web.Request) -> web.StreamResponse:
        return web.FileResponse(site.index)

    async def door_style(_: web.Request) -> web.StreamResponse:
        return web.FileResponse(STATIC_FOLDER / "door.css")

    app = web.Application(middlewares=[connections.middleware(), guard.middleware()], client_max_size=MAX_FORM_BYTES)
    app.on_response_prepare.append(guard.add_headers)
    app.router.add_get("/", index)
    app.router.add_get("/login", guard.show_form)
    app.router.add_post("/login", guard.take_form)
    app.router.add_get("/door.css", door_style)
    app.router.add_static("/static/", STATIC_FOLDER, follow_symlinks=False)
    site.add_routes(app)
    return app
