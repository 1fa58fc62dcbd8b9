"""Which objects the handle cannot reach, and which hold it deep inside: against points of the objects themselves."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import hapticd
from hapticd.analysis.check import check
from hapticd.config.configuration import Config, load_config
from hapticd.daemon.engine import Engine
from hapticd.rendering.offline import render_run, simulate_run
from hapticd.rendering.placement import Reach, depth_m, holding, leaps_onto, placement_warnings, unreachable_problem

HALF_M = 0.075
REACH = Reach(HALF_M, 8.9, (0.0, 0.0))
WALL = {"kind": "wall", "normal": [0, 1], "material": "wood"}
SLIPPED = {**WALL, "point_m": [0, 10]}


def config_of(item: dict[str, Any], **more: Any) -> Config:
    return load_config({"scene": {"objects": {"it": item}, **more}})


def warned(item: dict[str, Any], **more: Any) -> list[str]:
    config = config_of(item, **more)
    found = list(placement_warnings(config.scene, config.materials, Reach.of(config)))
    assert [each.where for each in found] == ["scene.objects.it"] * len(found)
    return [each.problem for each in found]


def test_millimetres_as_metres_are_reported_with_the_position_in_metres() -> None:
    (problem,) = warned(SLIPPED)
    assert "the handle at rest, at [0, 0], is 10 m below its surface" in problem
    assert "8.9 N, as 800 N/m ask for 8000 N" in problem
    assert "if point_m is in mm, write [0, 0.01]" in problem
    (problem,) = warned({**WALL, "point_m": [0, -10]})
    assert "its surface cannot be reached: it is 9.925 m beyond the range of the handle, 0.075 m" in problem
    (problem,) = warned({"kind": "disc", "center_m": [8, 5], "radius_m": 2, "material": "wood"})
    assert "write [0.008, 0.005]" in problem
    (problem,) = warned({"kind": "spring", "center_m": [10, 0], "stiffness_n_per_m": 50})
    assert "10 m from its centre" in problem


@pytest.mark.parametrize(
    ("item", "is_reported"),
    [
        ({**WALL, "point_m": [0, 0.011]}, False),  # 8.8 N
        ({**WALL, "point_m": [0, 0.0112]}, True),  # 8.96 N
        ({**WALL, "point_m": [0, 0.0112], "normal": [0, -1]}, False),  # the other side
        ({**WALL, "point_m": [0, 0], "patches": [{"from_m": 0.01, "to_m": 0.02, "material": "steel"}]}, False),
        ({"kind": "disc", "center_m": [0, 0], "radius_m": 0.0112, "material": "wood"}, True),
        ({"kind": "disc", "center_m": [0, 0], "radius_m": 0.011, "material": "wood"}, False),
        ({"kind": "box", "center_m": [0, 0], "size_m": [0.1, 0.0223], "material": "wood"}, True),
        ({"kind": "box", "center_m": [0, 0], "size_m": [0.1, 0.0222], "material": "wood"}, False),
        ({"kind": "box", "center_m": [0.05, 0], "size_m": [0.1, 0.1], "material": "wood"}, False),  # at its face
        ({"kind": "membrane", "center_m": [0, 0], "normal": [0, 1], "width_m": 0.1, "material": "cellophane"}, False),
        ({"kind": "spring", "center_m": [0.07, 0], "stiffness_n_per_m": 254}, False),  # 17.78 N, twice 8.89
        ({"kind": "spring", "center_m": [0.07, 0], "stiffness_n_per_m": 255}, True),  # 17.85 N, twice 8.93
    ],
)
def test_deep_is_what_asks_for_more_than_the_device_can(item: dict[str, Any], is_reported: bool) -> None:
    assert len(warned(item)) == is_reported
    assert warned(item, display={"force": False}) == []


def test_the_stiffness_is_that_of_the_patch_at_the_handle() -> None:
    patched = {**WALL, "point_m": [0, 0.02], "patches": [{"from_m": -0.01, "to_m": 0.01, "material": "soft"}]}
    source = {"materials": {"soft": {"stiffness_n_per_m": 100}}, "scene": {"objects": {"it": patched}}}
    config = load_config(source)
    for x, held in ((0.0, set()), (0.02, {"it"}), (-0.02, {"it"})):
        assert holding(config.scene, config.scene.objects, config.materials, REACH, (x, 0.0)) == held


def points_of(item: dict[str, Any], random: np.random.Generator) -> npt.NDArray[np.float64]:
    """Return points of an object, close together."""
    if item["kind"] == "disc":
        radius = item["radius_m"] * np.sqrt(random.random(40_000))
        angle = random.uniform(0, 2 * np.pi, 40_000)
        offsets = np.column_stack((radius * np.cos(angle), radius * np.sin(angle)))
    else:
        size = item["size_m"] if item["kind"] == "box" else (item["width_m"], 0.0)
        offsets = np.array(size) * random.uniform(-0.5, 0.5, (40_000, 2))
        along = item["angle_rad"] if item["kind"] == "box" else math.atan2(-item["normal"][0], item["normal"][1])
        cos, sin = math.cos(along), math.sin(along)
        offsets = offsets @ np.array([[cos, sin], [-sin, cos]])
    return offsets + item["center_m"]  # type: ignore[no-any-return]


@pytest.mark.parametrize("kind", ["box", "disc", "membrane"])
def test_an_object_is_out_of_reach_if_none_of_its_points_is_in_it(kind: str) -> None:
    random = np.random.default_rng(36)
    outcomes = set()
    for _ in range(40):
        item: dict[str, Any] = {"kind": kind, "center_m": random.uniform(-0.2, 0.2, 2).tolist(), "material": "wood"}
        if kind == "box":
            item |= {"size_m": random.uniform(0.01, 0.2, 2).tolist(), "angle_rad": random.uniform(-3, 3)}
        elif kind == "disc":
            item["radius_m"] = random.uniform(0.005, 0.1)
        else:
            item |= {"normal": random.normal(size=2).tolist(), "width_m": random.uniform(0.01, 0.2)}
        outside = np.abs(points_of(item, random)).max(axis=1) - HALF_M
        if abs(outside.min()) < 0.004:
            continue  # too close for these points
        parsed = config_of(item).scene.objects["it"]
        assert (unreachable_problem(parsed, REACH) is not None) == bool(outside.min() > 0)
        outcomes.add(bool(outside.min() > 0))
    assert outcomes == {True, False}


def test_the_depth_is_that_of_the_rendered_contact() -> None:
    """The core's force, over the stiffness, for a probe that came in through a face of a turned box."""
    box = {"kind": "box", "center_m": [0.01, -0.02], "size_m": [0.06, 0.04], "angle_rad": 0.3, "material": "soft"}
    config = load_config({"materials": {"soft": {"stiffness_n_per_m": 100}}, "scene": {"objects": {"it": box}}})
    path = np.column_stack((np.full(1000, 0.0), np.linspace(0.03, -0.004, 1000)))
    force_n = np.hypot(*render_run(config, path).samples["force_n"][-1])
    assert depth_m(config.scene.objects["it"], (0.0, -0.004)) == pytest.approx(force_n / 100, rel=1e-3)


def test_a_kept_object_that_comes_a_short_way_has_moved() -> None:
    old, near, far = (config_of({**WALL, "point_m": [0, y]}).scene.objects["it"] for y in (-0.001, 0.017, 0.019))
    disc = config_of({"kind": "disc", "center_m": [0, 0], "radius_m": 0.02, "material": "wood"}).scene.objects["it"]
    assert not leaps_onto(near, old, REACH, (0.0, 0.0))
    assert leaps_onto(far, old, REACH, (0.0, 0.0))
    assert not leaps_onto(far, far, REACH, (0.0, 0.0))
    assert leaps_onto(near, None, REACH, (0.0, 0.0))
    assert leaps_onto(disc, near, REACH, (0.0, 0.0))


def test_the_reach_is_that_of_the_device() -> None:
    hid = load_config({"device": {"kind": "hid", "max_force_n": 5, "hid": {"travel_m": 0.05}}})
    assert Reach.of(hid) == (0.05, 5, (0, 0))
    weak = load_config({"device": {"sim": {"max_force_n": 3, "workspace_m": 0.1, "start_m": [0.01, 0]}}})
    assert Reach.of(weak) == (0.1, 3, (0.01, 0))


def test_check_simulate_and_the_status_report_the_slip() -> None:
    source = {"servo": {"rate_hz": 1000}, "scene": {"objects": {"it": SLIPPED}}}
    (warning,) = check(load_config(source)).warnings
    assert warning.where == "scene.objects.it"
    assert Engine(load_config(source)).limits()[1] == [warning]
    run = simulate_run(source, [[0, 0, 0], [0.01, 0, 0]])
    assert [each.problem for each in run.implausible] == [warning.problem]
    assert run.implausible[0] in run.warnings
    with pytest.warns(hapticd.ImplausibleValue, match="10 m below its surface") as caught:
        hapticd.simulate(source, [[0, 0, 0], [0.01, 0, 0]])
    assert [each.filename for each in caught] == [__file__]


def test_the_status_says_that_a_scene_displays_no_force() -> None:
    (warning,) = Engine(load_config({"scene": {"display": {"force": False}}})).limits()[1]
    assert str(warning) == "scene.display.force: false: contacts and fields exert no force"
    assert Engine(load_config({"scene": {}})).limits()[1] == []


def test_a_path_in_millimetres_is_reported() -> None:
    scene = {"scene": {"objects": {"it": {**WALL, "point_m": [0, 0]}}}}
    with pytest.warns(hapticd.ImplausibleValue, match="position_m: has positions of up to 8 m.*divide them by 1000"):
        hapticd.render(scene, [[0, 8], [0, -8]])
    with pytest.warns(hapticd.ImplausibleValue, match="waypoints: has positions of up to 8 m"):
        hapticd.simulate(scene, [[0, 0, 0.02], [0.01, 0, 8]], rate_hz=1000)
    hapticd.render(scene, [[0, 0.7], [0, -0.7]])


def test_a_constant_force_above_the_device_is_reported() -> None:
    (problem,) = warned({"kind": "constant", "force_n": [0, -50]})
    assert problem == "asks for 50 N, and the device exerts at most 8.9 N"
    assert warned({"kind": "constant", "force_n": [0, -5]}) == []
