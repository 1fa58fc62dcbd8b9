"""The complete page: it opens, its tabs move, and it fits wide and narrow windows."""

from __future__ import annotations

import pytest
from playwright.sync_api import Page, Route, WebSocketRoute

from tests.web.browser import NARROW, Pages, ready

pytestmark = pytest.mark.slow


def test_the_page_opens_and_samples_come(page: Page) -> None:
    page.wait_for_function("() => hapticd.samples.rows > 1000")
    assert page.evaluate("() => hapticd.model.scene.objects.floor.kind") == "wall"


def test_tabs_move_by_arrow_keys_and_are_remembered(page: Page) -> None:
    page.locator("#materials-tab").focus()
    for key, shown in (("ArrowRight", "objects"), ("ArrowLeft", "materials"), ("ArrowLeft", "recordings")):
        page.keyboard.press(key)
        assert page.evaluate("() => document.activeElement.id") == f"{shown}-tab"
        visible = page.locator('[role="tabpanel"]:not([hidden])')
        assert visible.count() == 1 and visible.get_attribute("id") == f"{shown}-panel"
    page.reload()
    page.wait_for_function("() => document.body.dataset.ready === 'true'")
    assert page.locator("#recordings-tab").get_attribute("aria-selected") == "true"


def test_nothing_is_wider_than_a_narrow_window(page: Page) -> None:
    page.set_viewport_size(NARROW)
    assert page.evaluate("() => document.documentElement.scrollWidth") <= NARROW["width"]


def parted(pages: Pages) -> tuple[Page, list[WebSocketRoute]]:
    """Return a page that is not open yet, and a list of its later connections, which a test can close."""
    page, sockets = pages.context.new_page(), []

    def connected(socket: WebSocketRoute) -> None:
        socket.connect_to_server()
        sockets.append(socket)

    page.route_web_socket("**/socket", connected)
    return page, sockets


def test_a_part_that_did_not_load_is_mounted_when_the_connection_is_back(pages: Pages) -> None:
    page, sockets = parted(pages)
    refused: list[str] = []

    def refuse(route: Route) -> None:
        refused.append(route.request.url)
        route.abort()

    page.route("**/static/materials_panel.js*", refuse)
    page.goto(pages.demo.address)
    ready(page)
    assert page.evaluate("() => hapticd.parts.failed") == ["materials-panel", "objects-panel"]
    assert "failed" in page.locator("#materials-panel").inner_text() and len(refused) == 1
    page.evaluate(
        "() => { globalThis.before = [hapticd.scope, hapticd.scene, document.querySelector('#scope canvas')]; }"
    )
    page.unroute("**/static/materials_panel.js*", refuse)
    sockets[-1].close()
    page.wait_for_function("() => hapticd.parts.failed.length === 0")
    page.locator("#materials-panel").get_by_text("Stiffness").first.wait_for()
    assert "failed" not in page.locator("#materials-panel").inner_text()
    page.get_by_role("tab", name="Objects").click()
    assert page.locator("#objects-panel .part-failed").count() == 0
    # Parts that were mounted before are unchanged and not duplicated.
    assert page.evaluate("() => [hapticd.scope, hapticd.scene].every((each, k) => each === globalThis.before[k])")
    assert page.locator("#scope .scope-stage").count() == page.locator(".scene-canvas").count() == 1


def test_a_part_whose_first_question_was_cut_off_is_mounted_when_the_connection_is_back(pages: Pages) -> None:
    page, sockets = pages.context.new_page(), []
    cut: list[bool] = []

    def connected(socket: WebSocketRoute) -> None:
        server = socket.connect_to_server()
        sockets.append(socket)

        def passed(message: str | bytes) -> None:
            if not cut and isinstance(message, bytes) and b"web.shipped_materials" in message:
                cut.append(True)
                socket.close()
            else:
                server.send(message)

        socket.on_message(passed)

    page.route_web_socket("**/socket", connected)
    pages.watch(page)
    page.goto(pages.demo.address)
    ready(page)
    page.wait_for_function("() => hapticd.parts.failed.length === 0 && hapticd.materials?.name")
    assert cut and len(sockets) == 2
    assert page.evaluate("() => hapticd.model.materials[hapticd.materials.name] !== undefined")
    assert all(
        "the connection to hapticd web was lost" in error or "needs the materials" in error
        for error in pages.take_errors()
    )
