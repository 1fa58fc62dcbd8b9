"""Scenes that change under the hand: states survive, the force moves by no more than the ramp allows."""

from __future__ import annotations

import numpy as np
import pytest

from hapticd.core import EventKind, Flag, lib
from hapticd.materials import shipped_materials
from tests.rig import FLOOR, SKIN, Rig, line, still

RATE = 10_000
RAMP = 0.02


def steps(samples: np.ndarray, before: np.ndarray) -> float:
    force = np.concatenate([before[-1:], samples])["force_n"]
    return float(np.hypot(*np.diff(force, axis=0).T).max())


def pressed(objects: dict[str, object], depth: float = 0.002) -> tuple[Rig, np.ndarray]:
    rig = Rig(objects)
    before = rig.render(still(0, -depth, 400))
    assert before["contact_force_n"][-1, 1] == pytest.approx(800 * depth)
    return rig, before


@pytest.mark.parametrize(
    "change",
    [
        {"w": {**FLOOR, "material": "hard"}},
        {"w": {**FLOOR, "material": "soft"}},
        {"w": {**FLOOR, "point_m": [0, 0.003]}},
        {"w": {**FLOOR, "point_m": [0, -0.001]}},
        {"w": {**FLOOR, "normal": [1, 1]}},
        {"w": {**FLOOR, "normal": [0, -1]}},
        {"w": None},
        {"w": {**SKIN}},
        {"w": {"kind": "constant", "force_n": [1, 0]}},
        {"pull": {"kind": "spring", "center_m": [0.01, 0], "stiffness_n_per_m": 100}},
        {"other": {**FLOOR, "point_m": [0, 0.004]}},
    ],
)
def test_no_change_steps_the_force(change: dict[str, object]) -> None:
    rig, before = pressed({"w": FLOOR})
    rig.update(change, {"hard": {"stiffness_n_per_m": 3000}, "soft": {"stiffness_n_per_m": 100}})
    samples = rig.render(still(0, -0.002, 600))
    final = samples["force_n"][-1]
    largest = max(float(np.hypot(*final)), float(np.hypot(*before["force_n"][-1])))
    largest = max(largest, float(np.hypot(*samples["force_n"].T).max()))
    assert steps(samples, before) <= 2.5 * largest / (RAMP * RATE)
    assert not np.any(samples["vibration_force_n"])
    assert not samples["flags"][-1] & Flag.RAMPING


def test_changed_stiffness_comes_in_linearly() -> None:
    rig, _ = pressed({"w": FLOOR})
    rig.update({"w": {**FLOOR, "material": "hard"}}, {"hard": {"stiffness_n_per_m": 2000}})
    samples = rig.render(still(0, -0.002, 300))
    blend = np.minimum((np.arange(300) + 1) / (RAMP * RATE), 1.0)
    assert np.allclose(samples["contact_force_n"][:, 1], 0.002 * (800 + 1200 * blend), rtol=0, atol=1e-12)
    assert EventKind.RELEASE not in rig.kinds()


def test_display_flags_fade() -> None:
    rig, before = pressed({"w": FLOOR})
    rig.update({}, display={"force": False, "vibration": True})
    samples = rig.render(still(0, -0.002, 300))
    assert steps(samples, before) <= 1.6 / (RAMP * RATE) * (1 + 1e-9)
    assert not np.any(samples["force_n"][-1])


def test_ringing_contact_and_puncture_survive_updates() -> None:
    """An update every fifth tick (2000 a second) while a tap rings and a membrane is open."""
    objects: dict[str, object] = {"w": {**FLOOR, "point_m": [0, -0.01]}, "skin": SKIN}
    rig = Rig(objects, device={"effective_mass_kg": 0.05})
    rig.render(line(0.001, 0.1, 1099))  # through the skin (ruptures at 4 mm), ends just above the floor
    assert EventKind.PUNCTURE in rig.kinds()
    slot, _ = rig.compiler.slot_of("skin") or (0, 0)
    stretches, tapped = [], []
    for n in range(80):
        rig.update(
            {"w": {**FLOOR, "point_m": [0, -0.01], "material": ["wood", "wood2"][n % 2]}},
            {
                "wood2": {
                    "stiffness_n_per_m": 810,
                    "tap": {"attack_slope_per_s": 309, "frequency_hz": 67, "decay_time_s": 0.00648},
                }
            },
        )
        height = -0.0099 + 1e-5 - 0.1 * (5 * n + np.arange(5)) / RATE
        height = np.maximum(height, -0.0115)
        stretches.append(rig.render(np.column_stack([np.zeros(5), height])))
        tapped += list(rig.of(EventKind.CONTACT))
        assert lib.hd_state_slot(rig.state, slot) == 2
    samples = np.concatenate(stretches)
    (contact,) = tapped
    mode = shipped_materials()["wood"].tap.mode  # type: ignore[union-attr]
    onset = contact["tick"] / RATE - contact["before_tick_s"]
    since = samples["tick"] / RATE - onset
    a = 0.05 * 309 * contact["speed_m_per_s"]
    wave = a * np.exp(-mode.decay_rate_per_s * since) * np.sin(mode.angular_frequency_rad_per_s * since)
    wave[(since < 0) | (since > 5 / mode.decay_rate_per_s)] = 0
    ringing = samples["vibration_force_n"][:, 1] - wave
    rupture = since > 0.0155  # the puncture's own ringing is over by then
    assert np.allclose(ringing[rupture], 0, atol=1e-12)
    depth = np.maximum(0, -0.01 - samples["position_m"][:, 1])
    contact_force = samples["contact_force_n"][:, 1]
    assert np.all(contact_force >= 800 * depth - 1e-12)
    assert np.all(contact_force <= 810 * depth + 1e-12)


def test_slot_goes_to_another_object_and_nothing_of_the_first_remains() -> None:
    rig, before = pressed({"w": FLOOR})
    rig.update({"w": None})
    rig.update({"v": {**FLOOR, "point_m": [0, -0.01]}})
    samples = rig.render(still(0, -0.002, 400))
    assert rig.kinds() == [EventKind.RELEASE]
    assert steps(samples, before) <= 1.6 / (RAMP * RATE) * (1 + 1e-9)
    assert not np.any(samples["force_n"][-1])


def test_fading_out_and_coming_in() -> None:
    rig, before = pressed({"w": FLOOR})
    lib.hd_state_enable(rig.state, 0)
    out = rig.render(still(0, -0.002, 300))
    assert steps(out, before) <= 1.6 / (RAMP * RATE) * (1 + 1e-9)
    assert not np.any(out["force_n"][200:])
    assert np.all(out["contact_force_n"][:, 1] == pytest.approx(1.6))
    lib.hd_state_enable(rig.state, 1)
    again = rig.render(still(0, -0.002, 300))
    assert steps(again, out) <= 1.6 / (RAMP * RATE) * (1 + 1e-9)
    assert again["force_n"][-1, 1] == pytest.approx(1.6)
    assert not np.any(again["vibration_force_n"])


@pytest.mark.parametrize(("far", "degrees"), [(0.1, 30), (0.1, -30), (10.0, 10), (10.0, -10)])
def test_wall_described_anew_from_far_away_moves_as_little_as_it_does(far: float, degrees: float) -> None:
    """The point of a wall may be anywhere on it: what counts is where the surface is at the probe."""
    rig, before = pressed({"w": FLOOR})
    angle = np.radians(degrees)
    normal = np.array([np.sin(angle), np.cos(angle)])
    along = np.array([normal[1], -normal[0]])
    point = np.array([0, -0.002]) + 0.0015 * normal + far * along  # 1.5 mm deep afterwards
    rig.update({"w": {**FLOOR, "normal": normal.tolist(), "point_m": point.tolist()}})
    samples = rig.render(still(0, -0.002, 400))
    force = np.hypot(*samples["force_n"].T)
    assert force.max() <= 1.6 * (1 + 1e-9)
    assert force.min() >= 1.2 * (1 - 1e-9)
    assert steps(samples, before) <= 3 * 1.6 / (RAMP * RATE)
    assert samples["force_n"][-1] == pytest.approx(1.2 * normal, rel=1e-6)
    assert EventKind.RELEASE not in rig.kinds()


def test_ramps_that_begin_after_missed_periods_begin_at_their_beginning() -> None:
    """190 missed periods are no stall at 10 kHz, and no part of a ramp that begins after them either."""
    late = [190] + [1] * 399
    largest = 1.6 / (RAMP * RATE) * (1 + 1e-9)
    path = still(0, -0.002, 400)

    appears = Rig({})
    before = appears.render(still(0, -0.002, 10))
    appears.update({"w": FLOOR})
    samples = appears.render(path, periods=late)
    assert steps(samples, before) <= largest
    assert samples["force_n"][-1, 1] == pytest.approx(1.6)

    vanishes, before = pressed({"w": FLOOR})
    vanishes.update({"w": None})
    samples = vanishes.render(path, periods=late)
    assert steps(samples, before) <= largest
    assert samples["force_n"][-1, 1] == 0.0

    pushed = Rig({})
    before = pushed.render(still(0, 0, 10))
    pushed.update({"push": {"kind": "constant", "force_n": [0, 1.6]}})
    assert steps(pushed.render(still(0, 0, 400), periods=late), before) <= largest

    enabled, _ = pressed({"w": FLOOR})
    lib.hd_state_enable(enabled.state, 0)
    before = enabled.render(path)
    assert not np.any(before["force_n"][-1])
    lib.hd_state_enable(enabled.state, 1)
    assert steps(enabled.render(path, periods=late), before) <= largest


def test_fade_to_zero_is_due_by_the_clock() -> None:
    rig, _ = pressed({"w": FLOOR})
    lib.hd_state_enable(rig.state, 0)
    out = rig.render(still(0, -0.002, 30), periods=[10] * 30)
    assert not np.any(out["force_n"][20:])
    assert np.any(out["force_n"][18])


@pytest.mark.parametrize("kind", ["box", "disc", "membrane"])
def test_a_stall_in_which_the_slot_goes_to_another_object_leaves_no_contact(kind: str) -> None:
    """What was pressed before a stall is met from the same side after it; what has its slot by then is not."""
    rig, _ = pressed({"w": FLOOR})
    rig.update({"w": None})
    far: dict[str, object] = {"kind": kind, "center_m": [0, 0.05], "material": "wood"}
    far |= {"radius_m": 0.01} if kind == "disc" else {"size_m": [0.02, 0.02]} if kind == "box" else {}
    far |= {"normal": [0, 1], "width_m": 0.02} if kind == "membrane" else {}
    rig.update({"v": far})
    assert (rig.compiler.slot_of("v") or (1,))[0] == 0
    samples = rig.render(still(0, -0.002, 400), periods=[500] + [1] * 399)
    assert EventKind.CONTACT not in rig.kinds()
    assert not np.any(samples["force_n"])
    assert not np.any(samples["flags"] & Flag.CONTACT)
