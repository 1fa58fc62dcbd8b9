"""The oscilloscope of `hapticd web --demo`: taps are caught and measured, files can be read, keys control all."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Page

from hapticd.config.materials import shipped_materials
from tests.web.browser import NARROW

pytestmark = pytest.mark.slow

TAPS = {name: material.tap for name, material in shipped_materials().items() if material.tap is not None}
MINUS = "\N{MINUS SIGN}"
TRIES = 20
COMPLETE = """() => {
  const { columns, capacity } = hapticd.samples, { row } = hapticd.scope.acquisition.shown;
  const times = Array.from({ length: 310 }, (_, k) => columns.time_s[(row - 10 + k) % capacity]);
  return times.slice(1).every((time, k) => time - times[k] < 1.5e-4);
}"""
"""Script: whether no period was missed from 1 ms before the contact to 30 ms after it, at 10 kHz."""
TAP = {"kind": "tap", "object": "floor", "at_m": 0.0, "speed_m_per_s": 0.2}


@pytest.fixture
def scope(page: Page) -> Iterator[Page]:
    """Return a page with forces on; a space in an earlier test may have stopped them."""
    page.wait_for_function("() => hapticd.samples.rows > 100 && hapticd.safety.holder === null")
    assert page.evaluate("() => hapticd.safety.engage()")
    yield page


def tap(page: Page, material: str = "wood") -> Any:
    """Return the page's measurement of a tap on this material.

    The tap is repeated if the servo missed a period or another contact came first: a released handle also falls onto
    the floor, almost without vibration.
    """
    caught = []
    for _ in range(TRIES):
        found = tap_once(page, material)
        complete, event = page.evaluate(COMPLETE), page.evaluate("() => hapticd.scope.acquisition.shown.event")
        if complete and event["scale"] > 0.5 and event["speed_m_per_s"] == pytest.approx(TAP["speed_m_per_s"], rel=0.2):
            return found
        caught.append((complete, event["scale"], event["speed_m_per_s"]))
    raise AssertionError(f"{TRIES} taps: no period missed, scale, m/s of each: {caught}")


def tap_once(page: Page, material: str) -> Any:
    page.evaluate("() => hapticd.scope.actions.catchTap()")
    page.evaluate(
        "([material, gesture]) => hapticd.link.call('update_scene', { objects: { floor: { material } }, wait: true })"
        ".then(() => hapticd.model.load()).then(() => hapticd.link.call('set_operator', { gesture }))",
        [material, TAP],
    )
    page.wait_for_function("() => hapticd.scope.tap !== null")
    return page.evaluate(
        "() => { const { material, frequencyError, decayError, frequencyHz, difference, sentence } = hapticd.scope.tap;"
        " return { material, frequencyError, decayError, frequencyHz, difference, sentence }; }"
    )


@pytest.mark.parametrize("material", sorted(TAPS))
def test_a_tap_is_caught_and_its_frequency_is_the_material_s(scope: Page, material: str) -> None:
    found = tap(scope, material)
    wanted = TAPS[material].frequency_hz
    assert found["material"] == material
    assert found["frequencyHz"] == pytest.approx(wanted, rel=0.02), found["sentence"]
    assert abs(found["frequencyError"]) < 0.02 and abs(found["decayError"]) < 0.02
    assert found["difference"] < 0.02  # the closed form lies on the samples
    shown = scope.evaluate(
        "() => { const { acquisition, view } = hapticd.scope, { event, row } = acquisition.shown;"
        " const { ticks, columns, capacity } = hapticd.samples;"
        " const at = row % capacity;"
        " return { event, tick: ticks[at], lag: columns.time_s[at] - view.zero }; }"
    )
    assert shown["event"]["event"] == "contact" and shown["tick"] == shown["event"]["tick"]
    assert shown["lag"] == pytest.approx(shown["event"]["before_tick_s"], abs=1e-9)


def test_the_picture_stands_until_it_is_run_again(scope: Page) -> None:
    tap(scope)
    scope.locator("#scope").get_by_role("button", name="Hold").click()
    left = scope.evaluate("() => hapticd.scope.view.left")
    rows = scope.evaluate("() => hapticd.samples.rows")
    scope.wait_for_function(f"() => hapticd.samples.rows > {rows + 2000}")
    assert scope.evaluate("() => hapticd.scope.view.left") == left
    scope.locator("#scope").get_by_role("button", name="Run", exact=True).click()
    assert scope.evaluate("() => hapticd.scope.view.held") is False


def test_keys_hold_pan_and_zoom(scope: Page) -> None:
    stage = scope.locator(".scope-stage")
    stage.focus()
    width = scope.evaluate("() => hapticd.scope.view.widthS")
    stage.press("+")
    narrower = scope.evaluate("() => hapticd.scope.view.widthS")
    assert narrower < width
    stage.press("h")
    left = scope.evaluate("() => hapticd.scope.view.left")
    stage.press("ArrowLeft")
    assert scope.evaluate("() => hapticd.scope.view.left") == pytest.approx(left - 0.05 * narrower)
    stage.press("Home")
    assert scope.evaluate("() => hapticd.scope.view.held") is False


def test_the_wheel_zooms_around_the_pointer_and_a_drag_pans(scope: Page) -> None:
    scope.wait_for_function("() => hapticd.samples.rows > 3000")
    scope.evaluate("() => hapticd.scope.actions.setWidth(0.1)")
    scope.locator("#scope").get_by_role("button", name="Hold").click()
    box = scope.evaluate(
        "() => { const { left, width } = hapticd.scope.plot.cssBox, stage = document.querySelector('.scope-stage')"
        ".getBoundingClientRect(); return { left: stage.left + left, width, y: stage.top + 40 }; }"
    )
    at = "(share) => hapticd.scope.view.left + share * hapticd.scope.view.widthS"
    before = scope.evaluate(at, 0.75)
    scope.mouse.move(box["left"] + 0.75 * box["width"], box["y"])
    scope.mouse.wheel(0, -300)
    scope.wait_for_function("() => hapticd.scope.view.widthS < 0.08")
    assert scope.evaluate(at, 0.75) == pytest.approx(before, abs=0.0002)
    left, width = scope.evaluate("() => [hapticd.scope.view.left, hapticd.scope.view.widthS]")
    scope.mouse.down()
    scope.mouse.move(box["left"] + 0.85 * box["width"], box["y"])
    scope.mouse.up()
    assert scope.evaluate("() => hapticd.scope.view.left") == pytest.approx(left - 0.1 * width, abs=0.01 * width)


def test_cursors_read_time_value_and_frequency(scope: Page) -> None:
    tap(scope)
    scope.locator("#scope").get_by_role("button", name="Hold").click()
    scope.locator("#scope").get_by_role("button", name="Cursors").click()
    first, second = (scope.get_by_role("slider", name=f"Cursor {name}") for name in "AB")
    place = "([a, b]) => { const { cursors } = hapticd.scope; cursors.times = [a, b]; }"
    scope.evaluate(place, [0.01, 0.02])
    first.press("Shift+ArrowRight")
    first.press("ArrowLeft")
    assert float(first.get_attribute("aria-valuenow") or "nan") > 10
    times = scope.evaluate("() => hapticd.scope.cursors.times")
    assert times[1] == 0.02 and 0.01 < times[0] < 0.02
    value = scope.evaluate(
        "() => { const { source, cursors, view } = hapticd.scope;"
        " const row = source.rowAt(cursors.times[1] + view.zero - 5e-5);"
        " return source.track('contact_y').column[row % source.capacity]; }"
    )
    table = scope.locator(".scope-legend")
    frequency = 1 / (times[1] - times[0])
    scope.wait_for_function(
        "(wanted) => { const rows = document.querySelectorAll('.scope-legend tbody tr');"
        " const said = parseFloat(rows[2]?.innerText.split('\\t')[2]);"
        " return Math.abs(said / wanted - 1) < 1e-3; }",
        arg=frequency,
    )
    rows = [row.split("\t") for row in table.locator("tbody").inner_text().split("\n")]
    assert [row[0] for row in rows] == ["A", "B", f"B {MINUS} A"]
    assert float(rows[2][2].split()[0]) == pytest.approx(frequency, rel=1e-3)
    assert float(rows[1][4].split()[0].replace(MINUS, "-")) == pytest.approx(value, rel=1e-3)
    box = second.bounding_box()
    assert box is not None
    scope.mouse.move(box["x"] + box["width"] / 2, box["y"] + 20)
    scope.mouse.down()
    scope.mouse.move(box["x"] + box["width"] / 2 + 60, box["y"] + 20)
    scope.mouse.up()
    assert scope.evaluate("() => hapticd.scope.cursors.times[1]") > 0.02
    assert scope.evaluate("() => hapticd.scope.cursors.times[0]") == times[0]


def test_a_level_of_a_channel_triggers(scope: Page) -> None:
    scope.select_option("#scope-source", "level")
    scope.select_option("#scope-channel", "contact_y")
    scope.fill("#scope-level-value", "0.5")
    scope.locator("#scope-level-value").press("Tab")
    scope.select_option("#scope-mode", "single")
    scope.evaluate("(gesture) => hapticd.link.call('set_operator', { gesture })", TAP)
    scope.wait_for_function("() => hapticd.scope.acquisition.state === 'held'")
    values = scope.evaluate(
        "() => { const { source, acquisition } = hapticd.scope, { row } = acquisition.shown;"
        " const { column } = source.track('contact_y');"
        " return [column[(row - 1) % source.capacity], column[row % source.capacity]]; }"
    )
    assert values[0] < 0.5 <= values[1]


def test_traces_are_chosen_and_a_scale_is_set_by_keyboard(scope: Page) -> None:
    button = scope.locator("#scope").get_by_role("button", name="Traces…")
    button.focus()
    button.press("Enter")
    panel = scope.get_by_role("group", name="Traces and vertical scales")
    assert scope.evaluate("() => document.activeElement.dataset.trace") == "position_x"
    panel.get_by_role("checkbox", name="Velocity, magnitude").press("Enter")
    assert "velocity_magnitude" in scope.evaluate("() => hapticd.scope.channels")
    panel.get_by_role("checkbox", name="Force: automatic scale").press("Enter")
    panel.get_by_role("spinbutton", name="Force from, N").fill("-3")
    panel.get_by_role("spinbutton", name="Force to, N").fill("-4")
    panel.get_by_role("spinbutton", name="Force to, N").press("Tab")
    assert "must be less" in panel.inner_text()
    panel.get_by_role("spinbutton", name="Force to, N").fill("7")
    panel.get_by_role("spinbutton", name="Force to, N").press("Tab")
    low_high = scope.evaluate("() => { const { low, high } = hapticd.scope.plot.scales.force; return [low, high]; }")
    assert low_high == [-3, 7]
    panel.press("Escape")
    assert panel.is_hidden() and scope.evaluate("() => document.activeElement.textContent") == "Traces…"


def test_what_is_shown_is_saved_as_csv_and_png(scope: Page, tmp_path: Path) -> None:
    tap(scope)
    scope.locator("#scope").get_by_role("button", name="Hold").click()
    with scope.expect_download() as downloading:
        scope.get_by_role("button", name="Save the samples as CSV").click()
    file = tmp_path / downloading.value.suggested_filename
    downloading.value.save_as(file)
    with open(file) as lines:
        header = next(csv.reader(lines))
    assert header == ["tick", "time_s", "position_y_m", "contact_force_y_n", "vibration_force_y_n"]
    table = np.genfromtxt(file, delimiter=",", names=True)
    kept = scope.evaluate(
        "() => { const { source, view } = hapticd.scope, { columns, ticks, capacity } = hapticd.samples;"
        " const rows = []; for (let row = source.rowAt(view.left); row < source.rowAt(view.right); row++) {"
        " const at = row % capacity; rows.push([ticks[at], columns.time_s[at] - view.zero, columns.y_m[at],"
        " columns.contact_y_n[at], columns.vibration_y_n[at]]); } return rows; }"
    )
    assert len(kept) > 800
    assert np.array_equal(np.array(table.tolist()), np.array(kept))
    with scope.expect_download() as downloading:
        scope.get_by_role("button", name="Save the picture as PNG").click()
    picture = tmp_path / downloading.value.suggested_filename
    downloading.value.save_as(picture)
    seen = scope.evaluate(
        "async (bytes) => {"
        " const map = await createImageBitmap(new Blob([Uint8Array.from(bytes)], { type: 'image/png' }));"
        " const ctx = new OffscreenCanvas(map.width, map.height).getContext('2d'); ctx.drawImage(map, 0, 0);"
        " const { data } = ctx.getImageData(0, 0, map.width, map.height), colors = new Set();"
        " for (let k = 0; k < data.length; k += 4) colors.add((data[k] << 16) | (data[k + 1] << 8) | data[k + 2]);"
        " return { width: map.width, height: map.height, colors: [...colors] }; }",
        list(picture.read_bytes()),
    )
    assert seen["width"] > 600 and seen["height"] > 150
    for name in ("contact-y", "vibration-y", "position-y"):  # traces and legend
        value = scope.evaluate(
            "(name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim()", name
        )
        assert int(value[1:], 16) in seen["colors"]


def test_the_spectrum_of_a_tap_and_the_lateness_are_said(scope: Page) -> None:
    tap(scope, "steel")  # this shows the traces
    scope.locator("#scope").get_by_role("button", name="Spectrum").click()
    scope.wait_for_function("() => hapticd.scope.spectrum.result !== null")
    assert "resolution" in scope.locator(".scope-message").inner_text()
    assert scope.evaluate("() => hapticd.scope.spectrum.result.peakHz") == pytest.approx(1682, rel=0.1)
    scope.locator("#scope").get_by_role("button", name="Lateness").click()
    scope.wait_for_function("() => document.querySelector('.scope-message').textContent.includes('p99')")
    assert "since the daemon started" in scope.locator(".scope-message").inner_text()


ROWS = """() => {
  const controls = [...document.querySelectorAll("#scope .scope-bar button, #scope .scope-bar select")];
  const seen = controls.filter((each) => each.checkVisibility() && !each.closest(".scope-more.open"));
  const middles = seen.map((each) => each.getBoundingClientRect()).map(({ top, bottom }) => (top + bottom) / 2);
  const rows = [];
  for (const middle of middles.sort((a, b) => a - b)) {
    if (rows.length === 0 || middle - rows.at(-1) > 8) rows.push(middle);
  }
  return rows.length;
}"""


def test_the_toolbar_takes_two_rows_at_most_and_more_opens_the_rest_by_keyboard(scope: Page) -> None:
    bar, more = scope.locator("#scope .scope-bar"), scope.get_by_role("group", name="Trigger, cursors and files")
    button = bar.get_by_role("button", name="More controls of the oscilloscope")
    assert scope.evaluate(ROWS) <= 2 and button.is_hidden() and more.get_by_label("Trigger", exact=True).is_visible()
    scope.set_viewport_size(NARROW)
    button.wait_for()
    assert scope.evaluate(ROWS) <= 2
    assert button.get_attribute("aria-expanded") == "false" and more.is_hidden()
    button.focus()
    button.press("Enter")
    assert button.get_attribute("aria-expanded") == "true"
    assert scope.evaluate("() => document.activeElement.id") == "scope-source"
    names = ["scope-source", "Save the picture as PNG", "Save the samples as CSV", "Enlarge"]
    reached = []
    while len(reached) < 8 and names[-1] not in reached:
        if reached:
            scope.keyboard.press("Tab")
        reached.append(
            scope.evaluate("() => { const e = document.activeElement; return e.id || (e.ariaLabel ?? e.textContent); }")
        )
    assert [each for each in reached if each in names] == names
    more.get_by_label("Trigger", exact=True).select_option("level")
    assert more.get_by_label("Hysteresis").is_visible()
    box = more.bounding_box()
    assert box is not None and box["x"] >= 0 and box["x"] + box["width"] <= NARROW["width"]
    button.click()
    assert more.is_hidden()
    button.click()
    scope.locator("#scope").get_by_role("button", name="Hold").click()
    assert more.is_hidden()  # the box closes when another control is used
    button.click()
    more.get_by_label("Trigger", exact=True).press("Escape")
    assert more.is_hidden() and button.get_attribute("aria-expanded") == "false"
    assert scope.evaluate("() => document.activeElement.ariaLabel") == "More controls of the oscilloscope"


def test_nothing_leaves_a_narrow_window(scope: Page) -> None:
    scope.set_viewport_size(NARROW)
    scope.get_by_role("button", name="More controls of the oscilloscope").click()
    scope.locator("#scope").get_by_role("button", name="Cursors").click()
    scope.locator("#scope").get_by_role("button", name="Traces…").click()
    wide = scope.evaluate(
        "() => [...document.querySelectorAll('#scope button, #scope select, #scope input')]"
        ".filter((each) => each.offsetParent !== null).map((each) => each.getBoundingClientRect())"
        ".filter(({ left, right }) => left < 0 || right > innerWidth).length"
    )
    assert wide == 0
    assert scope.evaluate("() => document.documentElement.scrollWidth") <= NARROW["width"]
