"""docs/glossary.md: each term is used by a page, and a page leads to a term once, by {term}."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[2]
GLOSSARY = ROOT / "docs" / "glossary.md"
PAGES = [page for page in sorted((ROOT / "docs").rglob("*.md")) if page != GLOSSARY]


def terms() -> list[str]:
    return [heading.lower() for heading in re.findall(r"^### (.+)$", GLOSSARY.read_text(), flags=re.MULTILINE)]


def used(page: Path) -> list[str]:
    """The terms of a page, such as `mode` for {term}`modes <mode>`."""
    found = re.findall(r"\{term\}`([^`]+)`", page.read_text())
    return [re.sub(r"^.*<(.+)>$", r"\1", " ".join(each.split())).lower() for each in found]


def test_each_term_is_used_and_each_used_term_is_defined() -> None:
    assert {term for page in PAGES for term in used(page)} == set(terms())


def test_a_page_leads_to_a_term_once() -> None:
    for page in PAGES:
        assert [term for term, count in Counter(used(page)).items() if count > 1] == [], page
        assert "glossary.md#" not in page.read_text(), f"{page}: write {{term}}`...`"


def test_terms_are_unique() -> None:
    assert len(terms()) == len(set(terms())) > 50


def test_each_term_has_a_definition() -> None:
    for part in GLOSSARY.read_text().split("\n### ")[1:]:
        term, _, meaning = part.partition("\n")
        assert len(meaning.split("\n## ")[0].split()) >= 6, term
