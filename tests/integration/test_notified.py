"""A whole daemon under something that listens as systemd does, and in a part of systemd's sandbox."""

from __future__ import annotations

import ctypes
import os
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.support.daemon_process import Daemon, Wire, wired

CONFIG = "servo: {rate_hz: 1000, realtime: off}\n"
WAIT_S = 110
"""Only keeps a broken test from hanging."""
PR_SET_MDWE, PR_GET_MDWE, PR_MDWE_REFUSE_EXEC_GAIN = 65, 66, 1


@contextmanager
def manager(directory: Path) -> Iterator[socket.socket]:
    """Where a daemon's messages arrive."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as heard:
        heard.bind(str(directory / "notify"))
        heard.settimeout(WAIT_S)
        yield heard


def next_of(heard: socket.socket, wanted: str) -> str:
    """The next message with a line that begins so; what comes before it is passed over."""
    while True:
        message = heard.recv(65536).decode()
        if any(line.startswith(wanted) for line in message.splitlines()):
            return message


@pytest.mark.long
def test_ready_alive_and_stopping(monkeypatch: pytest.MonkeyPatch) -> None:
    with tempfile.TemporaryDirectory(prefix="hapticd-test-") as parent, manager(Path(parent)) as heard:
        monkeypatch.setenv("NOTIFY_SOCKET", str(Path(parent) / "notify"))
        monkeypatch.setenv("WATCHDOG_USEC", "400000")
        monkeypatch.delenv("WATCHDOG_PID", raising=False)
        config = Path(parent) / "c.yaml"
        config.write_text(CONFIG)
        daemon = Daemon(Path(parent) / "run", "-c", str(config))
        try:
            ready = next_of(heard, "READY=1")
            assert (daemon.directory / "hapticd.command").exists()
            assert "\nSTATUS=sim at 1 kHz; scene revision 1; forces " in ready
            for _ in range(3):
                next_of(heard, "WATCHDOG=1")
            with wired(daemon) as wire:
                scene = wire.result("get_scene")["scene"]
                assert wire.result("set_scene", scene=scene)["revision"] == 2
            next_of(heard, "STATUS=sim at 1 kHz; scene revision 2; forces ")
            daemon.process.send_signal(signal.SIGTERM)
            next_of(heard, "STOPPING=1")
            assert daemon.process.wait(WAIT_S) == 0
        finally:
            daemon.process.kill()
            daemon.process.wait()
        heard.setblocking(False)
        left = []
        with pytest.raises(BlockingIOError):
            while True:
                left.append(heard.recv(65536))
        assert not any(b"READY" in message for message in left)


@pytest.mark.long
def test_a_daemon_that_does_not_start_is_never_ready(monkeypatch: pytest.MonkeyPatch) -> None:
    with tempfile.TemporaryDirectory(prefix="hapticd-test-") as parent, manager(Path(parent)) as heard:
        monkeypatch.setenv("NOTIFY_SOCKET", str(Path(parent) / "notify"))
        config = Path(parent) / "c.yaml"
        config.write_text("servo: {rate_hz: 1}\n")
        assert Daemon(Path(parent) / "run", "-c", str(config)).process.wait(WAIT_S) == 1
        heard.setblocking(False)
        with pytest.raises(BlockingIOError):
            heard.recv(65536)


@pytest.mark.long
def test_memory_that_is_never_both_writable_and_executable() -> None:
    """MemoryDenyWriteExecute of the units, by the kernel's own switch."""
    if ctypes.CDLL(None, use_errno=True).prctl(PR_GET_MDWE, 0, 0, 0, 0) < 0:
        pytest.skip("this kernel cannot deny it (before Linux 6.3)")
    program = (
        "import ctypes, sys; from hapticd.cli import main; "
        f"assert ctypes.CDLL(None).prctl({PR_SET_MDWE}, {PR_MDWE_REFUSE_EXEC_GAIN}, 0, 0, 0) == 0; "
        "sys.exit(main(['--runtime-dir', sys.argv[1], 'run', '-c', sys.argv[2]]))"
    )
    with tempfile.TemporaryDirectory(prefix="hapticd-test-") as parent, manager(Path(parent)) as heard:
        runtime, config = Path(parent) / "run", Path(parent) / "c.yaml"
        config.write_text(CONFIG)
        environment = {**os.environ, "NOTIFY_SOCKET": str(Path(parent) / "notify")}
        with open(Path(parent) / "log", "wb") as log:
            process = subprocess.Popen(
                [sys.executable, "-c", program, str(runtime), str(config)], stderr=log, env=environment
            )
        try:
            next_of(heard, "READY=1")
            wire = Wire(runtime)
            assert wire.result("get_status")["state"] == "running"
            mode = {"frequency_hz": 100, "decay_time_s": 0.01}
            wire.result("play", mode=mode, direction=[0, 1], amplitude_m_per_s2=1)
            wire.close()
            process.terminate()
            assert process.wait(WAIT_S) == 0, (Path(parent) / "log").read_text()
        finally:
            process.kill()
            process.wait()
