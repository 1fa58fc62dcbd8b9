"""Pages of the documentation as a reader follows them: their blocks of code, and somebody who runs these as they stand.

A block that cannot run has a comment before it, `<!-- not run: REASON -->`.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.support.daemon_process import listens

ROOT = Path(__file__).parents[2]
SHELL = ("sh", "bash", "shell", "console")
"""Languages of fenced blocks that a shell takes."""
COMMANDS = ("hapticd", "python", "pip", "make", "sudo", "journalctl", ".", "cat", "printf", "$")
"""First words of commands: an indented block that begins with none of them is a formula, a table or output."""
HOLDS_A_TERMINAL = r"^hapticd run\b"
"""A block with such a line runs until Ctrl-C: the blocks after it run meanwhile, as in a second terminal."""
NOT_RUN = re.compile(r"<!-- not run: (.+) -->")


@dataclass(frozen=True, slots=True)
class Block:
    """A block of code of a page."""

    page: str
    line: int
    language: str
    code: str
    not_run: str | None = None
    """Why it is not run, as the page says."""

    @property
    def is_shell(self) -> bool:
        words = self.code.split()
        return self.language in SHELL or (not self.language and bool(words) and words[0] in COMMANDS)

    @property
    def where(self) -> str:
        return f"{self.page}:{self.line}"


def blocks(page: Path) -> Iterator[Block]:
    """Fenced ones, also within a list, and those that are indented by four columns after an empty line."""
    name = str(page.relative_to(ROOT))
    fence: str | None = None
    code: list[str] = []
    reason: str | None = None
    begun, before = 0, ""

    def block(language: str) -> Block:
        return Block(name, begun, language, textwrap.dedent("\n".join(code) + "\n"), reason)

    for number, line in enumerate([*page.read_text().splitlines(), ""], 1):
        stripped = line.strip()
        if fence is not None:
            if stripped == "```":
                yield block(fence)
                fence, code, reason = None, [], None
            else:
                code.append(line)
        elif line.startswith("    ") and (code or not before) and not stripped.startswith("```"):
            begun = begun if code else number
            code.append(line[4:])
        else:
            if code:
                yield block("")
                code, reason = [], None
            if stripped.startswith("```"):
                fence, begun = stripped.removeprefix("```").strip(), number
            elif (found := NOT_RUN.fullmatch(stripped)) is not None:
                reason = found[1]
            elif stripped:
                reason = None
        before = stripped


class Reader:
    """Somebody with a page in hand, in a clone where `make` has set up everything, and nothing of their own."""

    def __init__(self, home: Path) -> None:
        self.home = home
        if not Path(sys.prefix, "bin", "activate").exists():
            pytest.skip("not in a virtual environment, which README.md speaks of")
        self.folder = home
        self.runtime = home / "run"
        self.runtime.mkdir(mode=0o700)
        self._clone(home)
        path = f"{Path(sys.prefix, 'bin')}:{os.environ['PATH']}"
        self.environment = {**os.environ, "HOME": str(home), "XDG_RUNTIME_DIR": str(self.runtime), "PATH": path}
        for name in ("RUNTIME_DIRECTORY", "HAPTICD_RUNTIME_DIR", "HAPTICD_CONFIG"):
            self.environment.pop(name, None)

    @staticmethod
    def _clone(folder: Path) -> None:
        (folder / ".venv").symlink_to(sys.prefix)
        for name in ("config", "examples"):
            (folder / name).symlink_to(ROOT / name)

    def turns_to(self, page: str) -> None:
        """Works in a new folder, beside the same daemon."""
        self.folder = self.home / page.replace("/", "-")
        self.folder.mkdir()
        self._clone(self.folder)

    def starts(self, block: Block) -> subprocess.Popen[str]:
        words = [sys.executable, "-c"] if block.language == "python" else ["bash", "-ec"]
        return subprocess.Popen(
            [*words, block.code],
            cwd=self.folder,
            env=self.environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    def finishes(self, block: Block) -> str:
        """Its output and its errors. Fails where it fails."""
        with self.starts(block) as process:
            try:
                out, err = process.communicate(timeout=300)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                raise
        assert process.returncode == 0, f"{block.where}: exit code {process.returncode}\n{out}{err}"
        assert "Traceback" not in err, f"{block.where}: {err}"
        return out + err

    @contextmanager
    def holds(self, block: Block) -> Iterator[None]:
        """A block that runs until Ctrl-C, from the moment its daemon is ready."""
        with self.starts(block) as process:
            try:
                deadline = time.monotonic() + 60
                while not listens(self.runtime / "hapticd" / "hapticd.command"):
                    assert process.poll() is None, f"{block.where}: {process.communicate()}"
                    assert time.monotonic() < deadline, f"{block.where}: no daemon in a minute"
                    time.sleep(0.01)  # another process: its socket is the event, and nothing tells of it
                yield
            finally:
                with suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGINT)
                err = process.communicate(timeout=60)[1]
        # The shell is sent Ctrl-C as well.
        assert process.returncode in (0, -signal.SIGINT, 128 + signal.SIGINT), err
        assert "SIGINT: stopping" in err


def told(output: str, shown: str) -> list[str]:
    """Lines of a shown output that the real one has not, whatever their numbers and units are."""

    def shape(line: str) -> str:
        return re.sub(r"\d[\d.,]*( m?N\b)?", "#", line.strip())

    real = {shape(line) for line in output.splitlines()}
    return [line for line in shown.splitlines() if line.strip() and shape(line) not in real]
