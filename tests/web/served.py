"""The server of `hapticd web` in this process with a daemon made up by a test, and pages without a browser."""

from __future__ import annotations

import asyncio
import tempfile
from collections import deque
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import aiohttp
import msgpack

from hapticd.client.asynchronous import Client
from hapticd.system.paths import runtime_paths
from hapticd.web.application import STATIC_FOLDER, Pages, Site
from hapticd.web.connections import Connections
from hapticd.web.http_server import serving
from hapticd.web.listening import listen
from hapticd.web.recording_methods import Recordings
from hapticd.web.security import Guard
from hapticd.web.sessions import Sessions
from hapticd.web.telemetry_hub import TelemetryHub
from tests.support.daemon_process import PATIENCE_S
from tests.support.fake_daemon import Answer, FakeDaemon, fake_daemon, result


def echo(request: dict[str, Any]) -> list[bytes]:
    """Answer like a daemon that returns each request."""
    if "id" not in request:
        return []
    answers: dict[str, Any] = {"lease": {"token": "t"}}
    return [result(request, answers.get(request["method"], request))]


class WebSite:
    """The server with its pages, sessions and daemon."""

    def __init__(self, url: str, sessions: Sessions, pages: Pages, connections: Connections, guard: Guard) -> None:
        self.url, self.sessions, self.pages, self.connections, self.guard = url, sessions, pages, connections, guard
        self.daemon: FakeDaemon

    @property
    def cookie(self) -> dict[str, str]:
        """Cookie header of a browser with access."""
        return {"Cookie": f"{self.guard.cookie}={self.sessions.open()}"}

    @property
    def origin(self) -> dict[str, str]:
        return {"Origin": self.url}


@asynccontextmanager
async def served(
    answer: Answer = echo,
    *,
    connections: Connections | None = None,
    password_file: str | None = None,
    there: bool = True,
    recordings: Recordings | None = None,
) -> AsyncIterator[WebSite]:
    """Serve like `hapticd web --port 0`; `there`: wait until its daemon is connected."""
    with tempfile.TemporaryDirectory(prefix="ht-") as folder, fake_daemon(Path(folder), answer) as daemon:
        daemon.silent.set()
        at = listen("127.0.0.1", 0, None, None, password_file)
        place, sessions = runtime_paths(folder), Sessions()
        control = Client(place, PATIENCE_S)
        hub = TelemetryHub(place, lambda daemon_there: pages.send_news({"daemon": daemon_there}))
        pages = Pages(place, hub, control, False, lambda: f"{at.url}/?token={sessions.new_token()}", recordings)
        held = Connections() if connections is None else connections
        tasks = [asyncio.create_task(hub.run()), asyncio.create_task(held.run())]
        try:
            async with serving(at, sessions, Site(STATIC_FOLDER / "index.html", pages.add_routes), held) as guard:
                if there:
                    await hub.await_daemon(PATIENCE_S)
                site = WebSite(at.url, sessions, pages, held, guard)
                site.daemon = daemon
                yield site
                await pages.close()
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            await control.close()
            at.socket.close()


class Tab:
    """A page of the server: sends and receives messages."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        self.socket = socket
        self._id = 0
        self._telemetry: deque[list[Any]] = deque()

    async def send(self, message: object) -> None:
        await self.socket.send_bytes(msgpack.packb(message))

    async def receive(self) -> Any:
        async with asyncio.timeout(PATIENCE_S):
            message = await self.socket.receive()
        assert message.type is aiohttp.WSMsgType.BINARY, message
        return msgpack.unpackb(message.data)

    async def answer(self, id: object) -> dict[str, Any]:
        """Return the answer to a call; telemetry that comes before is kept."""
        while True:
            message = await self.receive()
            if isinstance(message, list):
                self._telemetry.append(message)
            elif message["id"] == id:
                return message  # type: ignore[no-any-return]

    async def call(self, method: str, params: Mapping[str, object] | None = None) -> dict[str, Any]:
        self._id += 1
        await self.send({"jsonrpc": "2.0", "id": self._id, "method": method, "params": params or {}})
        return await self.answer(self._id)

    async def notify(self, method: str, params: Mapping[str, object] | None = None) -> None:
        await self.send({"jsonrpc": "2.0", "method": method, "params": params or {}})

    async def telemetry(self, topic: str) -> Any:
        """Return the next message of a topic, or the next news with this member."""
        while True:
            name, body = self._telemetry.popleft() if self._telemetry else await self.receive()
            if name == topic or (name == "web" and topic in body):
                return body

    async def daemon_there(self) -> None:
        """Wait for the news that a daemon is connected: on a busy machine a page is opened earlier."""
        while not (await self.telemetry("daemon"))["daemon"]:
            pass


@asynccontextmanager
async def tab(site: WebSite) -> AsyncIterator[Tab]:
    """Open a page with access."""
    async with (
        aiohttp.ClientSession() as session,
        session.ws_connect(f"{site.url}/socket", headers={**site.cookie, **site.origin}) as socket,
    ):
        yield Tab(socket)


async def until(what: Callable[[], bool]) -> None:
    """Wait until a condition in this process is true."""
    async with asyncio.timeout(PATIENCE_S):
        while not what():
            await asyncio.sleep(0.001)


async def asked(address: str, method: str, params: Mapping[str, object] | None = None) -> dict[str, Any]:
    """Return the answer to one call of a page at an address with a token, as `hapticd web` prints it."""
    origin = address.partition("/?")[0]
    async with aiohttp.ClientSession(cookie_jar=aiohttp.CookieJar(unsafe=True)) as session:
        async with session.get(address) as response:
            assert response.status == 200, await response.text()
        async with session.ws_connect(f"{origin}/socket", headers={"Origin": origin}) as socket:
            return await Tab(socket).call(method, params)
