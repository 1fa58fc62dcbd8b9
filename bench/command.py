"""Command round trips over ipc while the servo runs, compared with an echo of pyzmq and msgpack, in turns.

    python -m bench.command ENDPOINT       the echo server, until it is killed

Both are called by the same client: a DEALER that packs a map, sends it, waits and unpacks the answer.
"""

from __future__ import annotations

import contextlib
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import msgpack
import numpy as np
import zmq

from bench.daemon import daemon, dealer
from bench.report import ROOT, Advance, Options, Section, Table, spread
from hapticd.base.errors import HapticdError

RATE_HZ = 10_000


def echo(endpoint: str) -> None:
    """Unpack every map, pack it again and send it back."""
    with zmq.Context() as context, context.socket(zmq.ROUTER) as socket:
        socket.bind(endpoint)
        while True:
            identity, body = socket.recv_multipart()
            socket.send_multipart([identity, msgpack.packb(msgpack.unpackb(body))])


@contextlib.contextmanager
def echoing() -> Iterator[str]:
    """Run an echo server in another process, and yield its endpoint."""
    with tempfile.TemporaryDirectory(prefix="hapticd-bench-") as folder:
        endpoint = f"ipc://{Path(folder, 'echo')}"
        process = subprocess.Popen([sys.executable, "-m", "bench.command", endpoint], cwd=ROOT)
        try:
            yield endpoint
        finally:
            process.kill()
            process.wait()


def asker(socket: zmq.Socket[bytes], method: str, params: Callable[[int], dict[str, object]]) -> Callable[[int], int]:
    """Return a function that makes round trip number n and returns its duration in ns."""

    def ask(number: int) -> int:
        message = {"jsonrpc": "2.0", "id": number, "method": method, "params": params(number)}
        start = time.perf_counter_ns()
        socket.send(msgpack.packb(message))
        answer = msgpack.unpackb(socket.recv())
        taken = time.perf_counter_ns() - start
        if answer["id"] != number or "error" in answer:
            raise HapticdError(f"{method}: {answer}")
        return taken

    return ask


def run(options: Options, advance: Advance) -> Section:
    """Measure round trips of the echo and of two commands, and return their section."""
    blocks, trips = options.few(60, 6), options.few(200, 50)
    heights = (0.0, -0.001)

    def move(number: int) -> dict[str, object]:
        return {"objects": {"floor": {"point_m": [0.0, heights[number % 2]]}}}

    with (
        echoing() as endpoint,
        daemon(rate_hz=RATE_HZ) as running,
        dealer(endpoint) as bare,
        dealer(running.paths.command_endpoint) as client,
    ):
        asks = {
            "echo": asker(bare, "get_status", lambda _: {}),
            "get_status": asker(client, "get_status", lambda _: {}),
            "update_scene": asker(client, "update_scene", move),
        }
        taken: dict[str, list[list[int]]] = {name: [] for name in asks}
        for ask in asks.values():
            for number in range(200):
                ask(number)
        for block in range(blocks):
            for name, ask in asks.items():
                taken[name].append([ask(number) for number in range(trips)])
            advance((block + 1) / blocks, "round trips")
    each = {name: np.array(values) for name, values in taken.items()}
    middle = {name: np.median(values, axis=1) for name, values in each.items()}
    late = {name: float(np.percentile(values, 99)) for name, values in each.items()}
    rows = []
    for name in asks:
        cells = [spread(middle[name], ".1f", 1e-3), f"{late[name] / 1e3:.1f}", f"{each[name].max() / 1e3:.0f}"]
        if name == "echo":
            rows.append([name, *cells, "", "", ""])
            continue
        aim = 1.3 if name == "get_status" else 1.7
        ratio = middle[name] / middle["echo"]
        tail = late[name] / late["echo"]
        fine = float(np.median(ratio)) <= aim and tail <= 2.5
        aims = f"{aim:g}, 2.5"
        rows.append([name, *cells, spread(ratio, ".2f"), f"{tail:.2f}", f"{aims}: {'yes' if fine else '**no**'}"])
    return Section(
        "Command round trip",
        [
            f"A daemon with the servo at {RATE_HZ} Hz answers over ipc. The echo is another process that returns each "
            "message. `update_scene` moves one wall, alternately up and down. Ratios to the echo are taken block by "
            "block for p50, and over the complete run for p99.",
            Table(
                f"Round trip, us, {blocks} interleaved blocks of {trips} round trips of each kind",
                ["", "p50 (10 to 90 %)", "p99", "worst", "p50, ratio to echo", "p99, ratio to echo", "aims, reached"],
                rows,
            ),
        ],
    )


if __name__ == "__main__":
    echo(sys.argv[1])
