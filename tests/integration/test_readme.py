"""README.md as a reader follows it: its blocks of shell and Python, one after the other, as they stand there."""

from __future__ import annotations

import re
import tempfile
from contextlib import ExitStack
from pathlib import Path

import pytest

from tests.support.page_blocks import HOLDS_A_TERMINAL, ROOT, Block, Reader, blocks

PAGE = ROOT / "README.md"
BLOCKS = list(blocks(PAGE))
NOT_RUN = {
    r"^make ": "whole runs of their own, which CI makes",
    r"hapticd-\*\.whl$": "make wheel-test runs it in every Python of the machine",
    r"^apt install ": "it changes the system, as root",
}
"""Blocks that are left alone, by what they look like, and why."""


def why_not(block: Block) -> str | None:
    """Why a block is not run; None for one that is."""
    listed = (why for look, why in NOT_RUN.items() if re.search(look, block.code, re.MULTILINE))
    return block.not_run or next(listed, None)


@pytest.mark.slow
def test_every_block_runs() -> None:
    """In the order of the page: a block finds what those before it have made."""
    # Not in pytest's own folder: the name of a socket may not be long.
    with tempfile.TemporaryDirectory(prefix="hapticd-test-") as home, ExitStack() as stack:
        reader = Reader(Path(home))
        (command,) = re.findall(r"`(hapticd fit synthesize [^`]*)`", PAGE.read_text())
        reader.finishes(Block("README.md", 0, "sh", f"{command}\n"))
        for block in BLOCKS:
            if why_not(block) is not None:
                continue
            if re.search(HOLDS_A_TERMINAL, block.code, re.MULTILINE):
                stack.enter_context(reader.holds(block))
            else:
                reader.finishes(block)


def test_each_block_is_run_or_listed() -> None:
    for block in BLOCKS:
        runs = block.language == "python" or block.is_shell
        assert runs or why_not(block) is not None, f"{block.where}: neither run nor listed as not run"
    for look in NOT_RUN:
        assert any(re.search(look, block.code, re.MULTILINE) for block in BLOCKS), f"{look!r} is nowhere any more"
    assert {block.language for block in BLOCKS} >= {"python", "sh", ""}
