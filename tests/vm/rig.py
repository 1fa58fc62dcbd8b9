"""What the jobs in the guest share: checks, one line each, and a daemon in a process of its own."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import yaml

import hapticd

OUT = Path(os.environ.get("VM_OUT", "/run"))
RUNTIME = Path("/run/hapticd")
_failed: list[str] = []


def check(holds: bool, what: str, *seen: object) -> bool:
    """One line: what must hold, and what was seen."""
    detail = (
        ": " + ", ".join(f"{value:.4g}" if isinstance(value, float) else str(value) for value in seen) if seen else ""
    )
    print(f"  {'ok    ' if holds else 'FAILED'} {what}{detail}")
    if not holds:
        _failed.append(what)
    return holds


def scenario(title: str) -> None:
    """A heading."""
    print(f"{title}  [{time.monotonic():.1f} s]")


def done() -> None:
    """Ends the job."""
    print("ok" if not _failed else f"{len(_failed)} of the checks failed: {'; '.join(_failed)}")
    sys.stdout.flush()
    os._exit(1 if _failed else 0)


def until(holds: Callable[[], Any], seconds: float, every: float = 0.005) -> Any:
    """What `holds` says as soon as it is true, or after `seconds`."""
    deadline = time.monotonic() + seconds
    while not (answer := holds()) and time.monotonic() < deadline:
        time.sleep(every)
    return answer


class Daemon:
    """A daemon that is ready, and a client of it."""

    def __init__(self, config: dict[str, Any], name: str = "daemon") -> None:
        path = Path(f"/run/{name}.yaml")
        path.write_text(yaml.safe_dump(config))
        self.log = OUT / f"{name}.log"
        with open(self.log, "wb") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "hapticd", "--runtime-dir", str(RUNTIME), "run", "-c", str(path)],
                stdout=subprocess.DEVNULL,
                stderr=log,
            )
        ready = until(
            lambda: (RUNTIME / "hapticd.command").exists() or self.process.poll() is not None, 120, every=0.02
        )
        if not ready or self.process.poll() is not None:
            raise RuntimeError(f"the daemon did not start: {self.said()}")
        self.client = hapticd.connect(RUNTIME, timeout_s=30)

    def said(self) -> str:
        return self.log.read_text()

    def device(self) -> dict[str, Any]:
        """`connection` of get_status."""
        status: Any = self.client.get_status()
        device: dict[str, Any] = status["connection"]
        return device

    def faults(self) -> list[str]:
        """Names of the faults that are latched."""
        status: Any = self.client.get_status()
        return list(status["faults"])

    def kill(self, number: int) -> None:
        os.kill(self.process.pid, number)

    def stop(self, number: int = signal.SIGTERM) -> int:
        self.client.close()
        self.kill(signal.SIGCONT)
        self.kill(number)
        return self.process.wait(60)


@contextlib.contextmanager
def daemon(config: dict[str, Any], name: str = "daemon") -> Iterator[Daemon]:
    """A daemon; whatever happens it is ended, so that it lets go of its device before the device goes."""
    running = Daemon(config, name)
    try:
        yield running
    finally:
        if running.process.poll() is None:
            running.kill(signal.SIGCONT)
            running.kill(signal.SIGKILL)
            running.process.wait(60)
