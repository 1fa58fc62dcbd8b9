"""Fixtures of tests that run in a browser (browser.py)."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, Page

from tests.web.browser import WIDE, Demo, Pages, executable, running_browser, running_demo


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip tests without a browser before their fixtures run, so that they are reported in one line."""
    if "browser" in getattr(item, "fixturenames", ()):
        executable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run browser tests one at a time and without other tests, because a page draws 60 times a second."""
    for item in items:
        if "browser" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.alone)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Start one browser per test file: while playwright runs, no other test can start an event loop."""
    with running_browser() as running:
        yield running


@pytest.fixture(scope="module")
def demo(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Demo]:
    """Run one `hapticd web --demo` per test file, after the browser, so that it does not start without a browser."""
    with running_demo(tmp_path_factory.mktemp("web")) as running:
        yield running


@pytest.fixture(scope="module")
def _context(browser: Browser, demo: Demo) -> Iterator[Pages]:
    context = browser.new_context(viewport=WIDE, reduced_motion="reduce")
    yield Pages(context, demo)
    context.close()


@pytest.fixture
def pages(_context: Pages) -> Iterator[Pages]:
    """Yield an opener of pages; after the test, close its pages and fail on their errors."""
    yield _context
    _context.close_all()
    assert _context.take_errors() == []


@pytest.fixture
def page(pages: Pages) -> Page:
    """Return an open page, 1280 pixels wide."""
    return pages.open()
