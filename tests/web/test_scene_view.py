"""The scene as it is drawn in the page of `hapticd web --demo`: to scale, with forces, marks and membranes."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import Any

import pytest
from playwright.sync_api import Page

from hapticd.config.materials import shipped_materials
from tests.web.browser import NARROW, WIDE, Pages
from tests.web.drawing import live, on_page, pixels, scene_page, show, texts, to_px

pytestmark = pytest.mark.slow

RIM_PX = 9  # arrows begin at the rim of the handle; the circle of the limit is larger by this distance
BESIDE_PX = 10  # distance of arrows with the same direction
SATURATED = 8  # flag of a sample, docs/reference/events.md
MINUS = "\N{MINUS SIGN}"


@pytest.fixture(scope="module")
def page(_context: Pages) -> Iterator[Page]:
    """Open one page for all tests, without a lease: the simulated joystick's forces are on from the start."""
    with scene_page(_context) as opened:
        yield opened


@pytest.fixture
def scene(page: Page) -> Iterator[Page]:
    """Return the page with all objects visible, the hand in the air and all membranes intact."""
    live(page)
    page.evaluate("() => { hapticd.scene.fit('objects'); hapticd.scene.hand.forget(); }")
    page.evaluate("() => hapticd.link.call('reset', { objects: ['skin'] })")
    page.evaluate("() => hapticd.link.call('set_operator', { waypoints: [[0.1, 0, 0.02]] })")
    page.wait_for_function(
        "() => hapticd.model.state.touching.length === 0 && hapticd.model.state.position_m[1] > 0.015"
    )
    page.wait_for_function("() => hapticd.scene.contacts.punctures.ids.length === 0")
    yield page
    page.set_viewport_size(WIDE)
    page.emulate_media(color_scheme="light")


def fit(page: Page, rect: list[float]) -> None:
    """Show [left, bottom, right, top] of the plane, in m, completely."""
    page.evaluate("(rect) => { hapticd.scene.transform.fit(rect); hapticd.scene.viewed(); }", rect)


def newtons_px(page: Page) -> float:
    """Return the pixels per newton of the scale bar at the lower right."""
    height, width = page.evaluate(
        "() => { const { clientHeight: h, clientWidth: w } = hapticd.scene.canvas; return [h, w]; }"
    )
    text, x, y = next(each for each in texts(page) if re.fullmatch(r"[\d.]+ N", each[0]))
    bar = pixels(page, "force", [x - 60, y + 3, min(width, x + 60), min(height, y + 12)])
    return (bar["right"] - bar["left"] - 1) / float(text.removesuffix(" N"))


def test_every_object_is_drawn_at_its_place_to_scale_and_named(scene: Page) -> None:
    objects = scene.evaluate("() => hapticd.model.scene.objects")
    words = [text for text, _, _ in texts(scene)]
    for id in objects:
        assert f"{id} · {objects[id]['material']}" in words
    assert {"comb", "sandpaper"} < set(words) and {"x, mm", "y, mm"} < set(words)

    x, y = to_px(scene, [0.01, 0])
    ground = pixels(scene, "text", [x - 4, y - 10, x + 4, y + 10])
    assert (ground["top"] + ground["bottom"] + 1) / 2 == pytest.approx(y, abs=1.5)

    (width_m, height_m), centre = objects["block"]["size_m"], objects["block"]["center_m"]
    x, y = to_px(scene, centre)
    across = pixels(scene, "text", [x - 80, y - 3, x + 80, y + 3])
    scale = (across["right"] - across["left"]) / width_m
    assert (across["left"] + across["right"]) / 2 == pytest.approx(x, abs=1.5)
    half = scale * height_m / 2 + 5  # without the object's name
    up = pixels(scene, "text", [x - 3, y - half, x + 3, y + half])
    assert up["bottom"] - up["top"] == pytest.approx(height_m * scale, abs=4)

    radius = objects["peg"]["radius_m"]
    x, y = to_px(scene, objects["peg"]["center_m"])
    disc = pixels(scene, "text", [x - 1.3 * radius * scale, y - 3, x + 1.3 * radius * scale, y + 3])
    assert disc["right"] - disc["left"] == pytest.approx(2 * radius * scale, abs=4)


def test_the_bar_and_the_ticks_say_the_length_that_they_have(scene: Page) -> None:
    for _ in range(3):
        written = texts(scene)
        text, x, y = next(each for each in written if re.fullmatch(r"[\d.]+ (mm|µm)", each[0]))
        length_m = float(text.split()[0]) * {"mm": 1e-3, "µm": 1e-6}[text.split()[1]]
        bar = pixels(scene, "text", [x - 60, y + 3, x + 60, y + 12])
        scale = (bar["right"] - bar["left"] - 1) / length_m
        # The distances of the numbers along the lower edge, in mm, agree with the bar.
        height = scene.evaluate("() => hapticd.scene.canvas.clientHeight")
        ticks = sorted(
            (float(text.replace(MINUS, "-")), x)
            for text, x, y in written
            if y > height - 20 and re.fullmatch(rf"{MINUS}?[\d.]+", text)
        )
        (first, left), (last, right) = ticks[0], ticks[-1]
        assert (right - left) / ((last - first) * 1e-3) == pytest.approx(scale, rel=0.04)
        scene.get_by_role("button", name="Zoom in", exact=True).click()
        scene.get_by_role("button", name="Zoom in", exact=True).click()
        scene.get_by_role("button", name="Zoom in", exact=True).click()


def test_wheel_drag_keys_and_buttons_zoom_and_pan(scene: Page) -> None:
    def view() -> Any:
        return scene.evaluate(
            "() => { const { pxPerM, centre } = hapticd.scene.transform; return [pxPerM, ...centre]; }"
        )

    before = view()
    x, y = map(round, on_page(scene, [0.052, 0.01]))  # a wheel's event has integer pixels
    block = scene.evaluate(
        "(at) => { const { left, top } = hapticd.scene.canvas.getBoundingClientRect();"
        " return hapticd.scene.transform.toM([at[0] - left, at[1] - top]); }",
        [x, y],
    )
    at = (x, y)
    scene.mouse.move(*at)
    scene.mouse.wheel(0, -400)
    scene.wait_for_function("(before) => hapticd.scene.transform.pxPerM > 1.5 * before", arg=before[0])
    assert on_page(scene, block) == pytest.approx(at, abs=0.01)  # what is under the pointer stays there

    scene.keyboard.down("Shift")
    scene.mouse.down()
    scene.mouse.move(at[0] - 70, at[1] + 30, steps=4)
    scene.mouse.up()
    scene.keyboard.up("Shift")
    assert on_page(scene, block) == pytest.approx((at[0] - 70, at[1] + 30), abs=0.01)
    assert scene.evaluate("() => hapticd.scene.hand.target") is None  # the view moved, not the hand

    scale, x, y = view()
    scene.keyboard.press("Control+ArrowRight")
    assert view()[1] > x and view()[2] == y
    scene.keyboard.press("-")
    assert view()[0] == pytest.approx(0.8 * scale)
    scene.keyboard.press("0")
    assert view() == pytest.approx(before, rel=0.02, abs=0.002)
    scene.get_by_role("button", name="Show the complete workspace").click()
    size = scene.evaluate("() => [hapticd.scene.canvas.clientWidth, hapticd.scene.canvas.clientHeight]")
    for corner in ([-0.075, -0.075], [0.075, 0.075]):  # the travel of the simulated joystick
        assert all(0 < place < most for place, most in zip(to_px(scene, corner), size, strict=True))


def test_arrows_of_contact_vibration_and_sum_are_as_long_as_the_bar_says(scene: Page) -> None:
    handle = [0.0, 0.028]
    forces = {"contact": (5.0, 0.0), "vibration": (0.0, 4.0), "force": (-4.5, 0.0)}
    show(
        scene,
        {
            "position_m": handle,
            "contact_force_n": forces["contact"],
            "vibration_force_n": forces["vibration"],
            "force_n": forces["force"],
        },
        [],
    )
    scale = newtons_px(scene)
    x, y = to_px(scene, handle)
    band = BESIDE_PX + 4
    right = pixels(scene, "contact", [x + RIM_PX, y - band, x + 200, y + band])
    assert right["right"] - x - RIM_PX == pytest.approx(5.0 * scale, abs=4)
    up = pixels(scene, "vibration", [x - band, y - 200, x + band, y - RIM_PX])
    assert y - RIM_PX - up["top"] == pytest.approx(4.0 * scale, abs=4)
    left = pixels(scene, "force", [x - 200, y - 3, x - RIM_PX, y + 3])
    assert x - RIM_PX - left["left"] == pytest.approx(4.5 * scale, abs=4)


def test_the_limit_is_a_circle_that_turns_red_and_solid_when_the_force_is_limited(scene: Page) -> None:
    # In the middle the circle's upper half is completely visible.
    handle = scene.evaluate(
        "() => { const { transform: t } = hapticd.scene; return t.toM([t.width / 2, t.height / 2]); }"
    )
    limit = scene.evaluate("() => hapticd.model.config.device.max_force_n")
    assert f"Limit {limit:g} N" in scene.locator(".scene-legend").inner_text()

    def on_circle(colour: str) -> float:
        """Return the fraction of 40 points on the circle's upper half that have the colour."""
        x, y = to_px(scene, handle)
        radius = limit * newtons_px(scene) + RIM_PX
        around = [math.pi * (k + 0.5) / 40 for k in range(40)]
        places = [(x + radius * math.cos(angle), y - radius * math.sin(angle)) for angle in around]
        within = 90 if colour == "muted" else 40  # this line is one pixel wide and dashed
        found = [pixels(scene, colour, [a - 2, b - 2, a + 2, b + 2], within)["count"] for a, b in places]
        return sum(count > 0 for count in found) / 40

    show(scene, {"position_m": handle}, [])
    assert on_circle("bad") == 0 and on_circle("muted") < 0.2
    show(scene, {"position_m": handle, "force_n": [0.0, 1.0]}, [])
    assert on_circle("bad") == 0 and on_circle("muted") > 0.3
    show(scene, {"position_m": handle, "force_n": [0.0, limit], "flags": SATURATED}, [])
    assert on_circle("bad") > 0.9


ABOVE = """() => {
  const [x, y] = hapticd.scene.moments.newest.position;
  return y > 0.049 && Math.abs(x - 0.003) < 1e-3;
}"""
WATCH_MARKS = """() => {
  const { contacts, picture, transform } = hapticd.scene;
  const { marks } = contacts;
  const add = Object.getPrototypeOf(marks).add.bind(marks);
  globalThis.marked = [];
  marks.add = (kind, point, at) => {
    const before = marks.seen(at).length;
    add(kind, point, at);
    picture.drawAtOnce();
    marked.push({ kind, point, drawn: marks.seen(at).length - before, px: transform.toPx(point) });
  };
}"""


def test_contacts_and_grooves_are_marked_where_they_happen(scene: Page) -> None:
    scene.evaluate(WATCH_MARKS)
    stroke = [[0.6, -0.036, 0.01], [1.0, -0.036, -0.002], [2.4, -0.016, -0.002], [2.6, -0.016, 0.02]]
    scene.evaluate("(waypoints) => hapticd.link.call('set_operator', { waypoints })", stroke)
    scene.wait_for_function("() => marked.filter(({ kind }) => kind === 'groove').length >= 6")
    marks = scene.evaluate("() => marked")
    contact = next(mark for mark in marks if mark["kind"] == "contact")
    assert contact["point"] == pytest.approx([-0.036, 0], abs=0.002)
    for mark in marks:
        assert mark["drawn"] == 1 and abs(mark["point"][1]) < 1e-6  # on the floor, not at the handle inside it
    grooves = [mark["point"][0] for mark in marks if mark["kind"] == "groove"]
    spacing = 0.002
    off = sorted(abs(x - spacing * round(x / spacing)) for x in grooves)
    assert off[len(off) // 2] < 0.3e-3, grooves  # a groove is 0.5 mm wide, and there is one every 2 mm


def test_a_mark_has_the_colour_of_its_kind_and_fades(scene: Page) -> None:
    live(scene)
    x, y = to_px(scene, [0.02, 0.03])
    around = [x - 40, y - 40, x + 40, y + 40]
    for kind in ("contact", "groove", "rupture"):
        assert pixels(scene, kind, around)["count"] == 0
        scene.evaluate("(kind) => hapticd.scene.contacts.marks.add(kind, [0.02, 0.03], performance.now())", kind)
        # Before the mark fades; a slow machine repeats the mark.
        found = 0.0
        for _ in range(20):
            found = pixels(scene, kind, around)["count"]
            if found > 0:
                break
            scene.evaluate("(kind) => hapticd.scene.contacts.marks.add(kind, [0.02, 0.03], performance.now())", kind)
        assert found > 5
        scene.wait_for_function("() => hapticd.scene.contacts.marks.seen(performance.now()).length === 0")


def test_a_touched_membrane_bends_to_the_handle(scene: Page) -> None:
    fit(scene, [-0.025, 0.02, 0.025, 0.045])
    away = {"position_m": [0.0, 0.022]}
    x, straight = to_px(scene, [-0.0075, 0.035])
    _, bent = to_px(scene, [-0.0075, 0.033])  # half-way between the end, at 35 mm, and the handle, at 31 mm

    def skin() -> float:
        line = pixels(scene, "text", [x - 2, straight - 40, x + 2, straight + 60])
        return (line["top"] + line["bottom"]) / 2

    assert bent - straight > 10
    show(scene, away, [])
    assert skin() == pytest.approx(straight, abs=2)
    show(scene, {"position_m": [0.0, 0.031]}, ["skin"])
    assert skin() == pytest.approx(bent, abs=2)


def test_a_membrane_that_is_pushed_too_far_stays_ruptured_until_it_is_healed(scene: Page) -> None:
    rupture = shipped_materials()["cellophane"].rupture
    assert rupture is not None
    scene.evaluate(WATCH_MARKS)
    around = [[0.3, 0.03, 0.02], [0.6, 0.03, 0.05], [0.9, 0.003, 0.05]]  # above the membrane, not through it
    push = [[0.8, 0.003, 0.015]]
    heal = scene.get_by_role("button", name="Heal membranes")
    for _ in range(2):  # ruptures again after healing, so the daemon has healed it, too
        scene.evaluate("() => (marked.length = 0)")
        scene.evaluate("(waypoints) => hapticd.link.call('set_operator', { waypoints })", around)
        scene.wait_for_function(ABOVE)
        assert pixels(scene, "rupture")["count"] == 0 and heal.is_hidden()
        scene.evaluate("(waypoints) => hapticd.link.call('set_operator', { waypoints })", push)
        scene.wait_for_function("() => marked.some(({ kind }) => kind === 'rupture')")
        assert scene.evaluate("() => hapticd.scene.contacts.punctures.ids") == ["skin"]
        torn = next(mark for mark in scene.evaluate("() => marked") if mark["kind"] == "rupture")
        # The membrane ruptures at the depth of its material, or a little later.
        assert torn["point"][0] == pytest.approx(0.003, abs=0.002)
        assert 0.9 * rupture.depth_m < 0.035 - torn["point"][1] < 0.02
        scene.wait_for_function("() => hapticd.scene.contacts.marks.seen(performance.now()).length === 0")
        x, y = to_px(scene, [torn["point"][0], 0.035])
        gap = pixels(scene, "rupture", [x - 2, y - 1, x + 2, y + 1])
        edges = pixels(scene, "rupture", [x - 30, y - 2, x + 30, y + 8])
        assert gap["count"] == 0 and edges["left"] < x < edges["right"] and edges["count"] > 10
        heal.click()
        scene.wait_for_function("() => hapticd.scene.contacts.punctures.ids.length === 0")
    assert heal.is_hidden()


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_names_bars_and_ticks_never_lie_over_each_other(scene: Page, scheme: Any) -> None:
    scene.emulate_media(color_scheme=scheme)
    for size in (None, NARROW):
        if size is not None:
            scene.set_viewport_size(size)
            scene.wait_for_function("() => hapticd.scene.transform.width === hapticd.scene.canvas.clientWidth")
        for what in ("objects", "workspace"):
            scene.evaluate("(what) => { hapticd.scene.fit(what); hapticd.scene.picture.drawAtOnce(); }", what)
            labels = scene.evaluate("() => hapticd.scene.picture.labels.map(({ rect }) => rect)")
            assert len(labels) >= 4
            for i, (left, top, right, bottom) in enumerate(labels):
                for other in labels[:i]:
                    assert left >= other[2] or right <= other[0] or top >= other[3] or bottom <= other[1]
            foot = scene.locator(".scene-figures").bounding_box(), scene.locator(".scene-legend").bounding_box()
            assert foot[0] is not None and foot[1] is not None
            clear = foot[0]["x"] + foot[0]["width"] <= foot[1]["x"] or foot[0]["y"] + foot[0]["height"] <= foot[1]["y"]
            assert clear, foot
    figures = r"x \S+ mm, y \S+ mm, touching .+, \d+\.\d\d N"
    scene.wait_for_function("() => document.querySelector('.scene-figures').textContent.includes('mm')")
    assert re.fullmatch(figures, scene.locator(".scene-figures").inner_text())
