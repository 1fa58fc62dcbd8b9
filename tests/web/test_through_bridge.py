"""`hapticd web` through a bridge: what passes, by what its key may; what a page is told while the bridge is away."""

from __future__ import annotations

import asyncio
import itertools
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path
from typing import Any, cast

import aiohttp
import pytest

from hapticd.protocol import streams
from hapticd.protocol.keys import write_certificate
from hapticd.protocol.messages import Code
from hapticd.web.page import MAY_ONLY_WATCH
from tests.support.bridge_process import Bridge, running_bridge
from tests.support.daemon_process import PATIENCE_S, Daemon, connect, running_daemon, until
from tests.web.served import Tab
from tests.web.test_process import Web, refusal, running

pytestmark = pytest.mark.slow

CLIENTS = {"alice": "command", "bob": "watch"}
THERE = [0.01, 0.03]
"""Where a page leads the hand; nothing is in the way."""


@pytest.fixture(scope="module")
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    config = tmp_path_factory.mktemp("config") / "slow.yaml"
    config.write_text(
        "servo: {rate_hz: 1000, realtime: off, stream_timeout_s: 0.2}\ndevice: {kind: sim}\nscene: {objects: {}}\n"
    )
    with running_daemon("-c", str(config)) as daemon:
        yield daemon


@pytest.fixture(scope="module")
def bridge(daemon: Daemon, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bridge]:
    with running_bridge(tmp_path_factory.mktemp("bridge"), daemon.directory, CLIENTS) as bridge:
        yield bridge


def words(bridge: Bridge, folder: Path, name: str) -> tuple[str, ...]:
    """The options of whoever has this name's key."""
    write_certificate(bridge.keys[name], name, folder)
    keys = "--key", str(folder / f"{name}.key_secret"), "--server-key", str(bridge.folder / "keys" / "server.key")
    return "--connect", bridge.address, *keys


@contextmanager
def web_of(bridge: Bridge, folder: Path, name: str) -> Iterator[Web]:
    with running(folder, before=words(bridge, folder, name)) as web:
        yield web
    assert "Traceback" not in (folder / "web.log").read_text()


class Reader:
    """A page's socket that is read all the time, as a browser does: else the server takes it for frozen."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        self.socket = socket
        self._messages: asyncio.Queue[aiohttp.WSMessage] = asyncio.Queue()
        self.send_bytes = socket.send_bytes
        self.receive = self._messages.get

    async def run(self) -> None:
        while not self.socket.closed:
            await self._messages.put(await self.socket.receive())


@asynccontextmanager
async def page_of(web: Web) -> AsyncIterator[Tab]:
    origin = web.address.partition("/?")[0]
    async with aiohttp.ClientSession(cookie_jar=aiohttp.CookieJar(unsafe=True)) as session:
        async with session.get(web.address) as response:
            assert response.status == 200
        async with session.ws_connect(f"{origin}/socket", headers={"Origin": origin}) as socket:
            reader = Reader(socket)
            reading = asyncio.create_task(reader.run())
            yield Tab(cast(aiohttp.ClientWebSocketResponse, reader))
            reading.cancel()


async def result(page: Tab, method: str, **params: object) -> Any:
    answer = await page.call(method, params)
    assert "result" in answer, answer
    return answer["result"]


async def led(page: Tab, numbers: Iterator[int]) -> None:
    """Streams targets until the hand is at the place."""
    await page.call("web.subscribe", {"topics": ["state"]})
    deadline = time.monotonic() + PATIENCE_S
    while (state := await page.telemetry("state"))["position_m"] != pytest.approx(THERE, abs=1e-3):
        assert time.monotonic() < deadline, state
        await page.socket.send_bytes(streams.write("target", next(numbers), *THERE))
    await page.call("web.subscribe", {"topics": []})


def moved_away(daemon: Daemon) -> None:
    """The hand is elsewhere."""
    with connect(daemon.directory) as beside:
        beside.set_operator(waypoints=[[0.01, -THERE[0], -THERE[1]]])
        assert beside.wait_gesture(timeout_s=PATIENCE_S)["completed"]


async def forces_on(page: Tab) -> str:
    """Under a lease, whose token is returned; on a busy machine its second may be over before the forces are on."""
    deadline = time.monotonic() + PATIENCE_S
    while True:
        token = str((await result(page, "lease", duration_s=1.0))["token"])
        answer = await page.call("set_forces", {"enabled": True})
        if "result" in answer:
            assert answer["result"]["forces"] == "on"
            return token
        assert answer["error"]["code"] == Code.LEASE_LAPSED and time.monotonic() < deadline, answer


async def news_until(page: Tab, name: str, holds: Callable[[Any], bool]) -> Any:
    while not holds(found := (await page.telemetry(name))[name]):
        pass
    return found


def test_calls_telemetry_leases_and_streams_pass(daemon: Daemon, bridge: Bridge, tmp_path: Path) -> None:
    async def test(web: Web) -> None:
        async with page_of(web) as page:
            await page.daemon_there()
            assert (await result(page, "web.hello"))["daemon"] is True
            await result(page, "web.subscribe", topics=["samples", "change", "state"])
            await page.telemetry("state")
            disc = {"kind": "disc", "center_m": [-0.04, 0.0], "radius_m": 0.005, "material": "wood"}
            changed = await result(page, "update_scene", objects={"peg": disc}, wait=True)
            assert (await page.telemetry("change"))["revision"] == changed["revision"]
            with connect(daemon.directory) as beside:
                assert list(beside.get_scene()["scene"]["objects"]) == ["peg"]
            first = (await page.telemetry("samples"))["first_tick"]
            assert (await page.telemetry("samples"))["first_tick"] > first
            token = await forces_on(page)
            await led(page, itertools.count())
            status = await result(page, "get_status")
            assert status["streams"]["target"]["used"] > 0
            await result(page, "lease", duration_s=0.0, token=token)

    with web_of(bridge, tmp_path, "alice") as web:
        asyncio.run(test(web))


def test_a_watcher_s_page_gets_telemetry_and_is_told_what_its_key_may(
    daemon: Daemon, bridge: Bridge, tmp_path: Path
) -> None:
    async def test(web: Web) -> None:
        async with page_of(web) as page:
            await page.daemon_there()
            assert (await result(page, "web.hello"))["daemon"] is True
            await result(page, "web.subscribe", topics=["samples", "state", "status"])
            for topic in ("samples", "state", "status"):
                await page.telemetry(topic)
            for method in ("get_scene", "reset", "stream_target", "lease", "set_forces"):
                answer = await page.call(method)
                assert answer["error"]["code"] == MAY_ONLY_WATCH
                assert answer["error"]["message"].startswith(f"{method}: the key of hapticd web may only watch; ")
            for number in range(3):
                await page.socket.send_bytes(streams.write("target", number, *THERE))
            await news_until(page, "refused", lambda counts: counts == {"right": 5 + 3})

    with connect(daemon.directory) as beside:
        # What another test streamed may not have timed out yet.
        until(lambda: not any(kind["active"] for kind in beside.get_status()["streams"].values()))
        before = beside.get_status()
        with web_of(bridge, tmp_path, "bob") as web:
            asyncio.run(test(web))
        after = beside.get_status()
    assert [after[key] for key in ("revision", "forces", "streams")] == [  # type: ignore[literal-required]
        before[key]  # type: ignore[literal-required]
        for key in ("revision", "forces", "streams")
    ]


def test_a_key_that_the_bridge_does_not_know_is_said_in_one_line(
    bridge: Bridge, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    told = refusal(capfd, *words(bridge, tmp_path, "stranger"), "web", "--port", "0")
    key = bridge.keys["stranger"].public_key[:8]
    assert told == f"hapticd: the bridge at {bridge.address} refuses our key {key}...: " + (
        "the bridge's file lists no client with it; `hapticd key new` prints its line\n"
    )


def test_the_bridge_goes_away_and_comes_back(daemon: Daemon, tmp_path: Path) -> None:
    """The page stays, is told, and goes on by itself: with calls, telemetry and streams."""

    async def test(web: Web, bridge: Bridge) -> None:
        numbers = itertools.count()
        async with page_of(web) as page:
            # A bridge that has just started hears of its daemon within a second.
            await page.daemon_there()
            await led(page, numbers)
            await result(page, "web.subscribe", topics=["samples"])
            await page.telemetry("samples")
            assert await asyncio.to_thread(bridge.stop) == 0
            await news_until(page, "daemon", lambda there: there is False)
            error = (await page.call("get_status"))["error"]
            assert error["code"] == Code.DAEMON_AWAY and bridge.address in error["message"]
            assert "\n" not in error["message"]
            await page.socket.send_bytes(streams.write("target", next(numbers), *THERE))
            await news_until(page, "refused", lambda counts: counts.get("no daemon", 0) > 0)
            await asyncio.to_thread(bridge.start_again)
            await news_until(page, "daemon", lambda there: there is True)
            await page.telemetry("samples")
            assert (await result(page, "get_status"))["device"] == "sim"
            await asyncio.to_thread(moved_away, daemon)
            await led(page, numbers)

    folder = tmp_path / "bridge"
    folder.mkdir()
    with (
        running_bridge(folder, daemon.directory, CLIENTS) as bridge,
        web_of(bridge, tmp_path, "alice") as web,
    ):
        moved_away(daemon)
        asyncio.run(test(web, bridge))
