"""A stranger in another network namespace does what he can to a bridge.

python -m tests.soak.attack_bridge [SECONDS [NAME]...]      as root, as it needs a network namespace

One kind of attack after the other, SECONDS (60) each, and before each a quarter of that without. All the while a client
asks the daemon through the bridge, another one beside the daemon, and Prometheus's own parser reads the metrics. Prints
for each kind what the stranger did, the round trips of both clients without and with it (what they have in common is
the machine's), and the bridge's descriptors and memory. Ends with 1 if the scene changed, or descriptors or memory grew
without end; a client that is not answered within a minute ends it at once.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import random
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Awaitable, Callable
from pathlib import Path

import numpy as np
import zmq
from prometheus_client.parser import text_string_to_metric_families

from hapticd.client.blocking import Client, connect
from hapticd.protocol.keys import new_certificate
from tests.support.bridge_process import Bridge, running_bridge
from tests.support.daemon_process import running_daemon
from tests.support.network_namespace import network_namespace

GREETING = b"\xff\0\0\0\0\0\0\0\x01\x7f\x03\x01CURVE" + bytes(15 + 32)
MOST_DESCRIPTORS = 64 * 8 + 200
MOST_GROWTH_KIB = 32 * 1024
AT_ONCE = 200

Attack = Callable[[str, int, float], int]


# ---- the stranger ----------------------------------------------------------------------------------------------------


def _by_many(visit: Callable[[str, int], Awaitable[None]], ports: int = 2) -> Attack:
    """So many at a time, again and again."""

    def attack(host: str, port: int, seconds: float) -> int:
        visits = 0

        async def again(number: int, end: float) -> None:
            nonlocal visits
            while time.monotonic() < end:
                with contextlib.suppress(OSError, TimeoutError, asyncio.IncompleteReadError):
                    await visit(host, port + number % ports)
                visits += 1

        async def all_of_them() -> None:
            end = time.monotonic() + seconds
            async with asyncio.TaskGroup() as tasks:
                for number in range(AT_ONCE):
                    tasks.create_task(again(number, end))

        asyncio.run(all_of_them())
        return visits

    return attack


@contextlib.asynccontextmanager
async def _connection(host: str, port: int):  # type: ignore[no-untyped-def]
    reader, writer = await asyncio.open_connection(host, port)
    try:
        yield reader, writer
    finally:
        writer.transport.abort()


async def _silence(host: str, port: int) -> None:
    async with _connection(host, port) as (reader, writer):
        writer.write(GREETING[: random.choice((0, 1, 9, 10, 12, 63, 64))])
        await reader.read()


async def _noise(host: str, port: int) -> None:
    async with _connection(host, port) as (reader, writer):
        writer.write(random.randbytes(random.randrange(1, 2000)))
        await reader.read()


async def _noise_after_greeting(host: str, port: int) -> None:
    async with _connection(host, port) as (reader, writer):
        hello = b"\x04\xc8\x05HELLO\x01\x00" + random.randbytes(192)
        writer.write(GREETING + random.choice((hello, random.randbytes(random.randrange(1, 500)))))
        await reader.read()


async def _huge_frame(host: str, port: int) -> None:
    async with _connection(host, port) as (_, writer):
        size = random.choice((2**31, 2**40, 2**63 - 1, 2**64 - 1))
        writer.write(GREETING + random.choice((b"\x06", b"\x02", b"\x03")) + struct.pack(">Q", size))
        for _ in range(100):
            writer.write(bytes(65536))
            await writer.drain()


async def _slow(host: str, port: int) -> None:
    async with _connection(host, port) as (_, writer):
        for byte in GREETING:
            writer.write(bytes([byte]))
            await writer.drain()
            await asyncio.sleep(0.3)


async def _old_subscriber(host: str, port: int) -> None:
    """ZMTP 3 without a mechanism, ZMTP 2 and ZMTP 1, and subscriptions without waiting."""
    null = b"\xff\0\0\0\0\0\0\0\x01\x7f\x03\x00NULL" + bytes(16 + 32) + b"\x04\x19\x05READY\x0bSocket-Type\0\0\0\x03SUB"
    greeting = random.choice((null, b"\xff\0\0\0\0\0\0\0\x01\x7f\x01\x02\0\0", b"\x01\0"))
    async with _connection(host, port) as (reader, writer):
        writer.write(greeting + b"".join(b"\0\x0c\x01topic%06d" % number for number in range(500)))
        await reader.read()


async def _knock(host: str, port: int) -> None:
    async with _connection(host, port):
        pass


def _strange_keys(host: str, port: int, seconds: float) -> int:
    """Whole handshakes with keys that nobody knows; the server's key is public."""
    end, tries = time.monotonic() + seconds, 0
    server = os.environ["SERVER_KEY"].encode()
    while time.monotonic() < end:
        with zmq.Context() as context:
            sockets = []
            for number in range(20):
                certificate = new_certificate()
                assert certificate.secret_key is not None
                made = context.socket(zmq.DEALER if number % 2 == 0 else zmq.SUB)
                made.setsockopt(zmq.LINGER, 0)
                made.setsockopt(zmq.RECONNECT_IVL, 10)
                made.setsockopt(zmq.CURVE_SERVERKEY, server)
                made.setsockopt(zmq.CURVE_PUBLICKEY, certificate.public_key.encode())
                made.setsockopt(zmq.CURVE_SECRETKEY, certificate.secret_key.encode())
                made.connect(f"tcp://{host}:{port + number % 2}")
                sockets.append(made)
                tries += 1
            time.sleep(2)  # they try, and try again
            for made in sockets:
                made.close()
    return tries


def _reset(host: str, port: int, seconds: float) -> int:
    """Connections that are reset at once, as fast as one process can."""
    end, knocks = time.monotonic() + seconds, 0
    while time.monotonic() < end:
        with contextlib.suppress(OSError), socket.create_connection((host, port + knocks % 2), 5) as made:
            made.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        knocks += 1
    return knocks


ATTACKS: dict[str, Attack] = {
    "half a handshake, then silence": _by_many(_silence),
    "noise": _by_many(_noise),
    "noise after a greeting": _by_many(_noise_after_greeting),
    "frames of up to 2^64 bytes": _by_many(_huge_frame),
    "a byte each 0.3 s": _by_many(_slow),
    "subscriptions of ZMTP 1, 2, NULL": _by_many(_old_subscriber),
    "handshakes with strange keys": _strange_keys,
    "connections that end at once": _by_many(_knock),
    "connections that are reset": _reset,
}


async def _bad_http(host: str, port: int) -> None:
    """Beside the bridge: loopback is where its metrics are."""
    async with _connection(host, port) as (reader, writer):
        writer.write(
            random.choice(
                (
                    random.randbytes(500),
                    b"GET /metrics HTTP/1.1\r\n" + b"X: y\r\n" * 5000,
                    b"POST /metrics HTTP/1.1\r\nContent-Length: 99999999999\r\n\r\n",
                    b"GET /../../etc/passwd HTTP/1.1\r\n\r\n",
                    b"GET /metrics HTTP/1.1\r\n",
                    b"",
                )
            )
        )
        await reader.read()


# ---- beside it -------------------------------------------------------------------------------------------------------


class Watch:
    """Round trips of clients, in turns, and what the bridge has taken, until it is closed."""

    def __init__(self, clients: list[Client], bridge: Bridge, metrics: str) -> None:
        self._clients, self._pid, self._metrics = clients, bridge.process.pid, metrics
        self.times_ms: list[list[float]] = [[] for _ in clients]
        self.descriptors, self.resident_kib, self.read = 0, 0, 0
        self._end = threading.Event()
        self._threads = [threading.Thread(target=work) for work in (self._ask, self._look)]
        for thread in self._threads:
            thread.start()

    def _ask(self) -> None:
        while not self._end.wait(0.02):
            for client, times_ms in zip(self._clients, self.times_ms, strict=True):
                begin = time.perf_counter()
                client.get_status()
                times_ms.append((time.perf_counter() - begin) * 1e3)

    def _look(self) -> None:
        while not self._end.wait(0.5):
            self.descriptors = max(self.descriptors, len(os.listdir(f"/proc/{self._pid}/fd")))
            pages = int(Path(f"/proc/{self._pid}/statm").read_text().split()[1])
            self.resident_kib = max(self.resident_kib, pages * os.sysconf("SC_PAGESIZE") // 1024)
            with contextlib.suppress(urllib.error.HTTPError, urllib.error.URLError, ConnectionError, TimeoutError):
                with urllib.request.urlopen(self._metrics, timeout=10) as answer:
                    families = list(text_string_to_metric_families(answer.read().decode()))
                assert families  # without the daemon's while it has said nothing for three seconds
                self.read += 1

    def close(self) -> None:
        self._end.set()
        for thread in self._threads:
            thread.join()

    def told(self) -> list[str]:
        return [f"{np.percentile(t, 50):.1f} / {np.percentile(t, 99):.1f} / {max(t):.0f}" for t in self.times_ms]


def processor_s(pid: int) -> float:
    words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def main(seconds: float, names: list[str]) -> int:
    failed = []
    with (
        tempfile.TemporaryDirectory(prefix="hapticd-attack-") as folder,
        network_namespace() as elsewhere,
    ):
        config = Path(folder) / "quiet.yaml"
        config.write_text("servo: {rate_hz: 1000, realtime: off}\n")
        with (
            running_daemon("-c", str(config)) as daemon,
            running_bridge(
                Path(folder), daemon.directory, {"alice": "command"}, listen=f"tcp://{elsewhere.here}:0"
            ) as bridge,
            connect(bridge.address, timeout_s=60, **bridge.as_client("alice")) as client,
            connect(daemon.directory, timeout_s=60) as beside,
        ):
            metrics = bridge.hears(r"metrics at (http\S+)")[1]
            environment = {**os.environ, "SERVER_KEY": bridge.keys["server"].public_key}
            revision = client.get_status()["revision"]
            first_kib = 0
            print(f"{seconds:g} s each; round trips p50 / p99 / most, ms")
            titles = "attack", "times", "through, without", "through, with", "beside, without", "beside, with"
            titles += "bridge's processor", "descriptors", "memory, KiB", "metrics read"
            print(f"| {' | '.join(titles)} |\n|{' --- |' * len(titles)}", flush=True)
            for name in names:
                quiet = Watch([client, beside], bridge, metrics)
                time.sleep(seconds / 4)
                quiet.close()
                first_kib = first_kib or quiet.resident_kib
                begin_s = processor_s(bridge.process.pid)
                loud = Watch([client, beside], bridge, metrics)
                if name == "HTTP":
                    count = _by_many(_bad_http, 1)("127.0.0.1", int(metrics.split(":")[2].split("/")[0]), seconds)
                else:
                    words = [
                        "-m",
                        "tests.soak.attack_bridge",
                        "--attack",
                        name,
                        bridge.host,
                        str(bridge.port),
                        str(seconds),
                    ]
                    done = subprocess.run(
                        elsewhere.command(*words), env=environment, capture_output=True, text=True, check=False
                    )
                    assert done.returncode == 0, done.stderr
                    count = int(done.stdout)
                loud.close()
                spent = (processor_s(bridge.process.pid) - begin_s) / seconds
                trips = [told for pair in zip(quiet.told(), loud.told(), strict=True) for told in pair]
                cells = [name, count, *trips, f"{spent:.0%}", loud.descriptors, loud.resident_kib, loud.read]
                print(f"| {' | '.join(map(str, cells))} |", flush=True)
                if loud.descriptors > MOST_DESCRIPTORS or loud.resident_kib > first_kib + MOST_GROWTH_KIB:
                    failed.append(f"{name}: {loud.descriptors} descriptors, {loud.resident_kib} KiB")
            if client.get_status()["revision"] != revision:
                failed.append("the scene has changed")
            print(f"lines in the bridge's log: {bridge.spoken}")
    for line in failed:
        print(f"FAILED {line}")
    return 1 if failed else 0


if __name__ == "__main__":
    if sys.argv[1:2] == ["--attack"]:
        print(ATTACKS[sys.argv[2]](sys.argv[3], int(sys.argv[4]), float(sys.argv[5])))
    else:
        sys.exit(main(float(sys.argv[1]) if len(sys.argv) > 1 else 60.0, sys.argv[2:] or [*ATTACKS, "HTTP"]))
