"""Forces are on only while a running page holds the lease, and every page can stop them."""

from __future__ import annotations

import os
import signal

import pytest
from playwright.sync_api import Browser, Page

from tests.web.browser import WIDE, Pages, executable, flags, ready
from tests.web.hand import engage, last_force_ms, now_ms, press, wait_for_no_force

pytestmark = pytest.mark.slow

ON = "() => hapticd.safety.forces === 'on'"
OFF = "() => hapticd.safety.forces === 'off'"
LAPSED = "() => hapticd.safety.forces === 'faulted' && hapticd.safety.faults.includes('lease')"
RECORD_STOPS = """() => {
    const { link } = hapticd, call = link.call;
    globalThis.stopped = [];
    link.call = (method, params, options) => {
        const answer = call.call(link, method, params, options);
        if (method === "set_forces" && params.enabled === false) {
            answer.then(({ forces }) => globalThis.stopped.push(forces));
        }
        return answer;
    };
}"""
"""Script of the page: from now on, `stopped` lists the daemon's answers to its stops."""


@pytest.fixture
def held(page: Page) -> Page:
    """Return a page that controls the forces, regardless of the test before."""
    page.wait_for_function("() => hapticd.safety.holder === null && hapticd.safety.forces !== 'unknown'")
    assert page.evaluate("() => hapticd.safety.engage()")
    page.wait_for_function(ON)
    return page


def key_times(page: Page, key: str) -> float:
    """Press a key, and return performance.now() of the page when it got the key."""
    page.evaluate(
        "() => { globalThis.keyAt = null;"
        " addEventListener('keydown', () => (globalThis.keyAt = performance.now()), { capture: true, once: true }) }"
    )
    page.keyboard.press(key)
    return float(page.evaluate("() => globalThis.keyAt"))


def test_the_space_bar_takes_the_force_to_zero_within_50_ms(held: Page) -> None:
    """The shortest of five times counts, because the machine may delay one of them."""
    took = []
    now_ms(held)
    for _ in range(5):
        press(held)
        at = key_times(held, " ")
        wait_for_no_force(held)
        held.wait_for_function(OFF)
        took.append(last_force_ms(held) - at)
        if took[-1] < 50:
            break
        assert held.evaluate("() => hapticd.safety.engage()")
    assert 0 < min(took) < 50, took


@pytest.mark.parametrize("way", ["button", "Space on a button", "Escape in a field", "Enter on the stop button"])
def test_every_way_to_stop_stops(held: Page, way: str) -> None:
    """The page must stop the forces by a call that the daemon answers, not by the end of its lease."""
    held.evaluate(
        "() => document.getElementById('materials-panel').insertAdjacentHTML('beforeend', '<input id=\"typed\">')"
    )
    held.evaluate(RECORD_STOPS)
    if way == "button":
        held.locator("#stop").click()
    elif way == "Space on a button":
        held.locator("#objects-tab").focus()
        held.keyboard.press(" ")
    elif way == "Enter on the stop button":
        held.locator("#stop").focus()
        held.keyboard.press("Enter")
    else:
        held.locator("#typed").focus()
        held.keyboard.press("Escape")
    held.wait_for_function("() => stopped.length > 0 && !hapticd.safety.stopping")
    # `faulted`: the machine blocked the page for longer than its lease, and the forces faded before the stop.
    (forces,) = held.evaluate("() => stopped")
    assert forces in ("off", "faulted") and held.evaluate("() => hapticd.safety.forces") == forces
    assert held.evaluate("() => hapticd.safety.holder") is None
    assert held.locator("#forces-state").inner_text() == {"off": "Forces off", "faulted": "Forces off: fault"}[forces]


def test_a_space_that_is_typed_stops_nothing(held: Page) -> None:
    held.evaluate(
        "() => document.getElementById('materials-panel').insertAdjacentHTML('beforeend', '<input id=\"typed\">')"
    )
    held.locator("#typed").focus()
    held.keyboard.type("a b")
    assert held.locator("#typed").input_value() == "a b"
    assert held.evaluate("() => hapticd.safety.holds")


def test_after_a_stop_a_press_on_the_scene_does_not_turn_forces_on(held: Page) -> None:
    held.keyboard.press("Escape")
    held.wait_for_function(OFF)
    assert not engage(held)
    assert "Forces are off" in held.locator("#notices").inner_text()
    held.locator("#forces-on").click()
    held.wait_for_function(ON)
    assert held.evaluate("() => hapticd.safety.holder") == "this page"


SHOW_CONNECTION = """(connection) => {
  hapticd.model.status = { ...hapticd.model.status, connection };
  hapticd.safety.dispatchEvent(new Event("change"));
  return document.querySelector("#alerts").textContent;
}"""


def test_forces_that_are_held_back_say_what_the_person_is_to_do(held: Page) -> None:
    advice = "the device exerts no force because its safety switch is open: hold the handle lightly"
    assert held.evaluate(SHOW_CONNECTION, {"signs": {"state": "waiting", "advice": advice}}) == advice
    checking = held.evaluate(SHOW_CONNECTION, {"signs": {"state": "checking", "advice": None}})
    assert "let go of the handle" in checking
    assert held.evaluate(SHOW_CONNECTION, {"signs": {"state": "right", "advice": None}}) == ""


def test_the_warnings_of_the_connection_are_shown(held: Page) -> None:
    warning = "the handle rests at x 0.0 mm, y -2.4 mm, inside floor"
    assert held.evaluate(SHOW_CONNECTION, {"warnings": [warning]}) == warning
    assert held.evaluate(SHOW_CONNECTION, {"warnings": []}) == ""


def test_a_replay_that_pauses_is_not_said_to_be_over(page: Page) -> None:
    said = """async (state) => (await import("/static/status_words.js")).faultText(
      "device", { status: { device: "replay", connection: { state } } })"""
    assert page.evaluate(said, "connected") == "The recording of the joystick has a pause without reports."
    assert page.evaluate(said, "lost").startswith("The recording of the joystick is over.")


def test_a_tab_that_is_closed_lets_the_force_fade_within_the_lease(held: Page, pages: Pages) -> None:
    watching = pages.open()
    watching.wait_for_function("() => hapticd.safety.holder === 'another'")
    press(watching)
    before = now_ms(watching)
    held.close()
    watching.wait_for_function(LAPSED)
    wait_for_no_force(watching)
    assert 0 < last_force_ms(watching) - before < 1200
    assert "was closed, froze or lost its connection" in watching.locator("#alerts").inner_text()
    assert engage(watching), "the next page continues with a press on the scene"


def test_a_frozen_page_lets_the_force_fade_and_does_not_take_it_back(
    page: Page, pages: Pages, browser: Browser
) -> None:
    """In a separate browser whose renderers are stopped, because DevTools cannot freeze visible pages."""
    page.wait_for_function("() => hapticd.safety.holder === null")
    other = browser.browser_type.launch(executable_path=executable(), args=flags())
    try:
        context = other.new_context(viewport=WIDE, storage_state=page.context.storage_state())
        frozen = context.new_page()
        frozen.goto(pages.demo.address)
        ready(frozen)
        assert frozen.evaluate("() => hapticd.safety.engage()")
        press(page)
        processes = other.new_browser_cdp_session().send("SystemInfo.getProcessInfo")["processInfo"]
        renderers = [process["id"] for process in processes if process["type"] == "renderer"]
        before = now_ms(page)
        try:
            for renderer in renderers:
                os.kill(renderer, signal.SIGSTOP)
            page.wait_for_function(LAPSED)
            wait_for_no_force(page)
            assert last_force_ms(page) - before < 1200
        finally:
            for renderer in renderers:
                os.kill(renderer, signal.SIGCONT)
        frozen.wait_for_function("() => hapticd.safety.holder === null && hapticd.safety.forces === 'faulted'")
        assert frozen.evaluate("() => hapticd.link.call('get_status').then((status) => status.forces)") == "faulted"
    finally:
        other.close()


def test_a_page_whose_script_hangs_lets_the_force_fade(held: Page, pages: Pages) -> None:
    watching = pages.open()
    held.evaluate(
        "() => { setTimeout(() => { const end = performance.now() + 2500; while (performance.now() < end); }, 0) }"
    )
    watching.wait_for_function(LAPSED)
    held.wait_for_function("() => hapticd.safety.holder === null")


def test_one_page_holds_the_forces_and_the_other_watches_stops_and_takes_over(held: Page, pages: Pages) -> None:
    other = pages.open()
    other.wait_for_function("() => hapticd.safety.holder === 'another'")
    assert not engage(other)
    assert "Another page holds the forces" in other.locator("#notices").inner_text()
    assert held.evaluate("() => hapticd.safety.holds")
    other.locator("#stop").click()
    held.wait_for_function("() => hapticd.safety.forces === 'off' && hapticd.safety.holder === null")
    other.wait_for_function("() => hapticd.safety.holder === null")
    other.locator("#forces-on").click()
    other.wait_for_function("() => hapticd.safety.holds")
    held.wait_for_function("() => hapticd.safety.holder === 'another'")


def test_a_hidden_page_that_lives_keeps_the_forces(held: Page, pages: Pages) -> None:
    """Its timers run once a second or less often; those of its worker are not slowed down."""
    ticks = "() => hapticd.link.call('get_status').then((status) => [status.tick, status.forces, status.rate_hz])"
    session = held.context.new_cdp_session(held)
    session.send("Emulation.setFocusEmulationEnabled", {"enabled": False})
    other = pages.open()
    other.bring_to_front()
    begin, _, rate_hz = other.evaluate(ticks)
    while (now := other.evaluate(ticks))[0] < begin + 2.5 * rate_hz:
        assert now[1] == "on"
    assert held.evaluate("() => hapticd.safety.holds")


def test_without_an_answer_the_forces_fade_and_the_stop_is_reported_as_lost(held: Page, pages: Pages) -> None:
    press(held)
    pages.demo.process.send_signal(signal.SIGSTOP)  # the network fails; the daemon is another process
    try:
        held.keyboard.press("Escape")
        held.wait_for_function("() => hapticd.safety.problem.includes('did not reach the daemon')")
        assert held.evaluate("() => hapticd.safety.holder") is None
    finally:
        pages.demo.process.send_signal(signal.SIGCONT)
    held.wait_for_function("() => hapticd.link.connected && ['off', 'faulted'].includes(hapticd.safety.forces)")
    wait_for_no_force(held)


@pytest.mark.parametrize("kind", ["button", "checkbox", "number", "range", "select"])
def test_a_space_stops_and_does_not_use_what_has_the_focus(held: Page, kind: str) -> None:
    held.evaluate(
        """(kind) => {
          const panel = document.getElementById("materials-panel");
          const control = document.createElement(["button", "select"].includes(kind) ? kind : "input");
          if (control.localName === "input") {
            control.type = kind;
          } else if (kind === "select") {
            control.append(new Option("one"), new Option("two"));
          }
          globalThis.used = 0;
          for (const name of ["click", "change", "input"]) {
            control.addEventListener(name, () => used++);
          }
          panel.prepend(control);
          control.focus();
        }""",
        kind,
    )
    held.keyboard.press(" ")
    held.wait_for_function(OFF)
    assert held.evaluate("() => used") == 0
    if kind in ("button", "checkbox"):  # Enter activates them and does not stop the forces
        assert held.evaluate("() => hapticd.safety.engage()")
        held.keyboard.press("Enter")
        assert held.evaluate("() => used") > 0
        assert held.evaluate("() => hapticd.safety.holds")
    if kind == "checkbox":
        assert held.evaluate("() => document.activeElement.checked") is True


def test_escape_either_takes_something_back_or_stops(held: Page) -> None:
    """With an edited field, an open panel or a selection, the first press cancels these, and the next one stops."""
    field = held.locator('#materials-panel [data-path="stiffness_n_per_m"] .number-input').first
    was = field.input_value()
    scope, canvas = held.locator("#scope"), held.locator(".scene-canvas")

    def edit() -> None:
        field.fill("123")

    def open_traces() -> None:
        scope.get_by_role("button", name="Traces…").click()

    def select() -> None:
        held.evaluate("() => { hapticd.scene.setMode('arrange'); hapticd.scene.arrange.select('peg'); }")
        canvas.focus()

    def search() -> None:
        held.get_by_label("Search materials").fill("st")

    taken_back = {
        edit: lambda: field.input_value() == was,
        open_traces: lambda: scope.get_by_role("group", name="Traces and vertical scales").is_hidden(),
        select: lambda: held.evaluate("() => hapticd.scene.selected") is None,
        search: lambda: held.get_by_label("Search materials").input_value() == "",
    }
    for begin, ended in taken_back.items():
        begin()
        assert not ended()
        held.keyboard.press("Escape")
        assert ended(), begin.__name__
        assert held.evaluate("() => hapticd.safety.holds"), begin.__name__
        held.keyboard.press("Escape")
        held.wait_for_function(OFF)
        assert held.evaluate("() => hapticd.safety.engage()")
