"""axe-core finds nothing serious in any tab of the page, light and dark, wide and narrow. The keyboard reaches all
controls."""

from __future__ import annotations

from typing import Any

import pytest
from playwright.sync_api import Page

from tests.web.browser import NARROW, WIDE
from tests.web.vendored import ROOT

pytestmark = pytest.mark.slow

AXE = (ROOT / "tests" / "web" / "vendor" / "axe-core" / "axe.min.js").read_text()
TABS = ("materials", "objects", "files", "sound", "recordings")
# The page's Content-Security-Policy forbids foreign scripts: the debugger evaluates axe, the page does not load it.
RUN = """async () => {
  const { violations } = await axe.run(document, { resultTypes: ["violations"] });
  return violations.filter(({ impact }) => impact === "serious" || impact === "critical").map(({ id, nodes }) => ({
    id, nodes: nodes.map((node) => `${node.target.join(" ")}: ${node.failureSummary.split("\\n")[1] ?? ""}`),
  }));
}"""
# Visible, enabled controls that Tab does not reach. Groups that are one stop of Tab are left out.
UNREACHED = """() => [...document.querySelectorAll("button, input, select, textarea, a[href], [role=slider]")]
  .filter((each) => each.checkVisibility() && !each.disabled && each.tabIndex < 0 && each.getAttribute("role") !== "tab"
    && !each.closest("[aria-hidden=true], [inert], [role=toolbar], [role=listbox], [role=radiogroup], [role=menu]"))
  .map((each) => each.outerHTML.slice(0, 120))"""


def serious(page: Page) -> list[dict[str, Any]]:
    if not page.evaluate("() => 'axe' in globalThis"):
        page.evaluate(AXE)
    found: list[dict[str, Any]] = page.evaluate(RUN)
    return found


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_nothing_serious(page: Page, scheme: Any) -> None:
    page.emulate_media(color_scheme=scheme)
    found: dict[str, Any] = {}
    for size in (WIDE, NARROW):
        page.set_viewport_size(size)
        for tab in TABS:
            page.evaluate("(panel) => hapticd.tabs.show(panel)", f"{tab}-panel")
            if problems := serious(page):
                found[f"{scheme}, {size['width']} wide, {tab}"] = problems
    assert found == {}


def test_axe_would_find_something(page: Page) -> None:
    """The test above fails if there is a serious finding."""
    page.evaluate("() => document.getElementById('files-panel').insertAdjacentHTML('beforeend', '<button></button>')")
    page.evaluate("() => hapticd.tabs.show('files-panel')")
    assert [problem["id"] for problem in serious(page)] == ["button-name"]


def test_every_control_is_reached_by_the_keyboard(page: Page) -> None:
    for tab in TABS:
        page.evaluate("(panel) => hapticd.tabs.show(panel)", f"{tab}-panel")
        assert page.evaluate(UNREACHED) == []


def test_faults_and_states_are_announced_to_screen_readers(page: Page) -> None:
    page.evaluate("() => hapticd.safety.dispatchEvent(new Event('change'))")
    assert page.locator("#forces-state").get_attribute("role") == "status"
    assert page.locator("#notices").get_attribute("aria-live") == "polite"
    assert page.locator("#stop").get_attribute("aria-keyshortcuts") == "Space Escape"
