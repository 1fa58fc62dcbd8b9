"""Cost of the page's server: its processor time, and the servo's lateness with a page relative to that without one.

The page is a process without a browser that reads all telemetry, since a browser would take far more processor time
than the server.

    python -m bench.web --page ADDRESS COOKIE TOPIC...      the page, until it is killed
"""

from __future__ import annotations

import asyncio
import contextlib
import subprocess
import sys
import time
from collections.abc import Iterator

import aiohttp
import msgpack
import numpy as np

from bench.daemon import Running, call, daemon, dealer
from bench.report import ROOT, Advance, Options, Section, Table, spread, verdict
from bench.resources import cpu_s
from bench.samples import SampleReader
from hapticd.base.errors import HapticdError

RATE_HZ = 10_000
IDLE = ("state", "event", "change", "status")
DRAWING = ("samples", *IDLE)
SETTLE_S = 0.5


async def page(address: str, cookie: str, topics: list[str]) -> None:
    """Subscribe and read; print a line at the first message of telemetry."""
    headers = {"Origin": address, "Cookie": cookie}
    async with aiohttp.ClientSession() as session, session.ws_connect(f"{address}/socket", headers=headers) as socket:
        ask = {"jsonrpc": "2.0", "id": 1, "method": "web.subscribe", "params": {"topics": topics}}
        await socket.send_bytes(msgpack.packb(ask))
        reading = False
        async for message in socket:
            # Telemetry is [topic, body]; the topic of the server's own messages begins with web.
            if not reading and message.data[0] == 0x92 and message.data[1:5] != b"\xa3web":
                reading = True
                print("reading", flush=True)


@contextlib.contextmanager
def server(running: Running) -> Iterator[tuple[int, str, str]]:
    """Run `hapticd web` for a daemon, and yield its process id, its address and the cookie of a session."""
    words = [sys.executable, "-m", "hapticd", "--runtime-dir", str(running.paths.directory), "web", "--port", "0"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            link = process.stdout.readline().strip()
            if not link:
                raise HapticdError("hapticd web did not start")
            yield process.pid, link.partition("/?")[0], asyncio.run(_cookie(link))
        finally:
            process.terminate()


async def _cookie(link: str) -> str:
    async with aiohttp.ClientSession() as session, session.get(link, allow_redirects=False) as response:
        return response.headers["Set-Cookie"].partition(";")[0]


@contextlib.contextmanager
def open_page(address: str, cookie: str, topics: tuple[str, ...]) -> Iterator[None]:
    """Run a page that reads telemetry while the context is active."""
    words = [sys.executable, "-m", "bench.web", "--page", address, cookie, *topics]
    with subprocess.Popen(words, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            if process.stdout.readline() != "reading\n":
                raise HapticdError("the page did not open")
            yield
        finally:
            process.kill()


def processor_percent(pid: int, seconds: float) -> float:
    """Return the processor time of a process during `seconds`, in percent of one processor."""
    time.sleep(SETTLE_S)
    before, then = cpu_s(pid)[0], time.monotonic()
    time.sleep(seconds)
    return 100 * (cpu_s(pid)[0] - before) / (time.monotonic() - then)


def p99_ns(running: Running, seconds: float) -> float:
    """Return the 99th percentile of the servo's lateness during `seconds`, in ns."""
    reader = SampleReader(running.paths.telemetry_endpoint)
    time.sleep(SETTLE_S + seconds)
    with dealer(running.paths.command_endpoint) as socket:
        tick = call(socket, "get_status")["tick"]
    assert isinstance(tick, int)
    return float(np.percentile(reader.until(tick)[-round(seconds * RATE_HZ) :]["lateness_ns"], 99))


def run(options: Options, advance: Advance) -> Section:
    """Measure the server with and without a page, and return the section."""
    pairs, seconds = options.few(8, 2), 1.0 if options.quick else 5.0
    percents: dict[tuple[str, ...], list[float]] = {IDLE: [], DRAWING: []}
    ratios = []
    with daemon(rate_hz=RATE_HZ) as running, server(running) as (pid, address, cookie):
        for index in range(pairs):
            for topics, found in percents.items():
                with open_page(address, cookie, topics):
                    found.append(processor_percent(pid, seconds))
            late = {}
            # In turns, and each first in half of the pairs.
            for with_page in (True, False) if index % 2 == 0 else (False, True):
                with open_page(address, cookie, DRAWING) if with_page else contextlib.nullcontext():
                    late[with_page] = p99_ns(running, seconds)
            ratios.append(late[True] / late[False])
            advance((index + 1) / pairs, f"pair {index + 1}")
    idle, drawing = (float(np.median(percents[topics])) for topics in (IDLE, DRAWING))
    rows = [
        ["processor time, page without samples, %", spread(percents[IDLE], ".1f"), verdict(idle, 5.0)],
        ["processor time, page with all samples, %", spread(percents[DRAWING], ".1f"), verdict(drawing, 15.0)],
        [
            "servo's p99 lateness, ratio with a page to without",
            spread(ratios, ".2f"),
            verdict(float(np.median(ratios)), 1.1),
        ],
    ]
    return Section(
        "Cost of the page's server",
        [
            Table(
                f"`hapticd web` with one page, servo at 10 kHz, {pairs} runs of {seconds:g} s; "
                "aims of the rows: 5 %, 15 %, 1.1",
                ["what", "median (10 to 90 %)", "reached"],
                rows,
            ),
            "The page is simulated by a process that reads all telemetry, without a browser.",
        ],
    )


if __name__ == "__main__":
    if sys.argv[1:2] == ["--page"]:
        asyncio.run(page(sys.argv[2], sys.argv[3], sys.argv[4:]))
