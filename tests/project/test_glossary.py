"""docs/glossary.md: each term is linked from a page that uses it, and no page writes a term's link wrong."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
GLOSSARY = ROOT / "docs" / "glossary.md"
PAGES = [ROOT / "README.md", *(page for page in sorted((ROOT / "docs").rglob("*.md")) if page != GLOSSARY)]


def anchors() -> list[str]:
    headings = re.findall(r"^### (.+)$", GLOSSARY.read_text(), flags=re.MULTILINE)
    return [heading.lower().replace(" ", "-") for heading in headings]


def test_each_term_is_linked_from_a_page_that_uses_it() -> None:
    linked = {name for page in PAGES for name in re.findall(r"\((?:docs/|\.\./)?glossary\.md#([\w-]+)\)", page.read_text())}
    assert linked == set(anchors())


def test_terms_are_unique() -> None:
    assert len(anchors()) == len(set(anchors())) > 50


def test_each_term_has_a_definition() -> None:
    for part in GLOSSARY.read_text().split("\n### ")[1:]:
        term, _, meaning = part.partition("\n")
        assert len(meaning.split("\n## ")[0].split()) >= 6, term
