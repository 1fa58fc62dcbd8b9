"""Invalid numbers: in samples they latch a fault and zero force; in tables they are refused with their place."""

from __future__ import annotations

import numpy as np
import pytest

from hapticd import InvalidError, render, simulate
from hapticd.base.core import EventKind, Fault, Flag, Status, ffi, invalid_reason, lib
from tests.support.rig import FLOOR, SKIN, Rig, line, still


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("axis", [0, 1])
def test_bad_sample_latches_a_fault_and_the_force_is_zero_from_that_tick(bad: float, axis: int) -> None:
    rig = Rig({"w": FLOOR})
    rig.render(line(0.0005, 0.1, 100))  # touched and ringing
    path = still(0, -0.0005, 50)
    path[10, axis] = bad
    samples = rig.render(path)
    assert np.any(samples["force_n"][:10])
    assert not np.any(samples["force_n"][10:])
    assert np.all(np.isfinite(samples["position_m"]))
    assert np.all(np.isfinite(samples["velocity_m_per_s"]))
    assert samples["flags"][-1] & Flag.FAULT
    assert lib.hd_state_faults(rig.state) == Fault.NONFINITE
    (fault,) = rig.of(EventKind.FAULT)
    assert fault["code"] == Fault.NONFINITE
    lib.hd_state_enable(rig.state, 1)  # latched: enabling alone does not clear it
    assert not np.any(rig.render(still(0, -0.0005, 400))["force_n"])


def test_bad_velocity_latches_a_fault() -> None:
    rig = Rig({"w": FLOOR})
    velocity = np.zeros((5, 2))
    velocity[2, 0] = np.nan
    samples = rig.render(still(0, -0.001, 5), velocity=velocity)
    assert not np.any(samples["force_n"][2:])
    assert lib.hd_state_faults(rig.state) == Fault.NONFINITE


def test_overflow_inside_a_tick_latches_a_fault() -> None:
    rig = Rig({"w": FLOOR}, device={"max_speed_m_per_s": 1000})
    samples = rig.render([[0.0, -1e308]] * 3, velocity=np.zeros((3, 2)))
    assert np.all(np.isfinite(samples["force_n"]))
    assert np.hypot(*samples["force_n"].T).max() <= 8.9


def test_render_names_the_place_of_a_bad_position() -> None:
    path = still(0, 0, 20)
    path[17, 1] = np.nan
    with pytest.raises(InvalidError, match=r"position_m\[17\]: must be finite"):
        render({}, path)
    with pytest.raises(InvalidError, match=r"shape \(n, 2\)"):
        render({}, np.zeros(5))
    for rate in (1, 20_000, float("nan"), 999.9, 10_000.1):
        with pytest.raises(InvalidError, match="rate_hz"):
            render({}, still(0, 0, 2), rate_hz=rate)


COMB = {
    "stiffness_n_per_m": 800,
    "friction": {"coefficient": 0.2, "stiffness_n_per_m": 500},
    "texture": {"kind": "grooves", "display": "geometry", "spacing_m": 0.002, "width_m": 0.001, "depth_m": 1e-4},
}
GRIT = {
    "stiffness_n_per_m": 800,
    "texture": {"kind": "stochastic", "peak_hz": 250, "mean_hz": 310, "velocity_gain_per_s": 40},
}
# Slots follow the order of the objects: 0 wall, 1 membrane, 2 box, 3 disc. Materials: wood, cellophane, comb, grit.
OBJECTS = {
    "w": {**FLOOR, "patches": [{"from_m": 0.0, "to_m": 0.01, "material": "comb"}]},
    "skin": {**SKIN, "center_m": [0, 0.01]},
    "box": {"kind": "box", "center_m": [0.1, 0.1], "size_m": [0.01, 0.02], "material": "grit"},
    "disc": {"kind": "disc", "center_m": [-0.1, 0.1], "radius_m": 0.01, "material": "comb"},
}
FIELDS = [
    ("objects[0].point_m[1]", [np.nan, -np.inf, 1e300]),
    ("objects[0].normal[0]", [1.0, np.nan, np.inf]),
    ("objects[0].shape", [5, 2**32 - 1]),
    ("objects[0].material", [64, 2**32 - 1]),
    ("objects[0].piece_first", [64, 2**32 - 1]),
    ("objects[0].piece_count", [1, 64, 2**32 - 1]),
    ("objects[1].half_m[0]", [-1.0, 0.0, np.nan]),
    ("objects[1].piece_count", [2]),
    ("objects[2].half_m[1]", [-1.0, 0.0, np.nan]),
    ("objects[3].half_m[0]", [-1.0, 0.0, np.nan, 0.02]),
    ("pieces[1].from_m", [np.nan, np.inf, 0.02]),
    ("pieces[1].half_ramp_m", [-1.0, 0.0, np.nan, 0.02]),
    ("pieces[1].material", [64]),
    ("materials[0].stiffness_n_per_m", [-1.0, np.nan, np.inf, 1e300]),
    ("materials[0].damping_n_s_per_m", [-1.0, np.nan, np.inf]),
    ("materials[0].texture", [5, 2**32 - 1]),
    ("materials[0].tap.rotor_re", [1.5, np.nan, -np.inf]),
    ("materials[0].tap.decay_rate_per_s", [-1.0, np.nan, np.inf]),
    ("materials[0].tap.end_s", [-1.0, np.nan, np.inf]),
    ("materials[0].tap.force_per_unit", [-1.0, np.nan, np.inf]),
    ("materials[0].tap.peak", [-1.0, np.nan, np.inf]),
    ("materials[2].rupture_depth_m", [-1.0, np.nan]),
    ("materials[2].rupture.angular_frequency_rad_per_s", [-1.0, np.nan]),
    ("materials[1].friction_coefficient", [-1.0, np.nan]),
    ("materials[1].friction_stiffness_n_per_m", [-1.0, 0.0, np.nan]),
    ("materials[1].spacing_m", [-1.0, 0.0, np.nan, 1e-4]),
    ("materials[1].width_m", [-1.0, 0.0, np.nan, 0.01]),
    ("materials[1].depth_m", [-1.0, np.nan, np.inf]),
    ("materials[3].noise", [1, 2**32 - 1]),
    ("noises[0].order", [33, 2**32 - 1]),
    ("noises[0].speed_count", [0, 2**32 - 1]),
    ("noises[0].first", [64, 2**32 - 1]),
    ("noises[0].threshold_m_per_s", [-1.0, np.nan]),
    ("noises[0].force_per_unit", [-1.0, np.nan, np.inf]),
    ("numbers[3]", [1.0, -1.0, np.nan]),  # the first reflection coefficient
    ("period_s", [0.0, -1.0, np.nan, np.inf]),
    ("max_force_n", [-1.0, 0.0, np.nan, np.inf]),
    ("max_speed_m_per_s", [0.0, np.nan]),
    ("ramp_s", [0.0, np.nan, 1.0]),
    ("field.force_n[0]", [np.nan, np.inf]),
    ("field.stiffness_n_per_m", [np.nan]),
    ("display_force", [2]),
    ("passivity", [3]),
    ("report_age", [513]),
    ("brake_n_s_per_m", [-1.0, np.nan, np.inf]),
    ("handle_damping_n_s_per_m", [-1.0, np.nan]),
    ("handle_friction_n", [-1.0, np.nan]),
    ("material_count", [0, 1]),
    ("piece_count", [0, 2]),
    ("noise_count", [0]),
    ("number_count", [0, 3]),
    ("objects", [ffi.NULL]),
    ("materials", [ffi.NULL]),
    ("pieces", [ffi.NULL]),
    ("noises", [ffi.NULL]),
    ("numbers", [ffi.NULL]),
]


@pytest.mark.parametrize(("path", "values"), FIELDS)
def test_tables_that_break_their_contract_are_refused(path: str, values: list[object]) -> None:
    for value in values:
        rig = Rig(OBJECTS, materials={"comb": COMB, "grit": GRIT})
        world = ffi.gc(lib.hd_world_new(), lib.hd_world_free)
        assert lib.hd_world_load(world, rig.table) == Status.OK, invalid_reason()
        scope = {"table": rig.table, "value": value}
        exec(f"table.{path} = value", scope)
        assert lib.hd_world_load(world, rig.table) == Status.ERR_INVALID, (path, value)
        assert "\n" not in invalid_reason()
        assert len(invalid_reason()) > 10


def test_table_of_more_objects_than_the_state_has_room_for_is_refused() -> None:
    rig = Rig(OBJECTS, materials={"comb": COMB, "grit": GRIT})
    rig.state = ffi.gc(lib.hd_state_new(3), lib.hd_state_free)
    with pytest.raises(AssertionError, match="room for 3"):
        rig.render(np.zeros((1, 2)))


def test_runs_refuse_invalid_arguments_in_one_line() -> None:
    hand = [[0, 0, 0], [1, 0, 0]]
    calls = [
        (lambda: simulate({}, hand, "x"), "duration_s"),  # type: ignore[arg-type]
        (lambda: simulate({}, hand, True), "duration_s"),
        (lambda: simulate({}, hand, 1e-9), "duration_s"),
        (lambda: simulate({}, hand, float("inf")), "duration_s"),
        (lambda: simulate({}, [[0, 0, 0], [1, 0]]), "waypoints"),  # type: ignore[list-item]
        (lambda: simulate({}, [["a", 0, 0]]), "waypoints"),  # type: ignore[list-item]
        (lambda: simulate({}, {"waypoints": hand}, interpolation="linear"), "interpolation"),
        (lambda: render({}, [["1", "2"]]), "position_m"),
        (lambda: render({}, [[1j, 0]]), "position_m"),
        (lambda: render({}, [[10**400, 0]]), "position_m"),
        (lambda: render(None, hand), "a configuration must be"),  # type: ignore[arg-type]
        (lambda: render(1, hand), "a configuration must be"),  # type: ignore[arg-type]
    ]
    for call, words in calls:
        with pytest.raises(InvalidError, match=words) as caught:
            call()
        assert "\n" not in str(caught.value)
