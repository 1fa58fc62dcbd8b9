"""The documentation as a site: built without warnings, complete, every page linked, and no network requests."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

import hapticd
import hapticd.aio
from tests.support.cli import page_names
from tests.web.browser import running_browser

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PYTHON = (DOCS / "reference" / "python.md").read_text()


class Page(HTMLParser):
    """The links of a page's article, the files that a browser fetches for the page, and its anchors."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        self.fetched: list[str] = []
        self.anchors: set[str] = set()
        self._in_article = False
        self.feed(path.read_text())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        self._in_article = self._in_article or tag == "article"
        if tag == "link" and given.get("rel") not in ("next", "prev", "search"):
            self.fetched.append(given.get("href", ""))
        if "src" in given:
            self.fetched.append(given["src"])
        if "id" in given:
            self.anchors.add(given["id"])
        if self._in_article and tag == "a":
            self.links.append(given.get("href", ""))

    def handle_endtag(self, tag: str) -> None:
        self._in_article = self._in_article and tag != "article"


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the site in a clean folder; a dead link, a page outside the navigation or a warning fails."""
    folder = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-d", folder / "doctrees", DOCS, folder / "site"],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return folder / "site"


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
    assert {str(path.relative_to(site)) for path in pages.keys() - found} == {"search.html"}


@pytest.mark.slow
def test_no_link_is_dead(site: Path, pages: dict[Path, Page]) -> None:
    """Links to places within a page count as well, such as anchors that a page writes as HTML."""
    for path, page in pages.items():
        for link in page.links:
            there = urlsplit(link)
            if there.scheme:
                continue
            target = (path.parent / unquote(there.path)).resolve() if there.path else path
            assert target.exists(), f"{path.relative_to(site)}: {link}"
            assert not there.fragment or unquote(there.fragment) in pages[target].anchors, (
                f"{path.relative_to(site)}: {link}"
            )


@pytest.mark.slow
def test_nothing_is_fetched_from_elsewhere(site: Path, pages: dict[Path, Page]) -> None:
    for path, page in pages.items():
        for target in page.fetched:
            there = urlsplit(target)
            assert there.scheme in ("", "data") and not there.netloc, f"{path.relative_to(site)}: {target}"
            assert there.scheme or (path.parent / unquote(there.path)).exists(), f"{path.relative_to(site)}: {target}"
    for sheet in site.rglob("*.css"):
        assert not re.findall(r"(?:url\(|@import\s+)[\"']?(?:https?:)?//", sheet.read_text()), sheet


@pytest.mark.slow
def test_the_site_has_all_commands_and_methods(site: Path, pages: dict[Path, Page]) -> None:
    commands = (site / "reference" / "commands.html").read_text()
    assert all(f'id="{name}"' in commands for name in page_names())
    assert "Sentinel" not in commands
    anchors = pages[site / "reference" / "python.html"].anchors
    for name, described in (("hapticd", hapticd.Client), ("hapticd.aio", hapticd.aio.Client)):
        for method, _ in inspect.getmembers(described, callable):
            assert method.startswith("_") or f"{name}.Client.{method}" in anchors, f"{name}.Client.{method}"
    shown = [name for name in dir(hapticd.Recording) if not name.startswith("_")]
    assert {f"hapticd.Recording.{name}" for name in (*shown, "samples", "events")} <= anchors


@pytest.mark.slow
def test_it_opens_and_searches_without_a_network(site: Path) -> None:
    """The site is opened from files, in a browser that is offline."""
    with running_browser() as browser:
        page = browser.new_context(offline=True).new_page()
        asked: list[str] = []
        page.on("request", lambda request: asked.append(request.url))
        page.goto((site / "index.html").as_uri())
        page.fill("input.sidebar-search", "proxy")
        page.keyboard.press("Enter")
        page.wait_for_function("() => document.querySelectorAll('#search-results li').length > 0")
        assert "Proxy" in page.inner_text("#search-results")
    assert all(url.startswith(("file:", "data:", "blob:")) for url in asked), asked


def test_the_python_page_has_every_public_name() -> None:
    described = set(re.findall(r"^\.\. \w+:: hapticd\.([\w.]+)", PYTHON, flags=re.MULTILINE))
    assert described >= set(hapticd.__all__) - {"__version__", "aio"}
    assert described >= {f"aio.{name}" for name in hapticd.aio.__all__}


def test_the_messages_of_troubleshooting_are_those_of_the_code() -> None:
    """The messages agree except for placeholders in capitals."""
    code = " ".join(path.read_text() for path in sorted((ROOT / "hapticd").rglob("*.py")))
    page = (DOCS / "howto" / "troubleshooting.md").read_text()
    messages = re.findall(r"^\| `([^`]+)`", page, flags=re.MULTILINE)
    assert len(messages) > 12
    symptoms = page[page.index("## By symptom") : page.index("## By message")]
    printed = re.findall(r"^\| (?!ssh\b)[^`|]+\| ([^|]+)\|", symptoms, flags=re.MULTILINE)
    quoted = [each for cell in printed for each in re.findall(r"`([^`]+)`", cell)]
    assert len(quoted) > 30
    messages += quoted
    for message in messages:
        for part in re.split(r"\b(?:[A-Z]{3,}|N)\b(?:'s)?[\s:;?)]*", message):
            assert part.strip() in code, f"{message}: {part!r} is in no message of hapticd"
