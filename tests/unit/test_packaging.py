"""What pyproject.toml says, beside what the package and the pages say of it."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
EXTRAS = PYPROJECT["project"]["optional-dependencies"]


def test_messages_and_pages_name_extras_that_exist() -> None:
    told = {
        (extra, path.name)
        for folder, pattern in (("hapticd", "*.py"), ("docs", "*.md"))
        for path in (ROOT / folder).rglob(pattern)
        for names in re.findall(r"hapticd\[([a-z,]+)\]", path.read_text())
        for extra in names.split(",")
    }
    assert {extra for extra, _ in told} == {"fit", "mcap"}
    assert {"fit", "mcap"} < EXTRAS.keys()


def test_the_extra_for_fits_keeps_its_first_name() -> None:
    assert sorted(re.match(r"[a-z]+", each)[0] for each in EXTRAS["fit"]) == ["matplotlib", "scipy"]  # type: ignore[index]
    assert EXTRAS["plots"] == ["hapticd[fit]"]
