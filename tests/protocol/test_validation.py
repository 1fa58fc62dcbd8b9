"""All faults of a message are reported at once: those of scene and materials, and those of other parameters."""

from __future__ import annotations

from typing import Any

import pytest

from hapticd.config.configuration import load_config
from hapticd.daemon.engine import Engine
from hapticd.daemon.methods import Methods
from hapticd.daemon.refusal import MethodError

FLOOR = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "wood"}
SCENE = {"objects": {"floor": {**FLOOR, "point_m": [0]}, "ball": {"kind": "disk"}}}
SCENE_FAULTS = ["scene.objects.floor.point_m[1]", "scene.objects.ball.kind"]
MATERIALS = {"pine": {"stiffness_n_per_m": -1}}


@pytest.fixture(scope="module")
def methods() -> Methods:
    return Methods(Engine(load_config({"servo": {"rate_hz": 1000}, "scene": {"objects": {"floor": FLOOR}}})))


@pytest.mark.parametrize(
    ("method", "params", "places"),
    [
        ("set_scene", {"scene": SCENE, "wait": "yes"}, ["wait", *SCENE_FAULTS]),
        ("set_scene", {"scene": SCENE, "wate": True}, ["wate", *SCENE_FAULTS]),
        (
            "update_scene",
            {"objects": SCENE["objects"], "expect_revision": -1},
            ["expect_revision", "objects.floor.point_m[1]", "objects.ball.kind"],
        ),
        ("set_materials", {"materials": MATERIALS, "wait": 1}, ["wait", "materials.pine.stiffness_n_per_m"]),
        (
            "set_materials",
            {"materials": {**MATERIALS, "wood": None}},
            ["materials.wood", "materials.pine.stiffness_n_per_m"],
        ),
        ("update_materials", {"materials": MATERIALS, "wait": 1}, ["wait", "materials.pine.stiffness_n_per_m"]),
        (
            "apply",
            {"materials": MATERIALS, "scene": SCENE, "wait": 1},
            ["wait", "materials.pine.stiffness_n_per_m", *SCENE_FAULTS],
        ),
        (
            "apply",
            {"materials": 5, "scene": SCENE},
            ["materials", *SCENE_FAULTS],
        ),
        ("play", {"material": "pien", "direction": [0, 0], "amplitude_m_per_s2": 1}, ["material", "direction"]),
    ],
)
def test_every_fault_is_told_at_once(
    methods: Methods, method: str, params: dict[str, object], places: list[str]
) -> None:
    with pytest.raises(MethodError) as refused:
        methods.call(method, params)
    assert isinstance(refused.value.data, list)
    assert sorted(problem["where"] for problem in refused.value.data) == sorted(places)


@pytest.mark.parametrize("method", ["set_materials", "apply"])
def test_a_replaced_material_that_loses_a_part_is_reported(method: str) -> None:
    methods = Methods(Engine(load_config({"servo": {"rate_hz": 1000}})))
    soft = {"stiffness_n_per_m": 500}
    answer: Any = methods.call(method, {"materials": {"comb": soft, "pine": soft}})
    (lost,) = [warned for warned in answer["warnings"] if "no longer" in warned["problem"]]
    assert lost == {
        "where": "materials.comb",
        "problem": "no longer has the texture of the material that it replaces",
    }
    again: Any = methods.call(method, {"materials": {"comb": soft}})
    assert "warnings" not in again
