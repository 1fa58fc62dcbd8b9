"""A real bridge in a process of its own, with keys for whoever a test names."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import zmq
from zmq.utils.monitor import recv_monitor_message

from hapticd.protocol.keys import new_certificate, write_certificate
from hapticd.protocol.remote import Remote
from tests.support.daemon_process import PATIENCE_S

HANDSHAKES = zmq.EVENT_HANDSHAKE_SUCCEEDED | zmq.EVENT_DISCONNECTED
FAILURES = zmq.EVENT_HANDSHAKE_FAILED_AUTH | zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL | zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL


class Bridge:
    """The process, its keys and what it says."""

    def __init__(self, folder: Path, daemon: Path, clients: Mapping[str, str], **config: Any) -> None:
        self.folder, self.clients = folder, dict(clients)
        self.file = folder / "bridge.yaml"
        self.keys = {name: new_certificate() for name in ("server", "stranger", *clients)}
        write_certificate(self.keys["server"], "server", folder / "keys")
        self.config = {"listen": "tcp://127.0.0.1:0", "metrics": "127.0.0.1:0", **config}
        self._daemon = daemon
        self._lines: list[str] = []
        self._said = threading.Condition()
        self._start()

    def _start(self) -> None:
        self.write(self.clients)
        self.process = subprocess.Popen(
            [sys.executable, "-m", "hapticd", "--runtime-dir", str(self._daemon), "bridge", "-c", str(self.file)],
            stderr=subprocess.PIPE,
            text=True,
        )
        self._lines.clear()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        ready = self.hears(r"ready: commands at tcp://(.*):(\d+),")
        self.host, self.port = ready[1], int(ready[2])

    def start_again(self) -> None:
        """After its end: at the same address, with the same keys."""
        self.close()
        self.config["listen"] = self.address
        self._start()

    def write(self, clients: Mapping[str, str]) -> None:
        entries = {name: {"public_key": self.keys[name].public_key, "may": may} for name, may in clients.items()}
        self.file.write_text(json.dumps({**self.config, "clients": entries}))

    def _read(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            with self._said:
                self._lines.append(line)
                self._said.notify_all()
        with self._said:
            self._lines.append("the end")
            self._said.notify_all()

    def hears(self, pattern: str, since: int = 0) -> re.Match[str]:
        """The first line after the `since`th that holds the pattern, as soon as it was said."""

        def found() -> re.Match[str] | None:
            return next((match for line in self._lines[since:] if (match := re.search(pattern, line))), None)

        with self._said:
            assert self._said.wait_for(lambda: found() or "the end" in self._lines, PATIENCE_S), self._lines
            match = found()
            assert match is not None, self._lines
            return match

    def said(self, text: str) -> list[str]:
        """The lines so far that hold the text."""
        with self._said:
            return [line for line in self._lines if text in line]

    @property
    def spoken(self) -> int:
        """How many lines it has said."""
        with self._said:
            return len(self._lines)

    def reload(self, clients: Mapping[str, str], expected: str = "reloaded: ") -> str:
        """Other clients; returns the line that tells of it."""
        since = self.spoken
        self.write(clients)
        self.process.send_signal(signal.SIGHUP)
        return self.hears(f".*{expected}.*", since)[0]

    def at(self, name: str, server: str = "server") -> Remote:
        """Where the bridge is, as one of those with a key sees it."""
        return Remote(self.host, self.port, self.keys[name], self.keys[server].public_key)

    @property
    def address(self) -> str:
        return f"tcp://{self.host}:{self.port}"

    def as_client(self, name: str) -> dict[str, Any]:
        """The keyword arguments of `connect`."""
        return {"key": self.keys[name], "server_key": self.keys["server"].public_key}

    def raw(self, telemetry: bool = False) -> socket.socket:
        """A connection without ZeroMQ."""
        return socket.create_connection((self.host, self.port + telemetry), PATIENCE_S)

    @contextmanager
    def held(self) -> Iterator[None]:
        """It stands still meanwhile; the kernel takes connections for it."""
        self.process.send_signal(signal.SIGSTOP)
        os.waitpid(self.process.pid, os.WUNTRACED)
        try:
            yield
        finally:
            self.process.send_signal(signal.SIGCONT)

    def stop(self) -> int:
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(PATIENCE_S)

    def close(self) -> None:
        """After its end."""
        self.process.kill()
        self.process.wait()
        self._reader.join()
        assert self.process.stderr is not None
        self.process.stderr.close()


@contextmanager
def running_bridge(folder: Path, daemon: Path, clients: Mapping[str, str], **config: Any) -> Iterator[Bridge]:
    """A bridge that is ready; afterwards stopped, which must go well."""
    bridge = Bridge(folder, daemon, clients, **config)
    try:
        yield bridge
    finally:
        try:
            assert bridge.process.poll() is not None or bridge.stop() == 0
        finally:
            bridge.close()


class Peer:
    """A socket of ZeroMQ with whatever keys, and the events of its connection."""

    def __init__(self, kind: int, endpoint: str, remote: Remote | None = None) -> None:
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self.socket = self._context.socket(kind)
        self.socket.setsockopt(zmq.LINGER, 0)
        self.socket.setsockopt(zmq.RCVTIMEO, int(1e3 * PATIENCE_S))
        self.socket.setsockopt(zmq.SNDTIMEO, int(1e3 * PATIENCE_S))
        if remote is not None:
            remote.secure(self.socket)
        self._monitor = self.socket.get_monitor_socket(HANDSHAKES | FAILURES)
        self.socket.connect(endpoint)

    def event(self) -> int:
        """The next event."""
        assert self._monitor.poll(1e3 * PATIENCE_S)
        return int(recv_monitor_message(self._monitor)["event"])

    def more(self) -> bool:
        """Whether something else happened."""
        return bool(self._monitor.poll(0))

    def close(self) -> None:
        self.socket.disable_monitor()
        self._monitor.close()
        self._context.destroy(0)

    def __enter__(self) -> Peer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
