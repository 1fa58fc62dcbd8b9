"""A real daemon in a process of its own, and a bare client of it that can also say wrong things."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

import msgpack
import zmq

import hapticd

PATIENCE_S = 120.0
"""How long a test waits for what is sure to come, on however busy a machine: a bound for tests that are broken."""
_ACCEPTS_CONNECTIONS = 0x10000
"""Flag of /proc/net/unix: __SO_ACCEPTCON of linux/net.h."""

connect = partial(hapticd.connect, timeout_s=PATIENCE_S)


def until(what: Callable[[], bool]) -> None:
    """Waits for what another process does and does not tell."""
    pause, deadline = threading.Event(), time.monotonic() + PATIENCE_S
    while not what():
        assert time.monotonic() < deadline
        pause.wait(0.01)


def listens(path: Path) -> bool:
    """Whether a process listens at the socket `path`. Its file is there a moment earlier, and refuses who comes then.

    The kernel's list says so without a connection, which the daemon would count.
    """
    rows = (row.split(maxsplit=7) for row in Path("/proc/net/unix").read_text().splitlines()[1:])
    return any(int(row[3], 16) & _ACCEPTS_CONNECTIONS and row[7:] == [str(path)] for row in rows)


class Daemon:
    """The process, its runtime directory and what it said."""

    def __init__(self, directory: Path, *arguments: str) -> None:
        self.directory = directory
        self.log = directory.parent / "log"
        with open(self.log, "ab") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "hapticd", "--runtime-dir", str(directory), "run", *arguments],
                stdout=subprocess.DEVNULL,
                stderr=log,
            )
        # A servo with real-time priority always runs: where others hold the processors, the thread that serves commands
        # would not beat for a second, and the forces would fade. So it runs before the others, if we have the right.
        with suppress(PermissionError):
            os.setpriority(os.PRIO_PROCESS, self.process.pid, -20)

    def wait_ready(self) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while not listens(self.directory / "hapticd.command"):
            assert self.process.poll() is None, self.said()
            assert time.monotonic() < deadline, "not ready"
            time.sleep(0.01)  # another process: its socket is the event, and nothing tells of it

    def said(self) -> str:
        return self.log.read_text()

    def stop(self, number: int = signal.SIGTERM) -> int:
        self.process.send_signal(number)
        return self.process.wait(PATIENCE_S)


class Wire:
    """One connection that sends what it is told to."""

    def __init__(self, directory: Path, kind: int = zmq.DEALER) -> None:
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self.socket = self._context.socket(kind)
        self.socket.setsockopt(zmq.LINGER, 0)
        self.socket.setsockopt(zmq.RCVTIMEO, int(1e3 * PATIENCE_S))
        self.socket.connect(f"ipc://{directory}/hapticd.command")
        self._id = 0

    def close(self) -> None:
        self._context.destroy(0)

    def raw(self, *frames: bytes) -> list[bytes]:
        self.socket.send_multipart(frames)
        return self.socket.recv_multipart()

    def body(self, body: bytes) -> dict[str, Any]:
        (reply,) = self.raw(body)
        answer = msgpack.unpackb(reply)
        assert answer["jsonrpc"] == "2.0"
        assert ("result" in answer) != ("error" in answer)
        return answer

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        self._id += 1
        answer = self.body(msgpack.packb({"jsonrpc": "2.0", "id": self._id, "method": method, "params": params}))
        assert answer["id"] == self._id
        return answer

    def result(self, method: str, **params: Any) -> dict[str, Any]:
        answer = self.call(method, **params)
        assert "result" in answer, answer
        return answer["result"]

    def error(self, method: str, **params: Any) -> dict[str, Any]:
        answer = self.call(method, **params)
        assert "error" in answer, answer
        return answer["error"]


@contextmanager
def running_daemon(*arguments: str) -> Iterator[Daemon]:
    """A daemon that is ready; afterwards stopped, which must go well."""
    with tempfile.TemporaryDirectory(prefix="hapticd-test-") as parent:
        daemon = Daemon(Path(parent) / "run", *arguments)
        try:
            daemon.wait_ready()
            yield daemon
        finally:
            if daemon.process.poll() is None:
                os.kill(daemon.process.pid, signal.SIGCONT)
                code = daemon.stop()
                assert code == 0, f"exit code {code}: {daemon.said()}"


@contextmanager
def wired(daemon: Daemon) -> Iterator[Wire]:
    """A bare client of the daemon."""
    wire = Wire(daemon.directory)
    try:
        yield wire
    finally:
        wire.close()
