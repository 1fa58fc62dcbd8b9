"""The logic of the editors without a daemon: modules imported in a browser."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, Route

from hapticd.config.materials import shipped_materials

pytestmark = pytest.mark.slow

STATIC = Path(__file__).parents[2] / "hapticd" / "web" / "static"
ADDRESS = "http://page.invalid"
_Run = Callable[..., Any]


@pytest.fixture(scope="module")
def run(browser: Browser) -> Iterator[_Run]:
    """Yield a function that runs the body of an async function with modules of `static/`, by name, and one argument."""

    def answer(route: Route) -> None:
        path = route.request.url.removeprefix(f"{ADDRESS}/")
        if path:
            route.fulfill(path=STATIC / path.removeprefix("static/"))
        else:
            route.fulfill(body="<!doctype html><title>modules</title>", content_type="text/html")

    page = browser.new_page()
    page.route(f"{ADDRESS}/**", answer)
    page.goto(f"{ADDRESS}/")

    def evaluate(modules: dict[str, str], body: str, argument: object = None) -> Any:
        imports = "".join(f"const {name} = await import('/static/{path}');" for name, path in modules.items())
        return page.evaluate(f"async (given) => {{ {imports} {body} }}", argument)

    yield evaluate
    page.close()


PATCH = {"p": "editor/merge_patch.js"}


@pytest.mark.parametrize(
    ("value", "patch", "result"),
    [
        # The examples of RFC 7396, appendix A, that are maps.
        ({"a": "b"}, {"a": "c"}, {"a": "c"}),
        ({"a": "b"}, {"b": "c"}, {"a": "b", "b": "c"}),
        ({"a": "b"}, {"a": None}, {}),
        ({"a": "b", "b": "c"}, {"a": None}, {"b": "c"}),
        ({"a": ["b"]}, {"a": "c"}, {"a": "c"}),
        ({"a": "c"}, {"a": ["b"]}, {"a": ["b"]}),
        ({"a": {"b": "c"}}, {"a": {"b": "d", "c": None}}, {"a": {"b": "d"}}),
        ({"a": [{"b": "c"}]}, {"a": [1]}, {"a": [1]}),
        ({}, {"a": {"bb": {"ccc": None}}}, {"a": {"bb": {}}}),
    ],
)
def test_a_merge_patch_is_applied_as_the_standard_says(run: _Run, value: object, patch: object, result: object) -> None:
    assert run(PATCH, "return p.merged(given[0], given[1])", [value, patch]) == result


def test_a_difference_leads_from_one_material_to_any_other_and_back(run: _Run) -> None:
    materials = [material.to_dict() for material in shipped_materials().values()]
    wrong = run(
        PATCH,
        """let wrong = 0;
        for (const a of given) for (const b of given) {
          const patch = p.difference(a, b);
          wrong += !p.equal(p.merged(a, patch), b) + !p.equal(p.merged(b, p.inverse(a, patch)), a);
          wrong += p.departures({x: b}, {x: patch}).length;
        }
        return wrong""",
        materials,
    )
    assert wrong == 0


def test_two_patches_that_can_be_joined_do_what_they_do_one_after_the_other(run: _Run) -> None:
    value = {"a": {"b": 1, "c": 2}, "d": 3}
    patches = [{"a": {"b": None}}, {"a": {"b": 5}}, {"a": None}, {"a": {"e": 1}}, {"d": {"f": 1}}, {"d": None}]
    wrong, separate = run(
        PATCH,
        """const [value, patches] = given, wrong = [], separate = [];
        for (const a of patches) for (const b of patches) {
          if (!p.canJoin(a, b)) { separate.push([a, b]); continue; }
          const together = p.merged(value, p.joined(a, b)), singly = p.merged(p.merged(value, a), b);
          if (!p.equal(together, singly)) wrong.push([a, b]);
        }
        return [wrong, separate]""",
        [value, patches],
    )
    assert wrong == []
    assert len(separate) == 4
    assert [{"a": None}, {"a": {"e": 1}}] in separate


NUMBERS = {"n": "editor/numbers.js"}


@pytest.mark.parametrize(
    ("value", "unit", "shown"),
    [
        (0.00648, "s", "6.48"),
        (800.0, "N/m", "800"),
        (0.0001905, "m", "0.1905"),
        (1e-6, "s", "0.001"),
        (1.5707963267948966, "rad", "90"),
        (-0.04, "m", "-40"),
    ],
)
def test_numbers_are_shown_in_practical_units(run: _Run, value: float, unit: str, shown: str) -> None:
    text, back = run(
        NUMBERS,
        "const u = n.shownUnit(given[1]), t = n.format(given[0], u); return [t, n.parse(t, u)]",
        [value, unit],
    )
    assert (text, back) == (shown, value)


@pytest.mark.parametrize("text", ["", "abc", "1,5", "0x10", "1e", "Infinity", "NaN", "--1", "1 2"])
def test_other_texts_are_not_numbers(run: _Run, text: str) -> None:
    assert run(NUMBERS, "return Number.isNaN(n.parse(given, n.shownUnit('m')))", text)


def test_a_slider_reaches_both_ends_and_rises_from_one_to_the_other(run: _Run) -> None:
    cases = [
        [800, {"min": 0, "max": 1e5}, 800],
        [0, {"min": 0, "max": 1000}, 1],
        [0.00648, {"min": 1e-6, "max": 10}, 0.005],
        [2e-6, {"min": 1e-6, "max": 10}, 0.005],
        [0.2, {"min": 0, "max": 10}, 0.5],
        [0.03, {"min": -10, "max": 10, "linear": True}, 0.075],
        [-3, {"min": -1e5, "max": 1e5}, 3],
    ]
    for values, low, high, own in run(
        {"s": "editor/scale.js"},
        """return given.map(([value, limits, typical]) => {
          const scale = s.scaleAround(value, limits, typical);
          const values = Array.from({ length: s.STEPS + 1 }, (_, at) => scale.value(at));
          return [values, limits.min, limits.max, [value, scale.value(scale.position(value))]];
        })""",
        cases,
    ):
        assert values == sorted(values)
        assert low <= values[0] < values[-1] <= high
        assert own[1] == pytest.approx(own[0], rel=0.006, abs=2e-4)


def test_the_paths_of_problems_are_read(run: _Run) -> None:
    text = 'materials."my wood".tap.amplitudes[2]'
    assert run({"p": "editor/problem_path.js"}, "return p.parsePath(given)", text) == [
        "materials",
        "my wood",
        "tap",
        "amplitudes",
        2,
    ]


# ---- Sent changes --------------------------------------------------------------------------------------------------

FAKE = """
class Link {
  constructor() { this.calls = []; this.answers = []; }
  call(method, params) {
    return new Promise((resolve, reject) => this.calls.push({ method, params, resolve, reject }));
  }
}
const link = new Link();
const model = { applied() {} };
const changes = new c.Changes(link, model);
const turn = async () => { for (let i = 0; i < 20; i++) await null; };
const sent = () => link.calls.map(({ params }) => params.materials);
"""
CHANGES = {"c": "editor/changes.js"}


def test_one_call_is_under_way_and_the_newest_value_is_the_next(run: _Run) -> None:
    sent, taken = run(
        CHANGES,
        FAKE
        + """let taken = 0;
        const send = (k) => changes.send("materials", { wood: { stiffness_n_per_m: k } }).then(() => taken++);
        send(1); await turn();
        for (let k = 2; k <= 1000; k++) send(k);
        changes.send("materials", { steel: { damping_n_s_per_m: 1 } }).then(() => taken++);
        await turn();
        const first = sent().length;
        link.calls[0].resolve({ revision: 2 }); await turn();
        link.calls[1].resolve({ revision: 3 }); await turn();
        return [[first, ...sent()], taken]""",
    )
    assert sent == [
        1,
        {"wood": {"stiffness_n_per_m": 1}},
        {"wood": {"stiffness_n_per_m": 1000}, "steel": {"damping_n_s_per_m": 1}},
    ]
    assert taken == 1001


def test_a_refused_value_does_not_take_others_with_it(run: _Run) -> None:
    sent, outcome = run(
        CHANGES,
        FAKE
        + """const outcome = [];
        const settle = (name) => [() => outcome.push([name, "taken"]), (e) => outcome.push([name, e.problems])];
        changes.send("materials", { wood: { stiffness_n_per_m: -1 } }).then(...settle("wood"));
        changes.send("materials", { steel: { damping_n_s_per_m: 1 } }).then(...settle("steel"));
        await turn();
        const problem = { where: "materials.wood.stiffness_n_per_m", problem: "should be greater than or equal to 0" };
        link.calls[0].reject(Object.assign(new Error("no"), { code: -32602, data: [problem] }));
        await turn();
        link.calls[1].resolve({ revision: 2 });
        await turn();
        return [sent(), outcome]""",
    )
    assert sent[1] == {"steel": {"damping_n_s_per_m": 1}}
    assert outcome == [
        ["wood", [{"path": ["wood", "stiffness_n_per_m"], "problem": "should be greater than or equal to 0"}]],
        ["steel", "taken"],
    ]


def test_a_change_that_depends_on_the_one_before_waits_for_it(run: _Run) -> None:
    """This holds also if two are requested at once, and if the first change is refused."""
    sent = run(
        CHANGES,
        FAKE
        + """let stiffness = 1;
        const send = (k) => changes.send("materials", { wood: { stiffness_n_per_m: k } });
        const doubled = () => changes.afterAll(() => send(2 * stiffness)).then(() => {}, () => {});
        const answer = async (call, k) => { stiffness = k; link.calls[call].resolve({ revision: 2 }); await turn(); };
        doubled(); doubled(); await turn();
        await answer(0, 2);
        send(10); doubled(); await turn();
        await answer(1, 4); await answer(2, 10); doubled(); await turn();
        link.calls[3].reject(Object.assign(new Error("no"), { code: -32602, data: [] })); await turn();
        await answer(4, 20);
        return sent().map(({ wood }) => wood.stiffness_n_per_m)""",
    )
    assert sent == [2, 4, 10, 20, 20]


def test_a_step_is_sent_only_if_nobody_changed_what_it_changes(run: _Run) -> None:
    calls, changed = run(
        CHANGES,
        FAKE
        + """let changed = null;
        const patch = { wood: { stiffness_n_per_m: 800 } }, expected = { wood: { stiffness_n_per_m: 900 } };
        changes.sendIfStill("materials", patch, expected).catch((e) => (changed = e.departures));
        await turn();
        link.calls[0].resolve({ materials: { wood: { stiffness_n_per_m: 900 } }, revision: 7 }); await turn();
        const stale = Object.assign(new Error("stale"), { code: -32001 });
        link.calls[1].reject(stale); await turn();
        link.calls[2].resolve({ materials: { wood: { stiffness_n_per_m: 950 } }, revision: 8 }); await turn();
        return [link.calls.map(({ method, params }) => [method, params?.expect_revision ?? null]), changed]""",
    )
    assert calls == [["get_materials", None], ["update_materials", 7], ["get_materials", None]]
    assert changed == [{"path": ["wood", "stiffness_n_per_m"], "is": 950, "wanted": 900}]


# ---- Places at which the hand tries a material, and places of new objects ------------------------------------------

SCENE = {
    "objects": {
        "floor": {
            "kind": "wall",
            "point_m": [0.01, 0],
            "normal": [0, 1],
            "material": "wood",
            "patches": [{"from_m": -0.04, "to_m": -0.02, "material": "comb"}],
        },
        "peg": {"kind": "disc", "center_m": [0.03, 0.02], "radius_m": 0.008, "material": "steel"},
    }
}


@pytest.mark.parametrize(
    ("name", "object", "low", "high"),
    [("comb", "floor", -0.04, -0.02), ("wood", "floor", -0.02, 0.05), ("steel", "peg", -0.004, 0.004)],
)
def test_a_material_is_tried_where_it_is(run: _Run, name: str, object: str, low: float, high: float) -> None:
    spot = run({"t": "editor/try_it.js"}, "return t.spotOf(given[0], given[1])", [SCENE, name])
    assert spot["object"] == object
    inset = 0.1 * (high - low)
    assert (spot["from"], spot["to"]) == pytest.approx((low + inset, high - inset))


def test_a_material_that_no_object_has_is_tried_nowhere(run: _Run) -> None:
    assert run({"t": "editor/try_it.js"}, "return t.spotOf(given, 'glass')", SCENE) is None


@pytest.mark.parametrize("kind", ["wall", "box", "disc", "membrane"])
def test_a_new_object_touches_neither_the_handle_nor_others(run: _Run, kind: str) -> None:
    least = run(
        {"p": "editor/placement.js"},
        """const [objects, kind] = given, handle = [0, 0.02];
        let least = Infinity;
        const all = { ...objects };
        for (let i = 0; i < 4; i++) {
          const made = p.newObject(kind, { objects: all, handle, material: "wood" });
          least = Math.min(least, p.clearance(handle, made));
          const others = made.center_m ? Object.values(all) : [];
          least = Math.min(least, ...others.map((other) => p.clearance(made.center_m, other)));
          all[p.freeName(kind, Object.keys(all))] = made;
          if (kind === "wall") break;
        }
        return least""",
        [SCENE["objects"], kind],
    )
    assert least > 0.002


def test_names_are_free(run: _Run) -> None:
    names = run(
        {"p": "editor/placement.js"},
        "return [p.freeName('wall', []), p.freeName('wall', ['wall']), p.freeName('wall_2', ['wall', 'wall_2'])]",
    )
    assert names == ["wall", "wall_2", "wall_3"]


def test_right_angles_are_exact(run: _Run) -> None:
    body = "return [-2, -1, 0, 1, 2].map((turns) => f.unitVector((turns * Math.PI) / 2))"
    assert run({"f": "editor/fields.js"}, body) == [[-1, 0], [0, -1], [1, 0], [0, 1], [-1, 0]]


@pytest.mark.parametrize(
    ("margins", "kind", "words"),
    [
        ({"floor": 5.0, "other": 0.1}, "ok", "floor: 800 N/m. Limit: 4000 N/m, margin 5."),
        ({"floor": 0.5}, "warn", "floor: 800 N/m. Limit: 400 N/m, margin 0.5."),
        ({"floor": 0.0}, "warn", "floor: 800 N/m. No stiffness is proved to be safe."),
        ({"floor": None}, "ok", "floor: 800 N/m. No stiffness is too much."),
        ({}, "plain", "Stability: not known yet."),
    ],
)
def test_the_margin_as_text(run: _Run, margins: dict[str, Any], kind: str, words: str) -> None:
    materials = {"comb": {"stiffness_n_per_m": 800.0}}
    body = "return w.stabilityOf(given[0], given[1], given[2], 'comb')"
    found = run({"w": "editor/warnings.js"}, body, [margins, SCENE, materials])
    assert found["kind"] == kind and found["text"].startswith(words)


def test_without_a_handle_no_margin_is_known(run: _Run) -> None:
    found = run({"w": "editor/warnings.js"}, "return w.stabilityOf(undefined, given, {}, 'comb')", SCENE)
    assert found == {"kind": "plain", "text": "Stability: not known: device.handle is not given."}
