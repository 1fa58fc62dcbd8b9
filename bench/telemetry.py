"""Telemetry at 10 kHz to one subscriber, and to ten, one of which never reads.

python -m bench.telemetry ENDPOINT SECONDS READERS DEAD       the subscribers in one process; prints JSON at the end
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import msgpack
import numpy as np
import zmq

from bench.daemon import Running, call, daemon, dealer
from bench.lateness import lateness_of, output_of
from bench.report import Advance, Options, Section, Table
from bench.resources import memory_kib
from hapticd.client.samples import dtype_of

RATE_HZ = 10_000
READERS = 9


def subscribe(endpoint: str, seconds: float, readers: int, dead: int) -> dict[str, Any]:
    """Read all telemetry, count missing ticks, and return them with lateness and work in the first reader's samples."""
    with zmq.Context() as context:
        sockets = []
        for index in range(readers + dead):
            socket = context.socket(zmq.SUB)
            socket.setsockopt(zmq.LINGER, 0)
            if index >= readers:
                socket.setsockopt(zmq.RCVHWM, 1)
            socket.setsockopt(zmq.SUBSCRIBE, b"")
            socket.connect(endpoint)
            sockets.append(socket)
        poller = zmq.Poller()
        for socket in sockets[:readers]:
            poller.register(socket, zmq.POLLIN)
        counts = {socket: {"samples": 0, "missing": 0, "next": -1, "dropped": 0} for socket in sockets[:readers]}
        kept = []
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            for socket, _ in poller.poll(100):
                topic, body = socket.recv_multipart()
                if topic != b"samples":
                    continue
                message = msgpack.unpackb(body)
                batch = np.frombuffer(message["data"], dtype_of(message["dtype"]))
                own = counts[socket]
                if own["next"] >= 0:
                    own["missing"] += int(message["first_tick"]) - own["next"]
                own["missing"] += int(batch["tick"][-1]) - int(batch["tick"][0]) + 1 - len(batch)
                own["next"] = int(batch["tick"][-1]) + 1
                own["samples"] += len(batch)
                own["dropped"] = int(message["dropped"])
                if socket is sockets[0]:
                    kept.append(batch)
        for socket in sockets:
            socket.close()
    late, skipped = lateness_of(np.concatenate(kept), RATE_HZ)
    work = np.concatenate([batch["work_ns"] for batch in kept])
    return {
        "readers": list(counts.values()),
        "lateness_ns": np.percentile(late, (50, 99, 99.9)).tolist(),
        "work_ns": np.percentile(work, (50, 99, 99.9)).tolist(),
        "skipped": skipped,
    }


def _subscribers(running: Running, seconds: float, readers: int, dead: int) -> dict[str, Any]:
    arguments = [running.paths.telemetry_endpoint, str(seconds), str(readers), str(dead)]
    found: dict[str, Any] = json.loads(output_of([sys.executable, "-m", "bench.telemetry", *arguments]))
    return found


def run(options: Options, advance: Advance) -> Section:
    """Measure servo and subscribers, and return the section."""
    parts = options.few(3, 1)
    seconds = options.few(20, 3) / parts
    plans = {"1 subscriber": (1, 0), f"{READERS + 1} subscribers, one dead": (READERS, 1)}
    found: dict[str, list[dict[str, Any]]] = {name: [] for name in plans}
    memory: dict[str, float] = {}
    with daemon(rate_hz=RATE_HZ) as running, dealer(running.paths.command_endpoint) as client:
        for part in range(parts):
            for name, (living, dead) in plans.items():
                found[name].append(_subscribers(running, seconds, living, dead))
                memory[name] = memory_kib(running.pid)["VmRSS"] / 1024
                advance((len(found[name]) + part) / (2 * parts), name)
        dropped = call(client, "get_status")["counters"]
    rows = []
    for name, runs in found.items():
        late = np.median([run["lateness_ns"] for run in runs], axis=0) / 1e3
        work = np.median([run["work_ns"] for run in runs], axis=0)
        readers = [reader for run in runs for reader in run["readers"]]
        rows.append(
            [
                name,
                " / ".join(f"{value:.1f}" for value in late),
                " / ".join(f"{value:.0f}" for value in work),
                str(sum(run["skipped"] for run in runs)),
                str(sum(reader["samples"] for reader in readers)),
                str(sum(reader["missing"] for reader in readers)),
                f"{memory[name]:.0f}",
            ]
        )
    assert isinstance(dropped, dict)
    return Section(
        "Telemetry",
        [
            f"A daemon at {RATE_HZ} Hz, {parts * seconds:g} s of each kind of run in {parts} interleaved parts. "
            "One process reads for all subscribers; it subscribes to all topics and unpacks every batch. The dead "
            f"subscriber is connected and never reads. In total the daemon's ring dropped {dropped['samples_dropped']} "
            f"samples, and the servo missed {dropped['skipped']} periods.",
            Table(
                "Servo and subscribers; aim: no missing samples, no effect on the servo",
                [
                    "",
                    "lateness p50 / p99 / p99.9, us",
                    "work p50 / p99 / p99.9, ns",
                    "periods missed",
                    "samples read",
                    "samples missing",
                    "daemon's memory, MB",
                ],
                rows,
            ),
        ],
    )


if __name__ == "__main__":
    print(json.dumps(subscribe(sys.argv[1], float(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4]))))
