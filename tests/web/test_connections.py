"""Connections that are slow, silent or many; pages that read nothing."""

from __future__ import annotations

import asyncio
import socket
from contextlib import suppress

import pytest
import zmq.asyncio

from hapticd.web import page as page_module
from hapticd.web.connections import Connections
from tests.web.served import Tab, WebSite, served, tab, until

REQUEST_S = 30.0


class Time:
    """A clock that a test moves."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


async def connected(site: WebSite) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    before = len(site.connections) + site.connections.refused
    pair = await asyncio.open_connection("127.0.0.1", int(site.url.rpartition(":")[2]))
    await until(lambda: len(site.connections) + site.connections.refused > before)
    return pair


async def ended(reader: asyncio.StreamReader) -> bool:
    """Return whether the server closed the connection."""
    with suppress(ConnectionError):
        return await asyncio.wait_for(reader.read(), 60) == b""
    return True


@pytest.mark.parametrize("sent", [b"", b"G", b"GET / HTTP/1.1\r\nHost: ", b"GET / HTTP/1.1\r\nA: b\r\n"])
def test_an_incomplete_request_is_closed(sent: bytes) -> None:
    async def test() -> None:
        time = Time()
        async with served(connections=Connections(now=time), there=False) as site:
            reader, writer = await connected(site)
            writer.write(sent)
            time.now += REQUEST_S - 0.1
            site.connections.sweep()
            assert len(site.connections) == 1
            if sent:
                writer.write(b"E" if sent == b"G" else b"x")  # byte by byte does not help
            time.now += 0.2
            site.connections.sweep()
            assert await ended(reader)
            assert site.connections.timed_out == 1
            await until(lambda: len(site.connections) == 0)
            writer.close()

    asyncio.run(test())


def test_connections_are_limited_and_pages_stay() -> None:
    async def test() -> None:
        held = Connections(limit=5)
        async with served(connections=held, there=False) as site, tab(site) as page:
            pairs = [await connected(site) for _ in range(4)]
            reader, writer = await connected(site)
            assert await ended(reader) and held.refused == 1
            assert "result" in await page.call("web.hello")
            for _, other in (*pairs, (reader, writer)):
                other.close()
            await until(lambda: len(held) == 1)
            reader, writer = await connected(site)
            assert len(held) == 2
            writer.close()

    asyncio.run(test())


def test_a_page_is_never_closed_for_its_age() -> None:
    async def test() -> None:
        time = Time()
        async with served(connections=Connections(now=time), there=False) as site, tab(site) as page:
            await page.call("web.hello")
            time.now += 1e6
            site.connections.sweep()
            assert "result" in await page.call("web.hello")

    asyncio.run(test())


def test_a_head_without_end_is_refused() -> None:
    async def test() -> None:
        async with served(there=False) as site:
            reader, writer = await connected(site)
            writer.write(b"GET / HTTP/1.1\r\nHost: x\r\nA: " + b"a" * 100_000)
            line = await asyncio.wait_for(reader.readline(), 60)
            assert b" 400 " in line
            writer.close()

    asyncio.run(test())


async def all_of(page: Tab, topic: str, value: int) -> None:
    """Read news until a topic has this value."""
    while (await page.telemetry(topic))[topic] != value:
        pass


def test_a_page_that_reads_nothing_is_closed_and_delays_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page_module, "PAGE_READ_TIMEOUT_S", 0.05)

    async def test() -> None:
        async with served() as site, tab(site) as other:
            await other.call("web.hello")
            port, before = int(site.url.rpartition(":")[2]), set(site.pages.open)
            frozen = socket.socket()
            frozen.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            frozen.connect(("127.0.0.1", port))
            head = (
                f"GET /socket HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nOrigin: {site.url}\r\n"
                f"Cookie: {site.cookie['Cookie']}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
                "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
            )
            frozen.sendall(head.encode())
            await all_of(other, "pages", 2)
            (page,) = site.pages.open - before
            big = b"\x92\xa7samples\xc6" + (1 << 20).to_bytes(4, "big") + bytes(1 << 20)
            reading = asyncio.create_task(all_of(other, "pages", 1))
            while len(site.pages.open) == 2:
                page.outbox.telemetry("samples", big)
                await asyncio.sleep(0.005)
            await reading
            assert "result" in await other.call("web.hello")
            frozen.close()

    asyncio.run(test())


def test_a_page_that_vanishes_leaves_nothing_behind() -> None:
    async def test() -> None:
        async with served() as site:
            before = len(zmq.asyncio.Context.instance()._sockets)
            for _ in range(5):
                async with tab(site) as page:
                    await page.call("web.hello")
                    await page.send({"jsonrpc": "2.0", "id": "x", "method": "get_scene"})
                    transport = page.socket.get_extra_info("socket")
                    transport.shutdown(socket.SHUT_RDWR)
                    await until(lambda: not site.pages.open)
            assert len(zmq.asyncio.Context.instance()._sockets) == before

    asyncio.run(test())
