"""A daemon in a separate process, for benchmarks of the complete daemon."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import msgpack
import yaml
import zmq

from hapticd.base.errors import HapticdError
from hapticd.system.paths import RuntimePaths

SCENE: Mapping[str, object] = {
    "objects": {"floor": {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "wood"}}
}
DEVICE: Mapping[str, object] = {"sim": {"start_m": [0, 0.01]}}


@dataclass(frozen=True, slots=True)
class Running:
    """A daemon that accepts commands."""

    pid: int
    paths: RuntimePaths
    log: Path
    """File with the log of the daemon."""
    ready_s: float
    """Time from the start of the process to the command socket, in s."""
    answered_s: float
    """Time from the start of the process to the first answer, in s."""


def call(socket: zmq.Socket[bytes], method: str, params: Mapping[str, object] | None = None) -> dict[str, object]:
    """Send a request on a DEALER socket, and return the result. Raises HapticdError for an error."""
    socket.send(msgpack.packb({"jsonrpc": "2.0", "id": 1, "method": method, "params": params or {}}))
    answer = msgpack.unpackb(socket.recv())
    if "result" not in answer:
        raise HapticdError(f"{method}: {answer.get('error')}")
    result: dict[str, object] = answer["result"]
    return result


@contextlib.contextmanager
def dealer(endpoint: str) -> Iterator[zmq.Socket[bytes]]:
    """Yield a connected DEALER socket, which waits at most ten seconds for a message."""
    with zmq.Context() as context, context.socket(zmq.DEALER) as socket:
        socket.setsockopt(zmq.LINGER, 0)
        socket.setsockopt(zmq.RCVTIMEO, 10_000)
        socket.connect(endpoint)
        yield socket


@contextlib.contextmanager
def daemon(**servo: object) -> Iterator[Running]:
    """Run a daemon with these servo settings and a wooden floor while the context is active. Raises HapticdError."""
    with tempfile.TemporaryDirectory(prefix="hapticd-bench-") as folder:
        paths = RuntimePaths(Path(folder, "run"))
        config = Path(folder, "bench.yaml")
        document = {"servo": servo, "device": dict(DEVICE), "scene": dict(SCENE)}
        config.write_text(yaml.safe_dump(document), encoding="utf-8")
        log = Path(folder, "log")  # a file, since an unread pipe would block the daemon
        begin = time.monotonic()
        with log.open("wb") as stderr:
            process = subprocess.Popen(
                [sys.executable, "-m", "hapticd", "--runtime-dir", str(paths.directory), "run", "-c", str(config)],
                stdout=subprocess.DEVNULL,
                stderr=stderr,
            )
        try:
            while not paths.command.exists():
                if process.poll() is not None or time.monotonic() > begin + 30:
                    process.kill()
                    raise HapticdError(f"the daemon does not start: {log.read_text().strip()}")
                time.sleep(0.001)  # the daemon creates the socket last
            ready_s = time.monotonic() - begin
            with dealer(paths.command_endpoint) as socket:
                call(socket, "get_status")
                yield Running(process.pid, paths, log, ready_s, time.monotonic() - begin)
        finally:
            process.send_signal(signal.SIGTERM)
            process.wait(timeout=30)
        if process.returncode != 0:
            raise HapticdError(f"the daemon ended with {process.returncode}: {log.read_text()[-5000:].strip()}")
