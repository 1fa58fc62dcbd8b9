"""The command socket: what is answered to parameters, and that nothing changes by mistake.

Bodies, envelopes and ids stand in tests/protocol/test_messages.py, and at the socket in tests/soak/fuzz_messages.py.
"""

from __future__ import annotations

import math
from typing import Any

import msgpack
import pytest

from tests.support.daemon_process import Daemon, Wire

FLOOR = {"kind": "wall", "point_m": [0.0, 0.0], "normal": [0.0, 1.0], "material": "wood"}


def wall(**changes: Any) -> dict[str, Any]:
    return {"objects": {"table": {**FLOOR, **changes}}}


BAD_PARAMS: dict[str, tuple[str, dict[str, Any], str | None]] = {
    "unknown key": ("get_status", {"x": 1}, "x"),
    "NaN": ("update_scene", wall(point_m=[math.nan, 0]), "objects.table.point_m[0]"),
    "unknown material": ("update_scene", wall(material="wod"), "objects.table.material"),
    "object that is none": ("update_scene", {"objects": {"table": 3}}, "objects.table"),
    "objects missing": ("update_scene", {}, "objects"),
    "scene of nothing": ("set_scene", {"scene": None}, "scene"),
    "scene with NaN": ("set_scene", {"scene": wall(normal=[math.nan, 1])}, "scene.objects.table.normal[0]"),
    "scene with unknown section": ("set_scene", {"scene": {"objectz": {}}}, "scene.objectz"),
    "negative stiffness": (
        "update_materials",
        {"materials": {"wood": {"stiffness_n_per_m": -1}}},
        "materials.wood.stiffness_n_per_m",
    ),
    "huge integer": (
        "update_materials",
        {"materials": {"wood": {"stiffness_n_per_m": 2**64 - 1}}},
        "materials.wood.stiffness_n_per_m",
    ),
    "a slope and a table": (
        "update_materials",
        {"materials": {"rubber": {"stiffness_n_per_m": 1}, "wood": {"tap": {"amplitudes": [[0.1, 2.0]]}}}},
        "materials.wood.tap",
    ),
    "revision a string": ("update_scene", {"objects": {}, "expect_revision": "1"}, "expect_revision"),
    "play without a mode": ("play", {"direction": [0, 1], "amplitude_m_per_s2": 1}, ""),
    "play nothing known": ("play", {"material": "x", "direction": [0, 1], "amplitude_m_per_s2": 1}, "material"),
    "reset of nobody": ("reset", {"objects": ["nobody"]}, "objects[0]"),
    "forces maybe": ("set_forces", {"enabled": "yes"}, "enabled"),
    "lease for ever": ("lease", {"duration_s": math.inf}, "duration_s"),
    "operator with nothing": ("set_operator", {}, None),
    "operator backwards": ("set_operator", {"waypoints": [[1, 0, 0], [0, 0, 0]]}, None),
}


@pytest.mark.parametrize(("method", "params", "where"), BAD_PARAMS.values(), ids=BAD_PARAMS.keys())
def test_bad_parameters_are_named_and_change_nothing(
    wire: Wire, method: str, params: dict[str, Any], where: str | None
) -> None:
    scene, materials = wire.result("get_scene"), wire.result("get_materials")
    error = wire.error(method, **params)
    assert error["code"] == -32602, error
    assert "\n" not in error["message"]
    assert error["data"], error
    assert all(set(fault) == {"where", "problem"} for fault in error["data"])
    if where is not None:
        assert where in [fault["where"] for fault in error["data"]]
    assert wire.result("get_scene") == scene
    assert wire.result("get_materials") == materials


def test_unknown_method(wire: Wire) -> None:
    error = wire.error("get_scen")
    assert error["code"] == -32601
    assert "get_scene" in error["message"]


def test_stale_revision_is_refused_and_changes_nothing(wire: Wire) -> None:
    before = wire.result("get_scene")
    error = wire.error("update_scene", objects={"x": FLOOR}, expect_revision=before["revision"] - 1)
    assert error["code"] == -32001
    assert wire.result("get_scene") == before
    revision = wire.result("update_scene", objects={"x": FLOOR}, expect_revision=before["revision"])["revision"]
    assert revision == before["revision"] + 1
    wire.result("update_scene", objects={"x": None})


def test_merge_patch_over_objects(wire: Wire) -> None:
    wire.result("set_scene", scene={"objects": {"a": FLOOR, "b": {"kind": "viscous", "damping_n_s_per_m": 1}}})
    wire.result(
        "update_scene", objects={"a": {"point_m": [0.0, 0.01]}, "b": None, "c": {"kind": "constant", "force_n": [0, 1]}}
    )
    objects = wire.result("get_scene")["scene"]["objects"]
    floor = {**FLOOR, "point_m": [0.0, 0.01], "patches": [], "patch_ramp_m": 0.001}  # defaults are filled in
    assert objects == {"a": floor, "c": {"kind": "constant", "force_n": [0.0, 1.0]}}
    scene = wire.result("get_scene")["scene"]
    wire.result("set_scene", scene=scene)
    assert wire.result("get_scene")["scene"] == scene


def test_materials_can_be_changed_added_and_removed_but_not_from_under_an_object(wire: Wire) -> None:
    wire.result(
        "update_materials", materials={"rubber": {"stiffness_n_per_m": 200}, "wood": {"stiffness_n_per_m": 900}}
    )
    wire.result("update_scene", objects={"r": {**FLOOR, "material": "rubber"}})
    materials = wire.result("get_materials")["materials"]
    assert materials["rubber"]["stiffness_n_per_m"] == 200
    assert materials["wood"]["stiffness_n_per_m"] == 900
    assert materials["wood"]["tap"]["frequency_hz"] == 67
    error = wire.error("update_materials", materials={"rubber": None})
    assert error["code"] == -32602
    wire.result("update_scene", objects={"r": None})
    wire.result("update_materials", materials={"rubber": None, "wood": None})
    materials = wire.result("get_materials")["materials"]
    assert "rubber" not in materials
    assert materials["wood"]["stiffness_n_per_m"] == 800


def test_wait_gives_the_first_tick_with_the_revision(daemon: Daemon, wire: Wire) -> None:
    before = wire.result("get_status")["tick"]
    answer = wire.result("update_scene", objects={"x": FLOOR}, wait=True)
    assert answer["tick"] >= before
    assert wire.result("get_status")["tick"] >= answer["tick"]
    later = wire.result("update_scene", objects={"x": None}, wait=True)
    assert later["tick"] > answer["tick"]


def test_notifications_are_carried_out_and_not_answered(wire: Wire) -> None:
    wire.socket.send(msgpack.packb({"jsonrpc": "2.0", "method": "update_scene", "params": {"objects": {"n": FLOOR}}}))
    wire.socket.send(msgpack.packb({"jsonrpc": "2.0", "method": "nonsense", "params": {}}))
    wire.socket.send(msgpack.packb({"jsonrpc": "2.0", "method": "get_status", "params": [1]}))
    assert "n" in wire.result("get_scene")["scene"]["objects"]
    wire.result("update_scene", objects={"n": None})


def test_play_and_reset_answer_with_their_tick(wire: Wire) -> None:
    first = wire.result("play", material="wood", direction=[0, 1], amplitude_m_per_s2=3)
    second = wire.result(
        "play", mode={"frequency_hz": 100, "decay_time_s": 0.01}, direction=[1, 1], amplitude_m_per_s2=3
    )
    assert second["tick"] > first["tick"]
    assert first["displayed_hz"] == pytest.approx(67)
    high = wire.result(
        "play", mode={"frequency_hz": 4500, "decay_time_s": 0.01}, direction=[1, 1], amplitude_m_per_s2=3
    )
    assert high["displayed_hz"] is None
    assert wire.result("reset")["tick"] >= second["tick"]


@pytest.mark.long
def test_ring_full_takes_nothing(wire: Wire) -> None:
    wire.result("set_scene", scene={"objects": {f"w{i}": {**FLOOR, "point_m": [0, -0.05]} for i in range(1000)}})
    assert "tick" in wire.result("reset", objects=[f"w{i}" for i in range(1000)])
    error = wire.error("reset", objects=[f"w{i}" for i in range(1000)] * 2)
    assert error["code"] in (-32005, -32602)
    wire.result("set_scene", scene={"objects": {"floor": FLOOR}})
