"""Pure modules of the scene view, called in the browser: transform, surface point, textures, grips, hand."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, Route

pytestmark = pytest.mark.slow

STATIC = Path(__file__).parents[2] / "hapticd" / "web" / "static"
ADDRESS = "http://page.invalid"


@pytest.fixture(scope="module")
def page(browser: Browser) -> Iterator[Page]:
    """Open an empty page with the modules, without server and daemon."""

    def answer(route: Route) -> None:
        path = route.request.url.removeprefix(ADDRESS)
        if path == "/":
            route.fulfill(body="<!doctype html><title>modules</title>", content_type="text/html")
        else:
            route.fulfill(path=STATIC / path.removeprefix("/static/"))

    opened = browser.new_page()
    opened.route(f"{ADDRESS}/**", answer)
    opened.goto(f"{ADDRESS}/")
    yield opened
    opened.close()


def call(page: Page, module: str, name: str, *arguments: object) -> Any:
    """Return the result of a function of a module of the scene view."""
    script = "async ([module, name, given]) => (await import(`/static/scene_view/${module}.js`))[name](...given)"
    return page.evaluate(script, [module, name, arguments])


def run(page: Page, body: str, argument: object = None) -> Any:
    """Return the result of a function body, which may load modules of the scene view with `load(name)`."""
    prefix = "const load = (name) => import(`/static/scene_view/${name}.js`);"
    return page.evaluate(f"async (given) => {{ {prefix} {body} }}", argument)


def test_the_transform_is_to_scale_and_goes_both_ways(page: Page) -> None:
    result = run(
        page,
        """const { Transform } = await load("transform");
        const t = new Transform();
        t.resize(800, 600);
        t.pxPerM = 5000;
        t.centre = [0.01, 0.02];
        const before = t.toM([120, 90]);
        t.zoom(3, [120, 90]);
        const after = t.toM([120, 90]);
        const there = t.toPx([0.011, 0.019]);
        t.pan(10, -20);
        return [before, after, t.pxPerM, there, t.toPx([0.011, 0.019]), t.toM(t.toPx([0.003, -0.004]))];""",
    )
    before, after, scale, there, panned, back = result
    assert before == pytest.approx([0.01 - 280 / 5000, 0.02 + 210 / 5000])
    assert after == pytest.approx(before) and scale == 15000
    assert panned == pytest.approx([there[0] + 10, there[1] - 20])
    assert back == pytest.approx([0.003, -0.004])


def test_fit_shows_a_complete_rectangle_within_its_margins(page: Page) -> None:
    corners = run(
        page,
        """const { Transform } = await load("transform");
        const t = new Transform();
        t.resize(1000, 400);
        t.fit([-0.075, -0.075, 0.075, 0.075], { left: 40, top: 10, right: 20, bottom: 30 });
        return [t.toPx([-0.075, 0.075]), t.toPx([0.075, -0.075])];""",
    )
    (left, top), (right, bottom) = corners
    assert (top, bottom) == pytest.approx((10, 370))
    assert right - left == pytest.approx(360)
    assert (left + right) / 2 == pytest.approx(40 + 940 / 2)


@pytest.mark.parametrize(
    ("px_per_m", "step", "bar"), [(4000, 0.02, 0.02), (2000, 0.05, 0.02), (7000, 0.01, 0.01), (1e6, 1e-4, 5e-5)]
)
def test_grid_and_scale_bar_are_1_2_or_5(page: Page, px_per_m: float, step: float, bar: float) -> None:
    body = """const { Transform } = await load("transform");
    const t = new Transform();
    t.pxPerM = given;
    return [t.gridStep(64), t.barLength(90)];"""
    assert run(page, body, px_per_m) == pytest.approx([step, bar])


@pytest.mark.parametrize(
    ("metres", "text"), [(0.02, "20 mm"), (0.0005, "0.5 mm"), (2e-5, "20 µm"), (0, "0 mm"), (1.5, "1500 mm")]
)
def test_lengths_have_their_unit(page: Page, metres: float, text: str) -> None:
    assert call(page, "transform", "lengthText", metres) == text


BOX = {"kind": "box", "center_m": [0.01, 0.02], "size_m": [0.02, 0.01], "angle_rad": 0.0}
TURNED = {**BOX, "angle_rad": math.pi / 2}
DISC = {"kind": "disc", "center_m": [0.0, 0.0], "radius_m": 0.01}
SKIN = {"kind": "membrane", "center_m": [0.0, 0.03], "normal": [0.0, 1.0], "width_m": 0.02}
WALL = {"kind": "wall", "point_m": [0.0, 0.0], "normal": [0.0, 1.0]}


@pytest.mark.parametrize(
    ("thing", "point", "distance"),
    [
        (WALL, [0.5, -0.002], -0.002),
        (BOX, [0.01, 0.024], -0.001),
        (BOX, [0.023, 0.029], 0.005),
        (TURNED, [0.01, 0.028], -0.002),
        (TURNED, [0.017, 0.02], 0.002),
        (DISC, [0.006, 0.008], 0.0),
        (SKIN, [0.013, 0.034], 0.005),
    ],
)
def test_distances(page: Page, thing: dict[str, object], point: list[float], distance: float) -> None:
    assert call(page, "geometry", "distanceTo", thing, point) == pytest.approx(distance, abs=1e-12)


def test_what_stands_on_a_wall_is_picked_before_it(page: Page) -> None:
    objects = {"floor": {**WALL, "normal": [0, 1]}, "box": {**BOX, "center_m": [0, 0]}, "peg": DISC}
    assert call(page, "geometry", "pick", objects, [0.0095, -0.004], 0.0002) == "box"
    assert call(page, "geometry", "pick", objects, [0.0, 0.0099], 0.0002) == "peg"
    assert call(page, "geometry", "pick", objects, [0.05, -0.01], 0.0002) == "floor"
    assert call(page, "geometry", "pick", objects, [0.05, 0.01], 0.0002) is None


@pytest.mark.parametrize(
    ("before", "now", "face"),
    [
        ([0.01, 0.026], [0.01, 0.0245], 0),  # from above
        ([0.021, 0.02], [0.0195, 0.02], 1),  # from the right
        ([0.01, 0.014], [0.01, 0.0155], 2),
        ([-0.001, 0.02], [0.0005, 0.02], 3),
        ([0.01, 0.05], [0.01, 0.016], 0),  # deep in one step: still the upper face
        ([0.01, 0.0245], [0.0195, 0.02], 1),  # inside before: the nearest face
    ],
)
def test_a_box_is_entered_through_a_face(page: Page, before: list[float], now: list[float], face: int) -> None:
    assert call(page, "surface_point", "featureOf", BOX, before, now) == {"face": face}


def test_a_membrane_is_met_from_a_side(page: Page) -> None:
    assert call(page, "surface_point", "featureOf", SKIN, [0, 0.029], [0, 0.031]) == {"side": -1}
    assert call(page, "surface_point", "featureOf", SKIN, [0, 0.031], [0, 0.029]) == {"side": 1}


@pytest.mark.parametrize(
    ("thing", "feature", "position", "surface"),
    [
        (WALL, {}, [0.004, -0.003], [0.004, 0.0]),
        (DISC, {}, [0.003, 0.004], [0.006, 0.008]),
        (BOX, {"face": 1}, [0.018, 0.02], [0.02, 0.02]),
        (TURNED, {"face": 0}, [0.007, 0.021], [0.005, 0.021]),
        (SKIN, {"side": -1}, [0.001, 0.032], [0.001, 0.03]),
    ],
)
def test_the_surface_point_lies_on_what_is_pressed(
    page: Page, thing: dict[str, object], feature: dict[str, int], position: list[float], surface: list[float]
) -> None:
    body = """const { contactPoint, surfacePoint } = await load("surface_point");
    return surfacePoint(given.position, [contactPoint(given.thing, given.feature, given.position)]);"""
    given = {"thing": thing, "feature": feature, "position": position}
    assert run(page, body, given) == pytest.approx(surface, abs=1e-12)


def test_in_a_corner_the_surface_point_is_lifted_out_of_both_walls(page: Page) -> None:
    side = {"kind": "wall", "point_m": [-0.01, 0.0], "normal": [1.0, 0.0]}
    body = """const { contactPoint, surfacePoint } = await load("surface_point");
    return surfacePoint(given.at, given.walls.map((wall) => contactPoint(wall, {}, given.at)));"""
    assert run(page, body, {"at": [-0.012, -0.003], "walls": [WALL, side]}) == pytest.approx([-0.01, 0.0], abs=1e-12)
    assert run(page, body, {"at": [0.0, 0.001], "walls": [WALL, side]}) is None


def test_what_lies_behind_a_line_is_cut_out_of_a_polygon(page: Page) -> None:
    square = [[0, 0], [2, 0], [2, 2], [0, 2]]
    assert call(page, "geometry", "behind", square, [0, 1], [0, 1]) == [[0, 0], [2, 0], [2, 1], [0, 1]]
    assert call(page, "geometry", "behind", square, [0, -1], [0, 1]) == []


def test_grooves_lie_at_multiples_of_their_spacing(page: Page) -> None:
    assert call(page, "textures", "grooveNumbers", 0.002, -0.04, -0.015) == [-20, -8]
    assert call(page, "textures", "grooveNumbers", 0.01, 0.011, 0.019) == [2, 1]


def test_patches_and_what_lies_between_are_sections(page: Page) -> None:
    wall = {
        **WALL,
        "material": "wood",
        "patches": [
            {"from_m": 0.01, "to_m": 0.02, "material": "comb"},
            {"from_m": -0.05, "to_m": -0.02, "material": "grit"},
        ],
    }
    assert call(page, "shapes", "sections", wall, -0.03, 0.03) == [
        [-0.03, -0.02, "grit"],
        [-0.02, 0.01, "wood"],
        [0.01, 0.02, "comb"],
        [0.02, 0.03, "wood"],
    ]


def test_a_pushed_membrane_runs_through_the_probe(page: Page) -> None:
    line = call(page, "membranes", "skinLine", SKIN, [0.004, 0.027])
    assert line == [pytest.approx(point) for point in ([-0.01, 0.03], [0.004, 0.027], [0.01, 0.03])]


def test_objects_are_moved_turned_and_sized(page: Page) -> None:
    assert call(page, "grips", "moved", BOX, [0.0012, -0.0004]) == {"center_m": [0.0112, 0.0196]}
    assert call(page, "grips", "moved", BOX, [0.0012, -0.0004], True) == {"center_m": [0.011, 0.02]}
    assert call(page, "grips", "turned", BOX, math.pi / 2)["angle_rad"] == pytest.approx(math.pi / 2)
    assert call(page, "grips", "turned", WALL, math.pi / 2)["normal"] == pytest.approx([-1, 0])
    assert call(page, "grips", "dragged", BOX, "size", [0.02, 0.015], [0.025, 0.01]) == {"size_m": [0.03, 0.02]}
    assert call(page, "grips", "dragged", SKIN, "width", [0.01, 0.03], [0.0154, 0.03], True) == {"width_m": 0.031}
    assert call(page, "grips", "dragged", DISC, "radius", [0.01, 0], [0, 0.013]) == {"radius_m": 0.013}
    turned = call(page, "grips", "dragged", SKIN, "turn", [0, 0.04], [0.01, 0.03])
    assert turned["normal"] == pytest.approx([1, 0], abs=1e-9)


def test_a_stick_within_its_dead_zone_is_at_rest(page: Page) -> None:
    assert call(page, "gamepad", "speedOf", 0.1, -0.1) == [0, 0]
    assert call(page, "gamepad", "speedOf", 1.0, 0.0) == pytest.approx([0.15, 0])
    up = call(page, "gamepad", "speedOf", 0.0, -0.575)  # half-way beyond the dead zone: a quarter of the speed
    assert up == pytest.approx([0, 0.15 / 4])


def test_the_hand_reaches_out_then_follows_and_counts_its_messages(page: Page) -> None:
    sent, at_rest = run(
        page,
        """const { Hand } = await load("hand");
        let now = 0;
        const sent = [];
        const hand = new Hand((message) => sent.push({ ...message, now }), () => now);
        hand.limits = [-0.075, -0.075, 0.075, 0.075];
        hand.allow(true);
        hand.take("pointer", [0, 0], [0.01, 0]);
        for (let i = 0; i < 40; i++) { now += 4; hand.aimAt("pointer", [0.01, 0]); }
        now += 4; hand.aimAt("pointer", [0.05, 0]);
        now += 4; hand.aimAt("pointer", [0.5, 0]);
        hand.release("pointer");
        const count = sent.length;
        now += 100; hand.step([0, 0.001], [0, 0], 1);
        return [sent, sent.length - count];""",
    )
    numbers = [message["seq"] for message in sent]
    assert numbers == sorted(set(numbers))
    times = [message["now"] for message in sent]
    assert all(later - earlier >= 4 for earlier, later in pairwise(times))
    xs = [message["position_m"][0] for message in sent]
    reaching = [b - a for a, b in pairwise(xs) if b <= 0.01]
    assert max(reaching) <= 0.5 * 0.004 + 1e-12
    assert 0.05 in xs and max(xs) == 0.075  # it follows at once, and stays in the workspace
    assert at_rest <= 1


def test_a_hand_that_is_held_while_the_forces_go_and_come_back_has_a_place(page: Page) -> None:
    """The hand makes its first step at the moment at which it is allowed, when no time has passed."""
    targets = run(
        page,
        """const { Hand } = await load("hand");
        let now = 1000;
        const sent = [];
        const hand = new Hand((message) => sent.push(message.position_m), () => now);
        hand.allow(true);
        hand.take("pointer", [0, 0], [0.001, 0]);
        for (let i = 0; i < 40; i++) { now += 4; hand.aimAt("pointer", [0.001, 0]); }
        hand.allow(false);
        now += 20;
        hand.allow(true);
        now += 4; hand.take("pointer", [0, 0], [0.002, 0]);
        for (let i = 0; i < 40; i++) { now += 4; hand.aimAt("pointer", [0.002, 0]); }
        return sent;""",
    )
    assert all(x is not None and y is not None for x, y in targets)
    assert targets[-1] == [0.002, 0]


def test_updates_have_one_call_under_way_and_merge_what_comes_meanwhile(page: Page) -> None:
    calls, shown, after, refused, left = run(
        page,
        """const { Updates } = await load("updates");
        const calls = [];
        let answer;
        const updates = new Updates((objects) => {
          calls.push(objects);
          return new Promise((resolve, reject) => { answer = { resolve, reject }; });
        });
        let refused = null;
        updates.addEventListener("refused", (event) => { refused = event.detail.message; });
        const scene = { a: { x: 0, y: 0 }, b: { x: 5 } };
        updates.send("a", { x: 1 });
        updates.send("a", { x: 2 });
        const done = updates.send("a", { y: 3 });
        const shown = updates.over(scene);
        answer.resolve({ revision: 7 });
        await new Promise((go) => setTimeout(go));
        answer.resolve({ revision: 8 });
        await done;
        updates.arrived(8);
        const after = updates.over(scene);
        const failed = updates.send("b", null);
        answer.reject(new Error("no"));
        await failed;
        return [calls, shown, after, refused, updates.over(scene)];""",
    )
    assert calls == [{"a": {"x": 1}}, {"a": {"x": 2, "y": 3}}, {"b": None}]
    assert shown == {"a": {"x": 2, "y": 3}, "b": {"x": 5}}
    assert after == {"a": {"x": 0, "y": 0}, "b": {"x": 5}}
    assert refused == "no" and left == after


def test_words_say_position_contact_and_force(page: Page) -> None:
    moment = {"position": [-0.00301, 0.00001], "force": [0.3, 0.4]}
    assert call(page, "description", "words", moment, ["floor"]) == "x \u22123.0 mm, y 0.0 mm, touching floor, 0.50 N"
    assert call(page, "description", "words", moment, []).endswith("touching nothing, 0.50 N")


def test_the_line_of_figures_is_updated_while_a_screen_reader_waits(page: Page) -> None:
    shown, spoken = run(
        page,
        """const { Description } = await load("description");
        const [line, voice] = [{ textContent: "" }, { textContent: "" }];
        const description = new Description(line, voice);
        const clock = performance.now;
        try {
          for (const [k, ms] of [0, 200, 400, 420].entries()) {
            performance.now = () => 1e6 + ms;
            description.update({ position: [k / 1000, 0], force: [0, 0] }, ["floor"]);
          }
        } finally {
          performance.now = clock;
        }
        return [line.textContent, voice.textContent];""",
    )
    assert shown.startswith("x 2.0 mm")  # ten times a second
    assert spoken.startswith("x 0.0 mm")  # every five seconds


def test_labels_never_overlap(page: Page) -> None:
    rects = run(
        page,
        """const { Labels } = await load("labels");
        const ctx = document.createElement("canvas").getContext("2d");
        const labels = new Labels([0, 0, 300, 100]);
        labels.keepFree([0, 0, 50, 100]);
        for (let i = 0; i < 30; i++) {
          labels.write(ctx, `name ${i}`, [[20 + 9 * i, 20], [20 + 9 * i, 50], [20 + 9 * i, 80]], { colour: "black" });
        }
        return labels.placed.map((label) => label.rect);""",
    )
    assert 4 <= len(rects) < 30
    for i, (left, top, right, bottom) in enumerate(rects):
        assert left >= 50 and right <= 300 and top >= 0 and bottom <= 100
        for other in rects[:i]:
            assert left >= other[2] or right <= other[0] or top >= other[3] or bottom <= other[1]
