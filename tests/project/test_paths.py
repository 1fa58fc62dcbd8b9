"""Every file, module and target that a page, target or script names exists."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TEXTS = [
    *(ROOT / name for name in ("README.md", "CHANGELOG.md", "Makefile")),
    *(ROOT / ".ci").glob("*"),  # not in a source distribution
    # A superseded record may name removed files.
    *(page for page in sorted((ROOT / "docs").rglob("*.md")) if "\nStatus: superseded" not in page.read_text()),
]
SOURCES = [path for room in ("csrc", "hapticd", "tests", "bench") for path in sorted((ROOT / room).rglob("*.[chp]*"))]
ENDINGS = "c|conf|csv|h|md|npz|pml|png|py|rules|service|sh|toml|txt|yaml"
PATH = re.compile(rf"(?<![\w./~$<*-])(?:[A-Za-z_][\w-]*/)+[\w.-]*\w\.(?:{ENDINGS})\b")
CORE_FILE = re.compile(r"\bhd_\w+\.[ch]\b")
ROOMS = ("", "hapticd", "csrc", "tests", "docs", "config")
"""Where a path may begin."""
MADE = re.compile(r"hapticd/_core\.c|build/.*|tests/c/test_fuzz_NAME\.c")


@pytest.mark.parametrize("text", TEXTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_path_leads_to_a_file(text: Path) -> None:
    homes = [ROOT / room for room in ROOMS] + [text.parent]
    for path in PATH.findall(text.read_text()):
        assert MADE.fullmatch(path) or any((home / path).exists() for home in homes), path


@pytest.mark.parametrize("text", TEXTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_module_that_is_run_and_every_target_exists(text: Path) -> None:
    for module in re.findall(r"-m ((?:bench|docs|examples|hapticd|tests)(?:\.\w+)*)\b", text.read_text()):
        path = ROOT / module.replace(".", "/")
        assert path.with_suffix(".py").is_file() or (path / "__main__.py").is_file(), module
    targets = set(re.findall(r"^([a-z][a-z -]*):", (ROOT / "Makefile").read_text(), flags=re.MULTILINE))
    there = {name for names in targets for name in names.split()}
    named = re.findall(r"(?:`|^ +)make ([a-z][a-z-]*)", text.read_text(), flags=re.MULTILINE)
    assert set(named) <= there


@pytest.mark.long
def test_every_file_of_the_core_that_is_named_exists() -> None:
    there = {path.name for path in SOURCES}
    named = {
        name: path
        for path in (*TEXTS, *SOURCES)
        if path.suffix in (".c", ".h", ".md", ".py", "") and path.is_file()
        for name in CORE_FILE.findall(path.read_text())
    }
    assert {name: str(path.relative_to(ROOT)) for name, path in named.items() if name not in there} == {}
