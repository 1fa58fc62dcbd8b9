"""NaN, infinities and nonsense, in samples and in tables: zero force, latched, or refused by name."""

from __future__ import annotations

import numpy as np
import pytest

from hapticd import InvalidError, render, simulate
from hapticd.core import EventKind, Fault, Flag, Status, ffi, invalid_reason, lib
from tests.rig import FLOOR, SKIN, Rig, line, still


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


def test_render_refuses_bad_positions_by_place() -> None:
    path = still(0, 0, 20)
    path[17, 1] = np.nan
    with pytest.raises(InvalidError, match=r"position_m\[17\]: must be finite"):
        render({}, path)
    with pytest.raises(InvalidError, match=r"shape \(n, 2\)"):
        render({}, np.zeros(5))
    for rate in (1, 20_000, float("nan"), 999.9, 10_000.1):
        with pytest.raises(InvalidError, match="rate_hz"):
            render({}, still(0, 0, 2), rate_hz=rate)


FIELDS = [
    ("walls[0].surface.stiffness_n_per_m", [-1.0, np.nan, np.inf, 1e300]),
    ("walls[0].surface.damping_n_s_per_m", [-1.0, np.nan, np.inf]),
    ("walls[0].surface.point_m[1]", [np.nan, -np.inf, 1e300]),
    ("walls[0].surface.normal[0]", [1.0, np.nan, np.inf]),
    ("walls[0].tap.rotor_re", [1.5, np.nan, -np.inf]),
    ("walls[0].tap.decay_rate_per_s", [-1.0, np.nan, np.inf]),
    ("walls[0].tap.end_s", [-1.0, np.nan, np.inf]),
    ("walls[0].tap.force_per_unit", [-1.0, np.nan, np.inf]),
    ("walls[0].tap.peak", [2.0, np.nan]),
    ("walls[0].key.slot", [64, 2**32 - 1]),
    ("membranes[0].surface.half_width_m", [-1.0, np.nan]),
    ("membranes[0].surface.rupture_depth_m", [-1.0, np.nan]),
    ("membranes[0].rupture.angular_frequency_rad_per_s", [-1.0, np.nan]),
    ("membranes[0].key.slot", [0]),  # the wall's
    ("period_s", [0.0, -1.0, np.nan, np.inf]),
    ("max_force_n", [-1.0, 0.0, np.nan, np.inf]),
    ("max_speed_m_per_s", [0.0, np.nan]),
    ("ramp_s", [0.0, np.nan, 1.0]),
    ("field.force_n[0]", [np.nan, np.inf]),
    ("field.stiffness_n_per_m", [np.nan]),
    ("display_force", [2]),
    ("wall_count", [2**32 - 1]),
]


@pytest.mark.parametrize(("path", "values"), FIELDS)
def test_tables_that_break_their_contract_are_refused(path: str, values: list[float]) -> None:
    for value in values:
        rig = Rig({"w": FLOOR, "skin": {**SKIN, "center_m": [0, 0.01]}})
        scope = {"table": rig.table, "value": value}
        exec(f"table.{path} = value", scope)
        assert lib.hd_table_check(rig.table, 64) == Status.ERR_INVALID, (path, value)
        assert "\n" not in invalid_reason()
        assert len(invalid_reason()) > 10


def test_null_records_are_refused() -> None:
    rig = Rig({"w": FLOOR})
    rig.table.walls = ffi.NULL
    assert lib.hd_table_check(rig.table, 64) == Status.ERR_INVALID


def test_runs_refuse_what_they_cannot_take_in_one_line() -> None:
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
        (lambda: render(None, hand), "a configuration is"),  # type: ignore[arg-type]
        (lambda: render(1, hand), "a configuration is"),  # type: ignore[arg-type]
    ]
    for call, words in calls:
        with pytest.raises(InvalidError, match=words) as caught:
            call()
        assert "\n" not in str(caught.value)
