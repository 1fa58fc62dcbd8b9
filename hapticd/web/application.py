"""The HTTP routes: the static page, the WebSocket, the door."""

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
from hapticd.web import page_calls, page_methods, shipped_materials, yaml_methods
from hapticd.web.connections import Connections
from hapticd.web.page import FROZEN_S, MAX_MESSAGE, Method, Page
from hapticd.web.recording_methods import Recordings
from hapticd.web.security import FORM_BYTES, Guard
from hapticd.web.telemetry_hub import TelemetryHub

STATIC: Final = Path(__file__).parent / "static"
MOST_PAGES: Final = 32
_HEARTBEAT_S: Final = 2.0 * FROZEN_S
"""From the last message of a page to a ping; aiohttp waits half of it for the answer."""
_CLOSING_S: Final = 5.0
"""A page that answers no closing frame for so long is let go."""
_UNSENT_BYTES: Final = 256 << 10
"""Room of the kernel for what a page has not read. More of it would be older data, and none newer."""

METHODS: Final[dict[str, Method]] = {**page_methods.METHODS, **yaml_methods.METHODS, **shipped_materials.METHODS}
"""What a page may call of this process, by name. A further group is a further file, added here."""

_log = logging.getLogger("hapticd.web")


@dataclass
class Pages:
    """The pages that are open, and what they share."""

    place: RuntimePaths
    hub: TelemetryHub
    control: Client
    """To the daemon: leases and stops of all pages, which no other call waits in front of."""
    demo: bool
    new_address: Callable[[], str]
    recordings: Recordings | None = None
    """None: nothing is recorded here."""
    methods: Mapping[str, Method] = field(default_factory=lambda: METHODS)
    """What they may call of this process, besides those of recordings."""
    passes: frozenset[str] = page_calls.OF_THE_DAEMON
    """What they may call of the daemon."""
    open: set[Page] = field(default_factory=set)
    _lives: set[asyncio.Task[None]] = field(default_factory=set)

    def tell(self, news: dict[str, object]) -> None:
        """To all of them."""
        for page in tuple(self.open):
            page.tell(news)

    def end(self, why: str) -> None:
        """Has all of them closed."""
        for page in tuple(self.open):
            page.end(why)

    async def serve(self, request: web.Request) -> web.StreamResponse:
        """A page, as long as it stays."""
        if len(self.open) >= MOST_PAGES:
            return web.Response(status=503, text=f"{MOST_PAGES} pages are open already: close one\n")
        if request.transport is not None:
            connection = request.transport.get_extra_info("socket")
            connection.setsockopt(network.SOL_SOCKET, network.SO_SNDBUF, _UNSENT_BYTES)
        response = web.WebSocketResponse(
            max_msg_size=MAX_MESSAGE, compress=False, heartbeat=_HEARTBEAT_S, timeout=_CLOSING_S
        )
        try:
            await response.prepare(request)
        except ConnectionError:  # it went meanwhile
            return response
        page = Page(
            response,
            self.place,
            self.hub,
            self.control,
            {**self.methods, **(self.recordings.methods() if self.recordings is not None else {})},
            demo=self.demo,
            new_address=self.new_address,
            passes=self.passes,
        )
        page.tell({"daemon": self.hub.daemon})
        self.open.add(page)
        self.tell({"pages": len(self.open)})
        # A task of its own: a handler that is cancelled must not keep a page from letting go of what it has.
        task = asyncio.create_task(self._life(page), name="page")
        self._lives.add(task)
        task.add_done_callback(self._lives.discard)
        try:
            await asyncio.shield(task)
        finally:
            page.end("the connection ended")
            if request.transport is not None:
                request.transport.abort()  # whoever does not read is not waited for
        return response

    async def _life(self, page: Page) -> None:
        try:
            await page.serve()
        except Exception:
            _log.exception("a page failed")
        finally:
            self.open.discard(page)
            self.tell({"pages": len(self.open)})

    async def close(self) -> None:
        """Returns once none of them has anything any more."""
        self.end("The server of this page ends.")
        await asyncio.gather(*self._lives)

    def add_routes(self, app: web.Application) -> None:
        """The WebSocket, and what is downloaded and sent beside it."""
        app.router.add_get("/socket", self.serve)
        if self.recordings is not None:
            self.recordings.add_routes(app)


@dataclass(frozen=True, slots=True)
class Site:
    """What one port serves to those who were let in."""

    index: Path
    """The page at /, HTML."""
    add_routes: Callable[[web.Application], None]
    """Adds what that page asks for, but for static/."""


def application(guard: Guard, connections: Connections, site: Site) -> web.Application:
    """What answers requests."""
    mimetypes.add_type("text/javascript", ".mjs")
    mimetypes.add_type("text/javascript", ".js")

    async def index(_: web.Request) -> web.StreamResponse:
        return web.FileResponse(site.index)

    async def door_style(_: web.Request) -> web.StreamResponse:
        return web.FileResponse(STATIC / "door.css")

    app = web.Application(middlewares=[connections.middleware(), guard.middleware()], client_max_size=FORM_BYTES)
    app.on_response_prepare.append(guard.add_headers)
    app.router.add_get("/", index)
    app.router.add_get("/login", guard.show_form)
    app.router.add_post("/login", guard.take_form)
    app.router.add_get("/door.css", door_style)
    app.router.add_static("/static/", STATIC, follow_symlinks=False)
    site.add_routes(app)
    return app
