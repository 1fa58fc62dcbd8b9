"""The documentation as a site: built strictly, complete, with every page linked, and without network requests."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest
from markdown_it import MarkdownIt

from docs.site_hooks import for_python_markdown, inside
from tests.support.cli import page_names
from tests.web.browser import running_browser

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
MADE = ("reference/commands.md", "reference/python.md")
"""Pages that are generated from the code."""


class Page(HTMLParser):
    """The links of a page, the files that a browser fetches for it, and the elements of its article."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        self.fetched: list[str] = []
        self.tags: list[str] = []
        self._in_article = False
        self.feed(path.read_text())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        self._in_article = self._in_article or tag == "article"
        if tag == "link" and given.get("rel") not in ("canonical", "next", "prev"):
            self.fetched.append(given.get("href", ""))
        if "src" in given:
            self.fetched.append(given["src"])
        if self._in_article:
            self.tags.append(tag)
            if tag == "a":
                self.links.append(given.get("href", ""))

    def handle_endtag(self, tag: str) -> None:
        self._in_article = self._in_article and tag != "article"


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the site in a clean folder; a dead link, a page outside the navigation or a warning fails."""
    folder = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", folder],
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


@pytest.fixture(scope="module")
def pages(site: Path) -> dict[Path, Page]:
    return {path: Page(path) for path in site.rglob("*.html")}


@pytest.mark.slow
def test_every_page_is_linked(site: Path, pages: dict[Path, Page]) -> None:
    """The texts of pages, from the front page on, link every page; the navigation does not count."""
    found, ahead = set(), [site / "index.html"]
    while ahead:
        path = ahead.pop()
        if path in found or path not in pages:
            continue
        found.add(path)
        for link in pages[path].links:
            there = urlsplit(link)
            if not there.scheme and there.path:
                ahead.append((path.parent / unquote(there.path)).resolve())
    assert {str(path.relative_to(site)) for path in pages.keys() - found} == {"404.html"}


@pytest.mark.slow
def test_nothing_is_fetched_from_elsewhere(site: Path, pages: dict[Path, Page]) -> None:
    for path, page in pages.items():
        for target in page.fetched:
            there = urlsplit(target)
            assert there.scheme in ("", "data") and not there.netloc, f"{path.relative_to(site)}: {target}"
            if not there.scheme and path.name != "404.html":
                assert (path.parent / unquote(there.path)).exists(), f"{path.relative_to(site)}: {target}"
    for sheet in site.rglob("*.css"):
        assert not re.findall(r"(?:url\(|@import\s+)[\"']?(?:https?:)?//", sheet.read_text()), sheet


@pytest.mark.slow
def test_lists_blocks_and_tables_are_complete(site: Path, pages: dict[Path, Page]) -> None:
    """They are as CommonMark renders them, for which the pages are written."""
    reference = MarkdownIt("commonmark").enable("table")
    for source in sorted(DOCS.rglob("*.md")):
        name = source.relative_to(DOCS)
        if name.as_posix() in MADE:
            continue
        there = site / name.parent / ("index.html" if name.name == "README.md" else f"{name.stem}.html")
        tokens = [
            token.type for token in reference.parse(re.sub(r"\A---\n.*?\n---\n", "", source.read_text(), flags=re.S))
        ]
        expected = {
            "li": tokens.count("list_item_open"),
            "pre": tokens.count("fence") + tokens.count("code_block"),
            "table": tokens.count("table_open"),
        }
        assert {tag: pages[there].tags.count(tag) for tag in expected} == expected, name


@pytest.mark.slow
def test_the_site_has_all_commands_and_methods(site: Path) -> None:
    commands = (site / "reference" / "commands.html").read_text()
    assert all(f'id="{name}"' in commands for name in page_names())
    assert "Sentinel" not in commands
    python = (site / "reference" / "python.html").read_text()
    assert "that was rendered with the new scene" in python


@pytest.mark.slow
def test_it_opens_and_searches_without_a_network(site: Path) -> None:
    """The site is opened from files, in a browser that is offline."""
    with running_browser() as browser:
        page = browser.new_context(offline=True).new_page()
        asked: list[str] = []
        page.on("request", lambda request: asked.append(request.url))
        page.goto((site / "index.html").as_uri())
        page.keyboard.press("f")
        page.keyboard.type("proxy")
        page.wait_for_function("() => document.querySelectorAll('.md-search-result__item').length > 0")
        assert "Proxy" in page.inner_text(".md-search-result__list")
    assert all(url.startswith(("file:", "data:", "blob:")) for url in asked), asked


def test_links_out_of_the_pages_become_text() -> None:
    page = DOCS / "howto" / "x.md"
    assert inside("see [`a.h`](../../csrc/a.h) and [b](../b.md#c)", page) == "see `a.h` and [b](../b.md#c)"
    assert inside("[changes](../../CHANGELOG.md)", page) == "[changes](../changelog.md)"
    assert inside("[w](https://example.org/x)", page) == "[w](https://example.org/x)"


def test_lists_become_those_of_python_markdown() -> None:
    assert for_python_markdown("a:\n- b\n- d") == "a:\n\n- b\n- d"
    assert for_python_markdown("- b\n\n  c\n- d\n  - e") == "- b\n\n    c\n\n- d\n\n    - e"
    assert for_python_markdown("1. a\n\n       code") == "1. a\n\n        code"


def test_the_messages_of_troubleshooting_are_those_of_the_code() -> None:
    """The messages agree except for placeholders in capitals."""
    code = " ".join(path.read_text() for path in sorted((ROOT / "hapticd").rglob("*.py")))
    page = (DOCS / "howto" / "troubleshooting.md").read_text()
    messages = re.findall(r"^\| `([^`]+)`", page, flags=re.MULTILINE)
    assert len(messages) > 12
    for message in messages:
        for part in re.split(r"\b(?:[A-Z]{3,}|N)\b(?:'s)?[\s:;?)]*", message):
            assert part.strip() in code, f"{message}: {part!r} is in no message of hapticd"
