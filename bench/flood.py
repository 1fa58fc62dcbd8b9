"""What a client that floods the bridge costs another client of it, a client beside the daemon, and the servo.

The flood takes a processor's time, too, whichever bridge it is at. So there are phases of three kinds, in turns:
without one, with one at a second bridge of the same daemon, and with one at the same bridge. What the third adds to the
second is the bridge's; what the second adds to the first is the machine's and the daemon's.

python -m bench.flood [SECONDS [ROUNDS]]      prints a table
python -m bench.flood --send ADDRESS KEY SERVER_KEY      the one that floods, in a process of its own
"""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt
import zmq

from bench.daemon import daemon
from hapticd.client.blocking import Client, connect
from hapticd.protocol import messages
from hapticd.protocol.keys import new_certificate, write_certificate
from hapticd.protocol.remote import Named, remote

RATE_HZ = 10_000
CLIENTS = {"flooding": "command", "other": "command"}

Times = npt.NDArray[np.float64]


def send(address: str, key: str, server_key: str) -> None:
    """Sends requests as fast as they go, and reads what comes back, for ever."""
    place = remote(Named(address), Named(key), Named(server_key))
    body = messages.request(1, "get_status")
    with zmq.Context() as context, context.socket(zmq.DEALER) as socket:
        place.secure(socket)
        socket.connect(place.command_endpoint)
        poller = zmq.Poller()
        poller.register(socket, zmq.POLLIN | zmq.POLLOUT)
        while True:
            for _, events in poller.poll():
                if events & zmq.POLLIN:
                    socket.recv()
                if events & zmq.POLLOUT:
                    socket.send(body)


@contextlib.contextmanager
def bridge(folder: Path, directory: Path) -> Iterator[str]:
    """A bridge with its default limits that is ready; gives its address."""
    keys = folder / "keys"
    write_certificate(new_certificate(), "server", keys)
    clients = {}
    for name, may in CLIENTS.items():
        certificate = new_certificate()
        write_certificate(certificate, name, keys)
        clients[name] = {"public_key": certificate.public_key, "may": may}
    config = folder / "bridge.yaml"
    config.write_text(json.dumps({"listen": "tcp://127.0.0.1:0", "metrics": None, "clients": clients}))
    command = [sys.executable, "-m", "hapticd", "--runtime-dir", str(directory), "bridge", "-c", str(config)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    try:
        line = next(line for line in process.stderr if "ready: commands at " in line)
        yield line.split("ready: commands at ")[1].split(",")[0]
    finally:
        process.terminate()
        process.wait()
        process.stderr.close()


@contextlib.contextmanager
def flood(address: str, keys: Path) -> Iterator[None]:
    arguments = [address, str(keys / "flooding.key_secret"), str(keys / "server.key")]
    process = subprocess.Popen([sys.executable, "-m", "bench.flood", "--send", *arguments])
    try:
        yield
    finally:
        process.terminate()
        process.wait()


def phase(clients: dict[str, Client], seconds: float) -> dict[str, Times]:
    """Round trips of get_status of each client in turns, us, and lateness of the servo meanwhile, us."""
    found: dict[str, list[float]] = {name: [] for name in clients}
    lateness: list[Times] = []
    with clients["beside the daemon"].samples(timeout_s=30) as samples:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            for name, client in clients.items():
                start = time.perf_counter_ns()
                client.get_status()
                found[name].append((time.perf_counter_ns() - start) * 1e-3)
            while (batch := samples.receive(0)) is not None:
                lateness.append(np.asarray(batch["lateness_ns"] * 1e-3))
    return {**{name: np.array(times) for name, times in found.items()}, "servo's lateness": np.concatenate(lateness)}


def main(seconds: float, rounds: int) -> None:
    """Measures and prints."""
    kinds = ("without", "at another bridge", "at this bridge")
    found: dict[str, list[dict[str, Times]]] = {kind: [] for kind in kinds}
    with tempfile.TemporaryDirectory(prefix="hapticd-bench-") as name, daemon(rate_hz=RATE_HZ) as running:
        folders = [Path(name) / which for which in ("this", "another")]
        here, elsewhere = (folder / "keys" for folder in folders)
        for folder in folders:
            folder.mkdir()
        with (
            bridge(folders[0], running.paths.directory) as address,
            bridge(folders[1], running.paths.directory) as other_address,
            connect(running.paths.directory, timeout_s=30) as beside,
            connect(address, 30, key=here / "other.key_secret", server_key=here / "server.key") as through,
        ):
            clients = {"through the bridge": through, "beside the daemon": beside}
            asked = beside.get_status()
            for _ in range(rounds):
                found["without"].append(phase(clients, seconds))
                with flood(other_address, elsewhere):
                    through.get_status()
                    found["at another bridge"].append(phase(clients, seconds))
                with flood(address, here):
                    through.get_status()
                    found["at this bridge"].append(phase(clients, seconds))
            skipped = beside.get_status()["counters"]["skipped"] - asked["counters"]["skipped"]
    print(f"{rounds} phases of {seconds:g} s of each kind, in turns; p50 / p99, us; periods missed in all: {skipped}")
    print(f"| | {' | '.join(kinds)} | p50 here over p50 at the other, each round |")
    print("| --- | --- | --- | --- | --- |")
    for name in found["without"][0]:
        cells = []
        for kind in kinds:
            times = np.concatenate([each[name] for each in found[kind]])
            cells.append(" / ".join(f"{np.percentile(times, share):.0f}" for share in (50, 99)))
        pairs = zip(found["at another bridge"], found["at this bridge"], strict=True)
        ratios = " ".join(f"{np.median(after[name]) / np.median(before[name]):.2f}" for before, after in pairs)
        print(f"| {name} | {' | '.join(cells)} | {ratios} |")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--send"]:
        send(*sys.argv[2:5])
    else:
        main(float(sys.argv[1]) if len(sys.argv) > 1 else 5.0, int(sys.argv[2]) if len(sys.argv) > 2 else 5)
