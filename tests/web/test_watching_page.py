"""The page of a bridge's key that may only watch: telemetry is shown, and what it cannot do is said."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, Page

from tests.support.bridge_process import running_bridge
from tests.support.daemon_process import PATIENCE_S, Daemon, connect, running_daemon
from tests.web.browser import WIDE, ready
from tests.web.test_process import running
from tests.web.test_through_bridge import words

pytestmark = pytest.mark.slow

FLOOR = {"objects": {"floor": {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "wood"}}}


@pytest.fixture(scope="module")
def daemon(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    config = tmp_path_factory.mktemp("config") / "slow.yaml"
    config.write_text("servo: {rate_hz: 1000, realtime: off}\ndevice: {kind: sim}\nscene: {objects: {}}\n")
    with running_daemon("-c", str(config)) as daemon:
        yield daemon


@pytest.fixture(scope="module")
def watching(browser: Browser, daemon: Daemon, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    """The page; nothing may go wrong in it."""
    folder, errors = tmp_path_factory.mktemp("web"), list[str]()
    with (
        running_bridge(folder, daemon.directory, {"bob": "watch"}) as bridge,
        running(folder, before=words(bridge, folder, "bob")) as web,
    ):
        context = browser.new_context(viewport=WIDE, reduced_motion="reduce")  # type: ignore[arg-type]
        context.set_default_timeout(1e3 * PATIENCE_S)
        page = context.new_page()
        page.on("pageerror", lambda error: errors.append(error.stack or error.message))
        page.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
        page.goto(web.address)
        ready(page)
        yield page
        context.close()
    assert errors == []


def test_it_says_so_and_shows_the_force_of_a_hand_that_another_client_leads(daemon: Daemon, watching: Page) -> None:
    watching.wait_for_function("() => document.getElementById('alerts').textContent.includes('may only watch')")
    watching.wait_for_function("() => hapticd.samples.rows > 100")
    with connect(daemon.directory) as beside:
        beside.set_scene(FLOOR, wait=True)
        beside.set_operator(waypoints=[[0.3, 0.0, -0.01], [60.0, 0.0, -0.01]])
        watching.wait_for_function("() => hapticd.model.state.contact_force_n[1] > 0.5")
    assert watching.evaluate("() => hapticd.model.away") is False
    assert watching.evaluate("() => hapticd.parts.failed") == []
    # It does not know them: they are no telemetry.
    assert watching.evaluate("() => Object.keys(hapticd.model.scene.objects)") == []
    assert not watching.get_by_text("Limit", exact=False).first.is_visible()


def test_it_can_neither_turn_the_forces_on_nor_stop_them_and_says_that(daemon: Daemon, watching: Page) -> None:
    assert watching.locator("#stop").is_disabled() and not watching.locator("#forces-on").is_visible()
    watching.keyboard.press("Space")
    watching.get_by_text("it can neither turn the forces on nor stop them").wait_for()
    assert watching.evaluate("() => hapticd.safety.begin()") is False
    with connect(daemon.directory) as beside:
        assert beside.get_status()["forces"] == "on"


def test_panels_that_need_commands_say_that_it_only_watches(watching: Page) -> None:
    for name in ("materials", "objects", "files", "recordings"):
        watching.click(f"#{name}-tab")
        assert watching.inner_text(f"#{name}-panel") == "This page may only watch."
    watching.click("#sound-tab")
    assert watching.locator("#sound-panel button").count() > 0
