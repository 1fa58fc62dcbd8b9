"""What the jobs in the guest share: checks, one line each, and processes, the daemon among them."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

import hapticd
import hapticd.cli

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


def _code(run: Callable[[], object]) -> int:
    """The exit code of a process that does this."""
    try:
        answer = run()
        return answer if isinstance(answer, int) else 0
    except SystemExit as ended:
        if ended.code is not None and not isinstance(ended.code, int):
            print(ended.code, file=sys.stderr)
        return ended.code if isinstance(ended.code, int) else int(ended.code is not None)
    except BaseException:
        traceback.print_exc()
        return 1


class Child:
    """A process that does `run`, with everything imported already, and none of the files that its parent has open."""

    def __init__(
        self, run: Callable[[], object], argv: Sequence[str] | None = None, out: int = 1, err: int = 2
    ) -> None:
        sys.stdout.flush()
        sys.stderr.flush()
        self.returncode: int | None = None
        self.pid = os.fork()
        if self.pid == 0:
            os.dup2(out, 1)
            os.dup2(err, 2)
            os.closerange(3, 4096)
            sys.stdout, sys.stderr = (os.fdopen(number, "w", 1, closefd=False) for number in (1, 2))
            sys.argv = sys.argv if argv is None else list(argv)
            sys.setswitchinterval(0.005)
            code = _code(run)
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)

    def poll(self) -> int | None:
        """The exit code, or minus the signal that ended it; None while it runs."""
        if self.returncode is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            self.returncode = os.waitstatus_to_exitcode(status) if pid else None
        return self.returncode

    def wait(self, seconds: float = 60) -> int | None:
        """As `poll`, once it has ended, or after that time."""
        until(lambda: self.poll() is not None, seconds)
        return self.returncode

    def kill(self, number: int) -> None:
        os.kill(self.pid, number)


@dataclass(frozen=True)
class Answer:
    """What a process that has ended left: as subprocess has it."""

    returncode: int | None
    stdout: str
    stderr: str


def answer_of(run: Callable[[], object], argv: Sequence[str] | None = None, seconds: float = 60) -> Answer:
    """Does `run` in a process of its own, to its end."""
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        child = Child(run, argv, out.fileno(), err.fileno())
        if child.wait(seconds) is None:
            child.kill(signal.SIGKILL)
            child.wait()
        said = []
        for file in (out, err):
            file.seek(0)
            said.append(file.read().decode())
        return Answer(child.returncode, *said)


def hapticd_says(*words: str) -> Answer:
    """The command `hapticd WORDS`."""
    return answer_of(lambda: hapticd.cli.main(words))


class Daemon:
    """A daemon that is ready, and a client of it."""

    def __init__(self, config: dict[str, Any], name: str = "daemon") -> None:
        path = Path(f"/run/{name}.yaml")
        path.write_text(yaml.safe_dump(config))
        self.log = OUT / f"{name}.log"
        # One that was killed leaves its sockets, which would look ready.
        shutil.rmtree(RUNTIME, ignore_errors=True)
        with open(self.log, "wb") as log:
            words = ["--runtime-dir", str(RUNTIME), "run", "-c", str(path)]
            self.process = Child(lambda: hapticd.cli.main(words), ["hapticd", *words], log.fileno(), log.fileno())
        ready = until(
            lambda: (RUNTIME / "hapticd.command").exists() or self.process.poll() is not None, 120, every=0.02
        )
        if not ready or self.process.poll() is not None:
            raise RuntimeError(f"the daemon did not start: {self.said()}")
        self.client = hapticd.connect(RUNTIME, timeout_s=30, wait_s=30)

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
        self.process.kill(number)

    def stop(self, number: int = signal.SIGTERM) -> int | None:
        """Its exit code."""
        self.kill(signal.SIGCONT)
        self.kill(number)
        code = self.process.wait()
        self.client.close()
        return code


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
            running.process.wait()
