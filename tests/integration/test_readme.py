"""README.md as a reader follows it: its blocks of shell and Python, one after the other, as they stand there."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SHELL = ("sh", "bash", "shell", "console", "")
"""Languages of fenced blocks that a shell takes; a block that is only indented has none."""

NOT_RUN = {
    r"^make ": "whole runs of their own, which CI makes",
}
"""Blocks that are left alone, by what they look like, and why."""

HOLDS_A_TERMINAL = r"^hapticd run\b"
"""A block with such a line runs until Ctrl-C: the blocks after it run meanwhile, as in a second terminal."""


@dataclass(frozen=True, slots=True)
class Block:
    """A block of code of the page."""

    line: int
    language: str
    code: str


def blocks(text: str) -> Iterator[Block]:
    """Fenced ones, and those that are indented by four columns after an empty line."""
    fence: str | None = None
    code: list[str] = []
    begun, before = 0, ""
    for number, line in enumerate([*text.splitlines(), ""], 1):
        if fence is not None:
            if line.startswith("```"):
                yield Block(begun, fence, "\n".join(code) + "\n")
                fence, code = None, []
            else:
                code.append(line)
        elif line.startswith("```"):
            fence, begun = line.removeprefix("```").strip(), number
        elif line.startswith("    ") and (code or not before):
            begun = begun if code else number
            code.append(line[4:])
        elif code:
            yield Block(begun, "", "\n".join(code) + "\n")
            code = []
        before = line.strip()


PAGE = (ROOT / "README.md").read_text()
BLOCKS = list(blocks(PAGE))


class Reader:
    """Somebody with the page in hand, in a clone where `make` has set up everything, and nothing of their own."""

    def __init__(self, home: Path) -> None:
        self.home = home
        if not Path(sys.prefix, "bin", "activate").exists():
            pytest.skip("not in a virtual environment, which README.md speaks of")
        (home / ".venv").symlink_to(sys.prefix)
        (home / "config").symlink_to(ROOT / "config")
        self.runtime = home / "run"
        self.runtime.mkdir(mode=0o700)
        path = f"{Path(sys.prefix, 'bin')}:{os.environ['PATH']}"
        self.environment = {**os.environ, "HOME": str(home), "XDG_RUNTIME_DIR": str(self.runtime), "PATH": path}
        self.environment.pop("RUNTIME_DIRECTORY", None)

    def has_recordings(self) -> None:
        """Made by the command that the page names within a sentence."""
        (command,) = re.findall(r"`(hapticd fit synthesize [^`]*)`", PAGE)
        self.finishes(Block(0, "sh", f"{command}\n"))

    def starts(self, block: Block) -> subprocess.Popen[str]:
        words = [sys.executable, "-c"] if block.language == "python" else ["sh", "-ec"]
        return subprocess.Popen(
            [*words, block.code],
            cwd=self.home,
            env=self.environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    def finishes(self, block: Block) -> None:
        with self.starts(block) as process:
            try:
                out, err = process.communicate(timeout=300)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                raise
        assert process.returncode == 0, f"README.md:{block.line}: exit code {process.returncode}\n{out}{err}"
        assert "Traceback" not in err, f"README.md:{block.line}: {err}"

    @contextmanager
    def holds(self, block: Block) -> Iterator[None]:
        """A block that runs until Ctrl-C, from the moment its daemon is ready."""
        with self.starts(block) as process:
            try:
                deadline = time.monotonic() + 60
                while not (self.runtime / "hapticd" / "hapticd.command").exists():
                    assert process.poll() is None, f"README.md:{block.line}: {process.communicate()}"
                    assert time.monotonic() < deadline, f"README.md:{block.line}: no daemon in a minute"
                    time.sleep(0.01)  # another process: its socket file is the event, and nothing tells of it
                yield
            finally:
                with suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGINT)
                err = process.communicate(timeout=60)[1]
        # The shell is sent Ctrl-C as well.
        assert process.returncode in (0, -signal.SIGINT, 128 + signal.SIGINT), err
        assert "SIGINT: stopping" in err


@pytest.mark.slow
def test_every_block_runs() -> None:
    """In the order of the page: a block finds what those before it have made."""
    # Not in pytest's own folder: the name of a socket may not be long.
    with tempfile.TemporaryDirectory(prefix="hapticd-test-") as home, ExitStack() as stack:
        reader = Reader(Path(home))
        reader.has_recordings()
        for block in BLOCKS:
            if why_not(block) is not None:
                continue
            if re.search(HOLDS_A_TERMINAL, block.code, re.MULTILINE):
                stack.enter_context(reader.holds(block))
            else:
                reader.finishes(block)


@pytest.mark.slow
def test_the_commands_of_the_page_of_materials_run() -> None:
    """They need nothing but each other."""
    with tempfile.TemporaryDirectory(prefix="hapticd-test-") as home:
        reader = Reader(Path(home))
        commands = [block for block in blocks((ROOT / "docs" / "materials.md").read_text()) if block.language == "sh"]
        assert len(commands) == 3
        for block in commands:
            reader.finishes(block)


def why_not(block: Block) -> str | None:
    """Why a block is not run; None for one that is."""
    return next((why for look, why in NOT_RUN.items() if re.search(look, block.code, re.MULTILINE)), None)


def test_each_block_is_run_or_listed() -> None:
    for block in BLOCKS:
        runs = block.language == "python" or block.language in SHELL
        assert runs or why_not(block) is not None, f"README.md:{block.line}: neither run nor listed as not run"
    for look in NOT_RUN:
        assert any(re.search(look, block.code, re.MULTILINE) for block in BLOCKS), f"{look!r} is nowhere any more"
    assert {block.language for block in BLOCKS} >= {"python", "sh", ""}
