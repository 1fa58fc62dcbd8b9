"""Every block of code of docs/: shell and Python run as they stand, YAML and JSON are valid for what takes them."""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import pytest

from hapticd.base.yaml_source import load_text
from hapticd.config.configuration import load_config
from hapticd.config.document_kinds import kind_of
from hapticd.experiment.study import load_study
from hapticd.fit.recording import load as load_recording
from tests.support.page_blocks import HOLDS_A_TERMINAL, ROOT, Block, Reader, blocks, told

LESSONS = [
    ROOT / "docs" / "tutorial" / f"{name}.md"
    for name in ("install", "first_wall", "first_recording", "own_material", "cork", "first_experiment")
]
PAGES = [page for page in sorted((ROOT / "docs").rglob("*.md")) if page not in LESSONS]
BLOCKS = [block for page in (*LESSONS, *PAGES) for block in blocks(page)]
PREPARED = {
    "docs/reference/recordings.md": "hapticd record tap.npz --for 1s",
}
"""What a page says in a sentence that it had somebody do before its blocks."""
MARKED = 41
"""Blocks that say why they are not run. More is a decision, not an accident."""


def follows(reader: Reader, page: Path, stack: ExitStack) -> None:
    """Runs the blocks of a page in their order; what it shows as output must be what came."""
    output = ""
    for block in blocks(page):
        if block.not_run is not None:
            continue
        if block.is_shell and re.search(HOLDS_A_TERMINAL, block.code, re.MULTILINE):
            stack.enter_context(reader.holds(block))
        elif block.is_shell or block.language == "python":
            output = reader.finishes(block)
        elif block.language == "text":
            assert told(output, block.code) == [], f"{block.where}: not what came:\n{output}"


@pytest.mark.slow
def test_the_lessons_run() -> None:
    """One after the other, in one folder, with the daemon that the second one starts."""
    with tempfile.TemporaryDirectory(prefix="hapticd-test-") as home, ExitStack() as stack:
        reader = Reader(Path(home))
        for lesson in LESSONS:
            follows(reader, lesson, stack)


@pytest.mark.slow
def test_every_block_of_the_other_pages_runs() -> None:
    """Each page in a folder of its own, all beside one daemon."""
    with tempfile.TemporaryDirectory(prefix="hapticd-test-") as home, ExitStack() as stack:
        reader = Reader(Path(home))
        (reader.home / "servo.yaml").write_text("servo: {rate_hz: 1000}\n")  # costs the machine less
        stack.enter_context(reader.holds(Block("", 0, "sh", "hapticd run -c servo.yaml\n")))
        for page in PAGES:
            name = str(page.relative_to(ROOT))
            reader.turns_to(name)
            if name in PREPARED:
                reader.finishes(Block(name, 0, "sh", f"{PREPARED[name]}\n"))
            follows(reader, page, stack)


def configuration(text: str, folder: Path) -> None:
    load_config(load_text(text, "block").data)


def study(text: str, folder: Path) -> None:
    (folder / "study.yaml").write_text(text)
    load_study(folder / "study.yaml")


def columns(text: str, folder: Path) -> None:
    """What says how a recording's columns are read: beside a recording that has them."""
    rows = [[0.5, 1.0, 2.0, 0.0] for _ in range(1000)]
    lines = ["x,y,z,w", *(",".join(map(str, row)) for row in rows)]
    (folder / "tap.csv").write_text("\n".join(lines) + "\n")
    (folder / "tap.csv.yaml").write_text(text)
    load_recording(folder / "tap.csv")


VALID: dict[str | None, Callable[[str, Path], None]] = {
    "configuration": configuration,
    "change": configuration,
    "materials": configuration,
    "scene": configuration,
    "study": study,
    None: columns,
}
"""By the kind of document; None: one that only the fits know."""


@pytest.mark.parametrize("block", [each for each in BLOCKS if each.language == "yaml"], ids=lambda block: block.where)
def test_yaml_is_valid(block: Block, tmp_path: Path) -> None:
    VALID[kind_of(load_text(block.code, block.where).data)](block.code, tmp_path)


@pytest.mark.parametrize("block", [each for each in BLOCKS if each.language == "json"], ids=lambda block: block.where)
def test_json_is_valid(block: Block) -> None:
    for line in block.code.splitlines():
        json.loads(line)


def test_each_block_is_run_or_says_why_not() -> None:
    known = {"python", "yaml", "json", "text", ""}
    for block in BLOCKS:
        is_directive = block.language.startswith("{")  # of Sphinx
        assert block.is_shell or is_directive or block.language in known, f"{block.where}: what is {block.language}?"
    marked = [block for block in BLOCKS if block.not_run is not None]
    assert len(marked) == MARKED, [block.where for block in marked]
    comments = sum(page.read_text().count("<!-- not run:") for page in (*LESSONS, *PAGES))
    assert comments == len(marked), "a comment stands before no block"
