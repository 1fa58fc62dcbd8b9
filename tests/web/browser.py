"""The page in a real browser: the system's Chromium, controlled by playwright, and a `hapticd web --demo` for it.

A test takes the fixture `page` (conftest.py): the page of a demo of this test file, open and ready. An error on its
console and an uncaught exception fail the test.

The page's Content-Security-Policy forbids eval: give `wait_for_function` a function, as the string "() => ...".
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import pytest
import yaml
from playwright.sync_api import Browser, BrowserContext, ConsoleMessage, Page, sync_playwright

from hapticd.web.demo import DEMO_CONFIG_PATH
from tests.support.daemon_process import PATIENCE_S

NAMES = ("chromium", "chromium-browser", "google-chrome")
FLAGS = (
    "--headless",
    "--disable-gpu",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
)
WIDE = {"width": 1280, "height": 800}
NARROW = {"width": 390, "height": 844}


def executable() -> str:
    """Return the browser's path. Without a browser skip the test, or fail if HAPTICD_BROWSER=required or CI is set."""
    found = next(filter(None, map(shutil.which, NAMES)), None)
    if found is None:
        missing = f"no browser: none of {', '.join(NAMES)} is on PATH (Debian: apt install chromium)"
        if os.environ.get("HAPTICD_BROWSER") == "required" or os.environ.get("CI"):
            pytest.fail(missing, pytrace=False)
        pytest.skip(missing)
    return found


def flags() -> list[str]:
    """Return the command-line flags of Chromium."""
    return [*FLAGS, *(("--no-sandbox",) if os.geteuid() == 0 else ())]


@contextmanager
def running_browser(*more: str) -> Iterator[Browser]:
    """Run Chromium while the context lasts."""
    path = executable()
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=[*flags(), *more])
        try:
            yield browser
        finally:
            browser.close()


class Demo:
    """`hapticd web --demo` in a separate process, and its open pages."""

    def __init__(self, folder: Path, *options: str, servo: Mapping[str, object] | None = None) -> None:
        """Start the process. `servo`: keys of the section `servo` that differ from the shipped configuration."""
        self._log = folder / "web.log"
        if servo is not None:
            changed = folder / "servo.yaml"
            changed.write_text(yaml.safe_dump({"servo": dict(servo)}))
            options = (*options, "-c", str(DEMO_CONFIG_PATH), "-c", str(changed))
        with open(self._log, "ab") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "hapticd", "web", "--demo", "--port", "0", *options],
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                start_new_session=True,
            )
        assert self.process.stdout is not None
        found = None
        while found is None:
            line = self.process.stdout.readline()
            assert line, f"hapticd web ended: {self.said()}"
            found = re.search(r"http://\S+/\?token=\S+", line)
        self.link = found[0]
        self.address = self.link.partition("?")[0]

    def said(self) -> str:
        return self._log.read_text()

    def stop(self) -> int:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
        code = self.process.wait(PATIENCE_S)
        assert self.process.stdout is not None
        self.process.stdout.close()
        return code


@contextmanager
def running_demo(folder: Path, *options: str, servo: Mapping[str, object] | None = None) -> Iterator[Demo]:
    """Run a Demo while the context lasts; it must end with exit code 0."""
    running = Demo(folder, *options, servo=servo)
    try:
        yield running
    finally:
        assert running.stop() == 0


class Pages:
    """Opens pages of a demo, and stores their errors."""

    def __init__(self, context: BrowserContext, demo: Demo) -> None:
        self.demo = demo
        self.context = context
        self.errors: list[str] = []
        context.set_default_timeout(1e3 * PATIENCE_S)
        # The token becomes the cookie of all pages of this context.
        assert context.request.get(demo.link).status == 200

    def open(self) -> Page:
        """Open a page, and return it once it is connected and all modules are mounted."""
        page = self.context.new_page()
        self.watch(page)
        page.goto(self.demo.address)
        ready(page)
        return page

    def watch(self, page: Page) -> None:
        def said(message: ConsoleMessage) -> None:
            if message.type == "error":
                self.errors.append(f"console: {message.text} ({message.location.get('url', '')})")

        page.on("pageerror", lambda error: self.errors.append(f"thrown: {error.stack or error.message}"))
        page.on("console", said)

    def close_all(self) -> None:
        for page in self.context.pages:
            page.close()

    def take_errors(self) -> list[str]:
        """Return the errors since the last call, and clear them."""
        errors, self.errors[:] = list(self.errors), []
        return errors


def ready(page: Page) -> None:
    page.wait_for_function("() => document.body.dataset.ready === 'true'")
