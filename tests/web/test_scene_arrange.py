"""Arranging objects in the scene view: the daemon gets added, moved, turned, sized and deleted objects; undo."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import pytest
from playwright.sync_api import Page

from tests.web.browser import Pages
from tests.web.drawing import on_page, scene_page, texts, to_px

pytestmark = pytest.mark.slow

TURN_PX = 34  # distance of the turning grip from its object


@pytest.fixture(scope="module")
def page(_context: Pages) -> Iterator[Page]:
    """Open one page for all tests, without samples, because no test moves the handle."""
    with scene_page(_context) as opened:
        opened.evaluate("() => hapticd.link.subscribe(['state', 'event', 'change', 'status'])")
        yield opened


@pytest.fixture
def scene(page: Page) -> Iterator[Page]:
    """Return a page in Arrange mode that shows all objects; restore the scene after the test."""
    was = objects(page)
    page.get_by_role("button", name="Arrange: the pointer moves objects").click()
    page.evaluate("() => { hapticd.scene.arrange.select(null); hapticd.scene.fit('objects'); }")
    yield page
    given = {id: None for id in objects(page) if id not in was} | was
    page.evaluate("(objects) => hapticd.link.call('update_scene', { objects, wait: true })", given)


def objects(page: Page) -> dict[str, Any]:
    """Return the objects that the daemon renders."""
    found: dict[str, Any] = page.evaluate("() => hapticd.link.call('get_scene').then(({ scene }) => scene.objects)")
    return found


def wait_for(page: Page, id: str, condition: str, argument: object = None) -> Any:
    """Return an object once it meets `condition`, at the daemon and on the page."""
    page.wait_for_function(
        f"""async ([id, given]) => {{
          const {{ scene }} = await hapticd.link.call("get_scene");
          const text = (object) => JSON.stringify(Object.entries(object ?? {{}}).sort());
          const there = scene.objects[id];
          return text(there) === text(hapticd.scene.objects[id]) && ({condition})(there, given);
        }}""",
        arg=[id, argument],
        polling=100,
    )
    return objects(page).get(id)


def drag(page: Page, begin: tuple[float, float], end: tuple[float, float]) -> None:
    page.mouse.move(*begin)
    page.mouse.down()
    page.mouse.move((begin[0] + end[0]) / 2, (begin[1] + end[1]) / 2, steps=3)
    page.mouse.move(*end, steps=3)
    page.mouse.up()


def undo(page: Page, key: str = "Control+z") -> None:
    page.keyboard.press(key)


def undone(page: Page) -> None:
    """Undo a step, and wait until the page has undone it."""
    page.evaluate("() => hapticd.undo.undo()")


def undoable(page: Page) -> Any:
    return page.evaluate("() => hapticd.undo.undoable")


def test_a_dragged_object_moves_by_as_much_and_a_drag_is_one_step_of_undo(scene: Page) -> None:
    before = objects(scene)["peg"]
    begin = before["center_m"]
    end = [begin[0] + 0.02, begin[1] + 0.005]
    a_mm_px = 1e-3 * scene.evaluate("() => hapticd.scene.transform.pxPerM")
    drag(scene, on_page(scene, begin), on_page(scene, end))
    scene.wait_for_function("() => hapticd.undo.undoable === 'move peg'")
    moved = wait_for(scene, "peg", "(peg, x) => Math.abs(peg.center_m[0] - x) < 1e-3", end[0])
    # The mouse has integer pixels.
    assert moved["center_m"] == pytest.approx(end, abs=1.5e-3 / a_mm_px)
    assert {**moved, "center_m": begin} == before
    assert scene.evaluate("() => hapticd.scene.selected") == "peg"
    (name,) = [(x, y) for text, x, y in texts(scene) if text.startswith("peg")]
    assert name[0] == pytest.approx(to_px(scene, moved["center_m"])[0], abs=3)  # the picture has its name there

    undo(scene)
    assert wait_for(scene, "peg", "(peg, x) => peg.center_m[0] === x", begin[0]) == before
    assert scene.evaluate("() => hapticd.undo.redoable") == "move peg"
    undo(scene, "Control+Shift+z")
    assert wait_for(scene, "peg", "(peg, x) => peg.center_m[0] === x", moved["center_m"][0]) == moved


def test_with_shift_a_drag_goes_in_steps_of_a_millimetre(scene: Page) -> None:
    scene.mouse.move(*on_page(scene, [-0.052, 0.012]))
    scene.keyboard.down("Shift")
    scene.mouse.down()
    scene.mouse.move(*on_page(scene, [-0.042, 0.024]), steps=5)
    scene.mouse.up()
    scene.keyboard.up("Shift")
    moved = wait_for(scene, "peg", "(peg) => peg.center_m[1] > 0.0201")["center_m"]
    assert [round(1e3 * value, 6) for value in moved] == [-42, 24]


def test_the_round_grip_turns_a_box_and_the_square_one_sizes_it(scene: Page) -> None:
    before = objects(scene)["block"]
    (x, y), (_, height) = before["center_m"], before["size_m"]
    centre = on_page(scene, [x, y])
    scene.mouse.click(*centre)
    scene.wait_for_function("() => hapticd.scene.selected === 'block'")
    top = on_page(scene, [x, y + height / 2])
    knob = (top[0], top[1] - TURN_PX)
    arm = centre[1] - knob[1]
    drag(scene, knob, (centre[0] - arm, centre[1]))  # from above to the left: a quarter turn anticlockwise
    turned = wait_for(scene, "block", "(block) => block.angle_rad > 1.5")
    assert turned["angle_rad"] == pytest.approx(math.pi / 2, abs=2 / arm)
    assert turned["center_m"] == before["center_m"] and turned["size_m"] == before["size_m"]
    assert undoable(scene) == "turn block"
    undo(scene)
    assert wait_for(scene, "block", "(block) => block.angle_rad === 0") == before

    width = before["size_m"][0]
    drag(scene, on_page(scene, [x + width / 2, y]), on_page(scene, [x + width, y]))
    sized = wait_for(scene, "block", "(block) => block.size_m[0] > 0.03")
    pixel_m = 1 / scene.evaluate("() => hapticd.scene.transform.pxPerM")
    assert sized["size_m"] == pytest.approx([2 * width, height], abs=3 * pixel_m)
    assert sized["center_m"] == before["center_m"]
    undo(scene)
    assert wait_for(scene, "block", "(block, width) => block.size_m[0] === width", width) == before


def test_keys_move_turn_and_delete_what_is_selected(scene: Page) -> None:
    before = objects(scene)["skin"]
    scene.get_by_label("Selected object", exact=True).locator("visible=true").last.select_option("skin")
    scene.locator(".scene-canvas").focus()
    scene.keyboard.press("ArrowRight")
    scene.keyboard.press("Shift+ArrowUp")
    x, y = before["center_m"]
    moved = wait_for(scene, "skin", "(skin, y) => skin.center_m[1] > y", y + 0.004)
    assert moved["center_m"] == pytest.approx([x + 0.001, y + 0.005], abs=1e-9)
    scene.keyboard.press("[")
    turned = wait_for(scene, "skin", "(skin) => skin.normal[0] !== 0")
    angle = math.radians(5)
    assert turned["normal"] == pytest.approx([-math.sin(angle), math.cos(angle)], abs=1e-9)

    scene.keyboard.press("Delete")
    assert wait_for(scene, "skin", "(skin) => skin === undefined") is None
    assert not any(text.startswith("skin") for text, _, _ in texts(scene))
    assert scene.evaluate("() => hapticd.scene.selected") is None
    undo(scene)
    assert wait_for(scene, "skin", "(skin) => skin !== undefined") == turned
    scene.wait_for_function("() => 'skin' in hapticd.scene.objects")
    assert any(text.startswith("skin") for text, _, _ in texts(scene))
    # Two presses of a key within a second are one step.
    for step in ("turn skin", "move skin"):
        while undoable(scene) == step:
            undone(scene)
    assert objects(scene)["skin"] == before


def test_an_object_that_is_added_is_drawn_selected_and_taken_back(scene: Page) -> None:
    before = objects(scene)
    scene.evaluate("() => hapticd.tabs.show('objects-panel')")
    scene.get_by_role("button", name="Add disc").click()
    scene.wait_for_function("() => hapticd.scene.selected === 'disc'")
    added = wait_for(scene, "disc", "(disc) => disc !== undefined")
    assert added["kind"] == "disc"
    scene.wait_for_function("() => 'disc' in hapticd.scene.objects")
    assert any(text.startswith("disc") for text, _, _ in texts(scene))
    begin = added["center_m"]
    drag(scene, on_page(scene, begin), on_page(scene, [begin[0], begin[1] + 0.006]))
    wait_for(scene, "disc", "(disc, y) => disc.center_m[1] > y", begin[1] + 0.004)
    scene.wait_for_function("() => hapticd.undo.undoable === 'move disc'")
    undo(scene)
    assert wait_for(scene, "disc", "(disc, y) => disc.center_m[1] === y", begin[1]) == added
    undo(scene)
    assert wait_for(scene, "disc", "(disc) => disc === undefined") is None
    assert objects(scene) == before
    assert scene.evaluate("() => hapticd.scene.selected") is None


def test_what_the_daemon_refuses_goes_back_and_says_why(scene: Page) -> None:
    before = objects(scene)["peg"]
    scene.evaluate(
        "() => { hapticd.scene.arrange.select('peg'); hapticd.scene.updates.send('peg', { radius_m: 1e6 }); }"
    )
    scene.locator("#notices").get_by_text("radius_m").first.wait_for()
    assert objects(scene)["peg"] == before
    assert scene.evaluate("() => hapticd.scene.objects.peg.radius_m") == before["radius_m"]


def test_a_drag_on_an_empty_place_moves_the_view_and_no_object(scene: Page) -> None:
    before, step = objects(scene), undoable(scene)
    empty = [0.025, 0.03]
    begin = on_page(scene, empty)
    drag(scene, begin, (begin[0] + 60, begin[1] + 20))
    assert on_page(scene, empty) == pytest.approx((begin[0] + 60, begin[1] + 20), abs=0.01)
    assert objects(scene) == before and undoable(scene) == step
    assert scene.evaluate("() => hapticd.scene.hand.target") is None
