"""Mouse, touch, keyboard and gamepad as the hand: it presses a wall, which holds the handle back, and is released."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from playwright.sync_api import Page

from hapticd.config.materials import shipped_materials
from tests.web.browser import Pages
from tests.web.drawing import on_page, pixels, scene_page, to_px

pytestmark = pytest.mark.slow

WALL = shipped_materials()["wood"].stiffness_n_per_m
# The handle, the forces on it and the target of the hand, of one sample.
NOW = """() => {
  const { scene } = hapticd, { position, contact } = scene.moments.newest;
  return { position, contact, target: scene.hand.target, held: scene.hand.held };
}"""
# The same at rest: every sample of the last tenth of a second is within 0.02 mm of the newest.
PRESSED = f"""() => {{
  const {{ columns, rows, first, capacity }} = hapticd.samples;
  const newest = (rows - 1) % capacity;
  for (let row = rows - 1000; row < rows; row++) {{
    if (row < first || Math.abs(columns.y_m[row % capacity] - columns.y_m[newest]) > 2e-5) {{
      return false;
    }}
  }}
  return columns.contact_y_n[newest] > 0.3 && ({NOW})();
}}"""
# Stores the targets that this page sends, and whether its lease lapsed.
WATCH = """() => {
  globalThis.lapsed = false;
  if (globalThis.targets) {
    targets.length = 0;
    return;
  }
  globalThis.targets = [];
  const { link, safety } = hapticd, notify = link.notify.bind(link);
  link.notify = (method, message) => {
    if (method === "stream_target") {
      targets.push(message.position_m);
    }
    return notify(method, message);
  };
  safety.addEventListener("change", () => {
    globalThis.lapsed ||= safety.faults.includes("lease") || safety.problem.includes("held up");
  });
}"""
IN_THE_AIR = """() => {
  const { position } = hapticd.scene.moments.newest;
  return Math.hypot(position[0] - 0.01, position[1] - 0.02) < 1e-3;
}"""
# Whether the oscilloscope draws the trace of the force clearly above its zero line.
TRACE = """() => {
  const { plot } = hapticd.scope, { canvas } = plot;
  const ink = document.createElement("canvas").getContext("2d");
  ink.fillStyle = getComputedStyle(document.documentElement).getPropertyValue("--contact").trim();
  ink.fillRect(0, 0, 1, 1);
  const wanted = ink.getImageData(0, 0, 1, 1).data;
  const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  const rows = new Set();
  for (let i = 0; i < data.length; i += 4) {
    if ([0, 1, 2].every((k) => Math.abs(data[i + k] - wanted[k]) <= 24)) {
      rows.add(Math.floor(i / 4 / canvas.width));
    }
  }
  return Math.max(...rows) - Math.min(...rows) > 0.2 * canvas.height;
}"""
GAMEPAD = """() => {
  globalThis.stick = [0, 0];
  const pad = { connected: true, get axes() { return [...stick, 0, 0]; }, buttons: [], index: 0, id: "test" };
  navigator.getGamepads = () => [null, pad];
  dispatchEvent(new Event("gamepadconnected"));
}"""
ATTEMPTS = 6


class LeaseLapsed(Exception):
    """The machine blocked the page for longer than its lease: the forces faded, and the hand was released."""


def undisturbed(test: Callable[..., None]) -> Callable[..., None]:
    """Return a test that begins again if the machine was too busy to renew the page's lease."""

    @functools.wraps(test)
    def begun_again(*given: Any, **named: Any) -> None:
        for _ in range(ATTEMPTS - 1):
            try:
                return test(*given, **named)
            except LeaseLapsed:
                continue
        return test(*given, **named)

    return begun_again


def check_lease(page: Page) -> None:
    if page.evaluate("() => lapsed"):
        raise LeaseLapsed


def wait(page: Page, condition: str, given: object = None) -> Any:
    """Return the result of a page's function once it is true. Raises LeaseLapsed if the lease lapses before."""
    found = page.wait_for_function(f"(given) => lapsed ? 'lapsed' : ({condition})(given)", arg=given).json_value()
    if found == "lapsed":
        raise LeaseLapsed
    return found


@pytest.fixture(scope="module")
def scene(_context: Pages) -> Iterator[Page]:
    """Open one page for all tests."""
    with scene_page(_context, "scope") as opened:
        yield opened


def begin(page: Page) -> None:
    """Put the released hand 20 mm above the floor; the forces may be on without a lease."""
    page.mouse.up()
    page.evaluate("() => { hapticd.scene.hand.releaseAll(); hapticd.scene.fit('objects'); globalThis.stick = [0, 0]; }")
    if page.evaluate("() => hapticd.safety.forces !== 'on' || hapticd.safety.holder === 'another'"):
        page.wait_for_function("() => hapticd.safety.engage()", polling=250)
    page.evaluate("() => hapticd.link.call('set_operator', { waypoints: [[0.1, 0.01, 0.02]] })")
    page.evaluate(WATCH)
    wait(page, IN_THE_AIR)
    page.evaluate("() => hapticd.scene.hand.forget()")


@contextmanager
def watching(context: Pages) -> Iterator[Page]:
    """Open a second page, which does not control the forces."""
    with scene_page(context) as other:
        other.wait_for_function("() => hapticd.safety.holder === 'another' || hapticd.safety.forces !== 'on'")
        if other.evaluate("() => hapticd.safety.holder !== 'another'"):
            raise LeaseLapsed
        other.evaluate(WATCH)
        yield other


def hand_stiffness(page: Page) -> float:
    return float(page.evaluate("() => hapticd.model.config.device.sim.hand.stiffness_n_per_m"))


def resting_y(page: Page, target_y: float) -> float:
    """Return y of the resting handle while the hand's target is at `target_y`: two springs in series."""
    hand = hand_stiffness(page)
    return target_y * hand / (hand + WALL)


def check_held_at_the_wall(page: Page, target_y: float) -> Any:
    """Check in one sample that the hand pulls the handle into the floor, whose force is stiffness times depth."""
    now = wait(page, PRESSED)
    assert now["target"][1] == pytest.approx(target_y, abs=0.5e-3)
    assert now["position"][1] == pytest.approx(resting_y(page, now["target"][1]), rel=0.1, abs=0.1e-3)
    assert now["contact"][1] == pytest.approx(-WALL * now["position"][1], rel=0.03)
    assert now["position"][1] - now["target"][1] > 2 * -now["position"][1]  # the floor gives way much less
    return now


@undisturbed
def test_a_drag_into_the_floor_is_held_there_with_an_arrow_and_a_trace(scene: Page) -> None:
    begin(scene)
    above, end = on_page(scene, [0.01, 0.02]), on_page(scene, [0.01, -0.008])
    scene.mouse.move(*above)
    scene.mouse.down()
    scene.mouse.move(*end, steps=12)
    now = check_held_at_the_wall(scene, -0.008)
    assert scene.evaluate("() => hapticd.safety.holder") == "this page"  # the press took control of the forces

    (x, y), (_, target) = to_px(scene, now["position"]), to_px(scene, now["target"])
    arrow = pixels(scene, "contact", [x - 14, y - 200, x + 14, y - 9])
    per_newton = scene.evaluate("() => hapticd.scene.picture.pxPerN")
    assert y - 9 - arrow["top"] == pytest.approx(now["contact"][1] * per_newton, abs=4)
    ring = pixels(scene, "hand", [x - 16, target - 16, x + 16, target + 16])
    assert ring["count"] > 30 and ring["bottom"] > y + 9  # the hand is drawn inside the wall
    assert pixels(scene, "hand", [x - 2, y + 8, x + 2, target - 10])["count"] > 0  # and the line to it

    assert scene.evaluate("() => hapticd.scope.channels.includes('contact_y')")
    wait(scene, TRACE)

    scene.mouse.move(*above, steps=12)
    wait(
        scene,
        "() => { const { contact, position } = hapticd.scene.moments.newest;"
        " return contact[1] === 0 && position[1] > 0.015; }",
    )
    scene.mouse.up()
    assert scene.evaluate("() => hapticd.scene.hand.held") is False


@undisturbed
def test_a_released_hand_stays_and_sends_nothing(scene: Page) -> None:
    begin(scene)
    scene.mouse.move(*on_page(scene, [0.01, 0.02]))
    scene.mouse.down()
    scene.mouse.move(*on_page(scene, [0.01, -0.006]), steps=8)
    check_held_at_the_wall(scene, -0.006)
    scene.mouse.up()
    sent, rows = scene.evaluate("() => [targets.length, hapticd.samples.rows]")
    scene.mouse.move(*on_page(scene, [0.03, 0.03]), steps=4)
    wait(scene, "(rows) => hapticd.samples.rows > rows + 2000", rows)
    assert scene.evaluate("() => targets.length") == sent
    check_held_at_the_wall(scene, -0.006)


@undisturbed
def test_a_finger_is_the_hand_and_two_fingers_are_the_view(scene: Page) -> None:
    begin(scene)
    session = scene.context.new_cdp_session(scene)

    def touch(kind: str, *points: tuple[float, float]) -> None:
        places = [{"x": x, "y": y, "id": number} for number, (x, y) in enumerate(points)]
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": places})

    above, end = on_page(scene, [0.01, 0.02]), on_page(scene, [0.01, -0.008])
    touch("touchStart", above)
    for share in (0.25, 0.5, 0.75, 1.0):
        touch("touchMove", (above[0], above[1] + share * (end[1] - above[1])))
    check_held_at_the_wall(scene, -0.008)
    touch("touchEnd")
    wait(scene, "() => !hapticd.scene.hand.held")

    a, b = on_page(scene, [-0.02, 0.02]), on_page(scene, [0.02, 0.02])
    scale = scene.evaluate("() => hapticd.scene.transform.pxPerM")
    touch("touchStart", a)
    touch("touchStart", a, b)
    middle = (a[0] + b[0]) / 2
    for apart in (1.2, 1.6, 2.0):
        touch("touchMove", (middle + apart * (a[0] - middle), a[1]), (middle + apart * (b[0] - middle), b[1]))
    touch("touchEnd")
    wait(scene, "(scale) => hapticd.scene.transform.pxPerM > 1.9 * scale", scale)
    assert scene.evaluate("() => hapticd.scene.transform.pxPerM") == pytest.approx(2 * scale, rel=0.03)
    assert scene.evaluate("() => hapticd.scene.hand.held") is False


@undisturbed
def test_arrow_keys_move_the_hand_by_steps(scene: Page) -> None:
    begin(scene)
    scene.mouse.move(*on_page(scene, [0.01, 0.02]))
    scene.mouse.down()
    wait(scene, "() => targets.length > 0")
    scene.mouse.up()
    x, y = scene.evaluate("() => hapticd.scene.hand.target")
    for keys, step in (("ArrowRight", 1e-3), ("Shift+ArrowLeft", -5e-3), ("Alt+ArrowRight", 1e-4)):
        scene.keyboard.press(keys)
        x += step
        wait(scene, "(x) => Math.abs(hapticd.scene.hand.target[0] - x) < 1e-6", x)
        assert scene.evaluate("() => hapticd.scene.hand.target[1]") == y
    for _ in range(6):
        scene.keyboard.press("Shift+ArrowDown")
    wait(scene, "(y) => Math.abs(hapticd.scene.hand.target[1] - y) < 1e-6", y - 0.03)
    now = check_held_at_the_wall(scene, y - 0.03)
    assert now["position"][0] == pytest.approx(x, abs=0.5e-3)


@undisturbed
def test_the_stick_of_a_gamepad_moves_the_hand_and_leaves_it_where_it_is(scene: Page) -> None:
    begin(scene)
    scene.evaluate(GAMEPAD)
    scene.evaluate("() => (stick = [0.1, 0.1])")  # at rest
    frames = scene.evaluate(
        "() => new Promise((done) => { let n = 0;"
        " const next = () => (++n < 20 ? requestAnimationFrame(next) : done(targets.length)); next(); })"
    )
    assert frames == 0
    scene.evaluate("() => (stick = [0, 1])")  # down in the browser's axes
    wait(scene, "() => hapticd.scene.hand.target?.[1] < -0.006")
    scene.evaluate("() => (stick = [0, 0])")
    wait(scene, "() => !hapticd.scene.hand.held")
    target = scene.evaluate("() => hapticd.scene.hand.target")
    assert target[0] == pytest.approx(0.01, abs=1e-3)
    check_held_at_the_wall(scene, target[1])
    assert scene.evaluate("() => hapticd.scene.hand.target") == target


def drag(page: Page, to: list[float]) -> None:
    page.mouse.move(*on_page(page, [0.01, 0.02]))
    page.mouse.down()
    page.mouse.move(*on_page(page, to), steps=6)


def rows_later(page: Page, rows: int) -> None:
    page.wait_for_function(
        "(rows) => hapticd.samples.rows > rows", arg=page.evaluate("() => hapticd.samples.rows") + rows
    )


@undisturbed
def test_a_page_that_watches_does_not_move_the_hand_of_another(scene: Page, _context: Pages) -> None:
    begin(scene)
    drag(scene, [0.01, -0.006])
    check_held_at_the_wall(scene, -0.006)
    with watching(_context) as other:
        other.evaluate(GAMEPAD)
        drag(other, [0.04, 0.04])
        other.mouse.move(*on_page(other, [0.03, 0.03]), steps=4)
        other.keyboard.press("ArrowRight")
        other.evaluate("() => (stick = [1, 0])")
        rows_later(other, 2000)
        check_lease(scene)
        assert "Another page holds the forces" in other.locator("#notices").inner_text()
        assert other.evaluate("() => targets") == []
        assert other.evaluate("() => [hapticd.scene.hand.held, hapticd.scene.hand.target]") == [False, None]
        other.evaluate("() => (stick = [0, 0])")
        other.mouse.up()
        check_held_at_the_wall(scene, -0.006)
    scene.mouse.up()


@undisturbed
def test_a_stop_releases_the_hand_during_a_drag(scene: Page, _context: Pages) -> None:
    begin(scene)
    drag(scene, [0.01, -0.006])
    check_held_at_the_wall(scene, -0.006)
    with watching(_context) as other:
        other.locator("#stop").click()
        wait(scene, "() => hapticd.safety.forces === 'off' && !hapticd.scene.hand.held")
    sent = scene.evaluate("() => targets.length")
    scene.mouse.move(*on_page(scene, [0.04, 0.04]), steps=6)
    rows_later(scene, 2000)
    assert scene.evaluate("() => targets.length") == sent
    scene.mouse.up()
    drag(scene, [0.01, 0.02])  # only the button turns the forces on after a stop
    rows_later(scene, 2000)
    assert "Forces are off" in scene.locator("#notices").inner_text()
    assert scene.evaluate("() => hapticd.scene.hand.held") is False
    assert scene.evaluate("() => targets.length") == sent
    scene.mouse.up()
    scene.locator("#forces-on").click()
    wait(scene, "() => hapticd.safety.holds && hapticd.safety.forces === 'on'")
    drag(scene, [0.01, 0.01])
    wait(scene, "(sent) => targets.length > sent", sent)
    scene.mouse.up()
