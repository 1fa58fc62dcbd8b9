"""Fixtures of what runs in a browser. See browser.py."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, Page

from tests.web.browser import WIDE, Demo, Pages, executable, running_browser, running_demo


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Before the fixtures, so that all tests that are skipped for want of a browser make one line."""
    if "browser" in getattr(item, "fixturenames", ()):
        executable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """One browser at a time, and nothing beside it: a page draws 60 times a second."""
    for item in items:
        if "browser" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.alone)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """One a file, not one a session: while playwright runs, no other test can start an event loop of its own."""
    with running_browser() as running:
        yield running


@pytest.fixture(scope="module")
def demo(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Demo]:
    """`hapticd web --demo`, one a file. It comes after the browser, so that nothing is started where there is none."""
    with running_demo(tmp_path_factory.mktemp("web")) as running:
        yield running


@pytest.fixture(scope="module")
def _context(browser: Browser, demo: Demo) -> Iterator[Pages]:
    context = browser.new_context(viewport=WIDE, reduced_motion="reduce")
    yield Pages(context, demo)
    context.close()


@pytest.fixture
def pages(_context: Pages) -> Iterator[Pages]:
    """Opens pages; those that are open are closed after the test, which fails on what went wrong in them."""
    yield _context
    _context.close_all()
    assert _context.take_errors() == []


@pytest.fixture
def page(pages: Pages) -> Page:
    """A page, 1280 wide, that is ready."""
    return pages.open()
