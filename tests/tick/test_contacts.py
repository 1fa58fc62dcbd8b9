"""Walls, membranes and fields: forces, onsets, punctures."""

from __future__ import annotations

import numpy as np
import pytest

from hapticd.base.core import EventKind, Flag, lib
from hapticd.config.materials import shipped_materials
from hapticd.protocol.events import event_map
from tests.support.rig import FLOOR, SKIN, Rig, line, still

RATE = 10_000


def test_wall_force_is_stiffness_and_damping_and_never_pulls() -> None:
    material = {"stiffness_n_per_m": 700.0, "damping_n_s_per_m": 4.0}
    normal = np.array([0.6, 0.8])
    wall = {"kind": "wall", "point_m": [0.01, -0.002], "normal": normal.tolist(), "material": "m"}
    rig = Rig({"w": wall}, materials={"m": material})
    t = np.arange(4000) / RATE
    depth = 0.003 * np.sin(40 * t) - 1e-4
    path = np.array([0.01, -0.002]) - depth[:, None] * normal
    speeds = -(0.003 * 40 * np.cos(40 * t))[:, None] * normal
    samples = rig.render(path, velocity=speeds)
    wanted = np.where(depth > 0, np.maximum(0.0, 700.0 * depth + 4.0 * 0.003 * 40 * np.cos(40 * t)), 0.0)
    assert np.allclose(samples["contact_force_n"], wanted[:, None] * normal, rtol=0, atol=1e-12)
    assert np.allclose(samples["force_n"], samples["contact_force_n"], rtol=0, atol=0)


def test_probe_that_starts_inside_comes_in_over_the_ramp_without_a_tap() -> None:
    rig = Rig({"w": FLOOR})
    samples = rig.render(still(0, -0.002, 400))
    ramp = np.minimum(np.arange(400) / 200, 1.0)
    assert np.allclose(samples["contact_force_n"][:, 1], 1.6 * ramp, rtol=0, atol=1e-12)
    assert not np.any(samples["vibration_force_n"])
    (contact,) = rig.of(EventKind.CONTACT)
    assert contact["code"] == 1
    assert contact["amplitude_m_per_s2"] == 0.0


def test_object_that_appears_around_the_probe_makes_no_tap() -> None:
    rig = Rig({})
    rig.render(line(-0.002, 0.05, 100))
    rig.update({"w": FLOOR})
    samples = rig.render(line(-0.0025, 0.05, 100))
    assert not np.any(samples["vibration_force_n"])
    assert samples["contact_force_n"][0, 1] == 0.0
    assert np.all(np.diff(samples["contact_force_n"][:, 1]) > 0)


def test_object_that_appears_in_the_tick_of_a_crossing_makes_no_tap() -> None:
    rig = Rig({})
    rig.render(still(0, 1e-6, 10))
    rig.update({"w": FLOOR})
    samples = rig.render(still(0, -1e-6, 10))
    assert not np.any(samples["vibration_force_n"])


def test_approach_at_zero_speed_is_silent() -> None:
    rig = Rig({"w": FLOOR})
    rig.render(still(0, 1e-6, 5), velocity=np.zeros((5, 2)))
    samples = rig.render(still(0, -1e-6, 50), velocity=np.zeros((50, 2)))
    assert not np.any(samples["vibration_force_n"])
    assert samples["contact_force_n"][0, 1] == pytest.approx(800e-6)


def test_jump_strikes_nothing_and_comes_in_over_the_ramp() -> None:
    rig = Rig({"w": FLOOR})
    rig.render(still(0, 0.05, 20))
    samples = rig.render(still(0, -0.05, 300))
    assert samples["flags"][0] & Flag.GLITCH
    assert not np.any(samples["vibration_force_n"])
    assert samples["contact_force_n"][0, 1] == 0.0
    steps = np.diff(samples["contact_force_n"][:, 1])
    assert steps.max() <= 40.0 / 200 * (1 + 1e-9)
    assert np.all(np.hypot(*samples["force_n"].T) <= 8.9)
    (glitch,) = rig.of(EventKind.GLITCH)
    assert glitch["value"] == pytest.approx(0.1 * RATE)
    assert np.all(samples["velocity_m_per_s"] == 0.0)


@pytest.mark.parametrize("rate_hz", [1000, 10_000])
@pytest.mark.parametrize("stiffness_n_per_m", [400, 1600])
def test_a_command_during_the_ramp_of_a_contact_makes_no_step(rate_hz: float, stiffness_n_per_m: float) -> None:
    """A contact after a jump ramps up. While it does, its material changes and changes back."""
    materials = {"first": {"stiffness_n_per_m": 800}, "second": {"stiffness_n_per_m": stiffness_n_per_m}}
    rig = Rig({"w": {**FLOOR, "material": "first"}}, rate_hz=rate_hz, materials=materials)
    ramp = round(0.02 * rate_hz)
    rig.render(still(0, 0.5, 10))
    forces = [rig.render(still(0, -0.003, ramp // 2))["force_n"]]
    for material, count in (("second", ramp // 4), ("first", 4 * ramp)):
        rig.update({"w": {**FLOOR, "material": material}})
        forces.append(rig.render(still(0, -0.003, count))["force_n"])
    force = np.concatenate(forces)[:, 1]
    changed = 0.003 * abs(stiffness_n_per_m - 800)  # N, at the most; two changes can overlap
    assert np.abs(np.diff(force)).max() <= (0.003 * max(800, stiffness_n_per_m) + 2 * changed) / ramp
    assert force[-1] == pytest.approx(2.4, rel=1e-12)


def test_missed_periods_advance_modes_by_the_time_that_passed() -> None:
    """A tick with 100 missed periods: what rings continues where the closed form is."""
    rig = Rig({"w": FLOOR})
    first = rig.render(line(0.0005, 0.05, 110))
    (contact,) = rig.of(EventKind.CONTACT)
    onset = contact["tick"] / RATE - contact["before_tick_s"]
    samples = rig.render(still(0, -0.00005, 3), velocity=np.zeros((3, 2)), periods=[101, 1, 1])
    mode = shipped_materials()["wood"].tap.mode  # type: ignore[union-attr]
    t = (len(first) + 100 + np.arange(3)) / RATE - onset
    closed = 0.05 * 309 * contact["speed_m_per_s"] * np.exp(-mode.decay_rate_per_s * t)
    closed *= np.sin(mode.angular_frequency_rad_per_s * t)
    assert np.allclose(samples["vibration_force_n"][:, 1], closed, rtol=0, atol=1e-12)
    assert samples["flags"][0] & Flag.SKIPPED
    assert not samples["flags"][1] & Flag.SKIPPED
    assert samples["time_ns"][0] - first["time_ns"][-1] == 101 * 100_000
    assert samples["tick"][0] - first["tick"][-1] == 1


def test_stall_longer_than_the_ramp_comes_in_over_the_ramp() -> None:
    rig = Rig({"w": FLOOR})
    rig.render(still(0, -0.002, 300))
    samples = rig.render(still(0, -0.002, 300), periods=[10_000] + [1] * 299)
    assert samples["contact_force_n"][0, 1] == 0.0
    assert np.diff(samples["contact_force_n"][:, 1]).max() <= 1.6 / 200 * (1 + 1e-9)
    assert not np.any(samples["vibration_force_n"])


def test_thousand_contacts_a_second_stay_bounded() -> None:
    rig = Rig({"w": FLOOR}, device={"effective_mass_kg": 0.05, "max_force_n": 3})
    t = np.arange(20_000) / RATE
    path = np.column_stack([np.zeros_like(t), 1e-4 * np.cos(2 * np.pi * 1000 * t + 0.1)])
    samples = rig.render(path)
    assert len(rig.of(EventKind.CONTACT)) == 2000
    force = np.hypot(*samples["force_n"].T)
    assert np.all(np.isfinite(force))
    assert force.max() <= 3.0
    rig.render(still(0, 0.01, 400))
    assert not np.any(rig.render(still(0, 0.01, 10))["force_n"])


def test_two_walls_in_an_acute_corner_add_up_and_stay_within_the_limit() -> None:
    angle = np.radians(5)
    walls = {
        "left": {**FLOOR, "normal": [np.cos(angle), np.sin(angle)]},
        "right": {**FLOOR, "normal": [-np.cos(angle), np.sin(angle)]},
    }
    rig = Rig(walls)
    rng = np.random.default_rng(3)
    path = np.cumsum(rng.normal(0, 2e-5, (20_000, 2)), axis=0) - [0, 0.002]
    samples = rig.render(path)
    assert np.all(np.isfinite(samples["force_n"]))
    assert np.hypot(*samples["force_n"].T).max() <= 8.9
    quiet = rig.render(still(0.0001, -0.003, 400), velocity=np.zeros((400, 2)))[-1]
    wanted = np.zeros(2)
    for sign in (1, -1):
        normal = np.array([sign * np.cos(angle), np.sin(angle)])
        wanted += 800 * max(0.0, -np.dot([0.0001, -0.003], normal)) * normal
    assert np.allclose(quiet["contact_force_n"], wanted, atol=1e-12)


def test_membrane_pushes_back_on_the_side_entered_and_ruptures() -> None:
    for side in (1, -1):
        rig = Rig({"skin": SKIN}, device={"effective_mass_kg": 0.05})
        speed = 0.0317
        t = np.arange(3000) / RATE
        depth = speed * (t - 0.0100371)
        samples = rig.render(np.column_stack([np.zeros_like(t), -side * depth]))
        (puncture,) = rig.of(EventKind.PUNCTURE)
        at = int(puncture["tick"])
        assert depth[at - 1] <= 0.004 < depth[at]
        assert depth[at] - 0.004 <= speed / RATE
        wanted = np.where((depth > 0) & (np.arange(3000) < at), 600 * depth, 0.0)
        assert np.allclose(samples["contact_force_n"][:, 1], side * wanted, rtol=0, atol=1e-12)
        since = t - (0.0100371 + 0.004 / speed)
        ringing = 0.05 * 38 * np.exp(-330 * since) * np.sin(1260 * since)
        ringing[(since < 0) | (since > 5 / 330)] = 0.0
        error = np.abs(samples["vibration_force_n"][:, 1] - side * ringing)
        assert error.max() <= 1e-6 * 0.05 * 38
        assert rig.kinds() == [EventKind.CONTACT, EventKind.PUNCTURE, EventKind.RELEASE]


def test_membrane_stays_open_until_reset_or_heals_on_withdrawal() -> None:
    for heals in (False, True):
        cellophane = shipped_materials()["cellophane"].to_dict()
        rupture = cellophane["rupture"]
        assert isinstance(rupture, dict)
        material = {**cellophane, "rupture": {**rupture, "heals": heals}}
        rig = Rig({"skin": {**SKIN, "material": "m"}}, materials={"m": material})
        rig.render(line(0.001, 0.1, 600))
        assert EventKind.PUNCTURE in rig.kinds()
        samples = rig.render(line(-0.05, -0.1, 700))  # further below, and back up: through the hole
        assert not np.any(samples["contact_force_n"])
        rig.render(line(0.02, 0.0, 2))
        again = rig.render(line(0.001, 0.1, 200))
        assert bool(np.any(again["contact_force_n"])) is heals
        if not heals:
            slot, _ = rig.compiler.slot_of("skin") or (None, None)
            assert slot is not None
            assert lib.hd_state_slot(rig.state, slot) & 2
            rig.render(line(0.02, 0.0, 2))
            _reset(rig)
            assert np.any(rig.render(line(0.001, 0.1, 200))["contact_force_n"])
            assert not lib.hd_state_slot(rig.state, slot) & 2


def _reset(rig: Rig) -> None:
    """What the command does, through the state: the object gets a new generation."""
    skin = rig.source["scene"]["objects"]["skin"]
    rig.update({"skin": None})
    rig.update({"skin": skin})
    rig.render(line(0.02, 0.0, 1))


def test_leaving_a_membrane_sideways_is_a_release() -> None:
    rig = Rig({"skin": SKIN})
    rig.render(line(0.001, 0.1, 291))
    assert rig.kinds() == [EventKind.CONTACT]
    path = np.column_stack([np.linspace(0, 0.012, 400), np.full(400, -0.0019)])
    samples = rig.render(path)
    assert rig.kinds() == [EventKind.RELEASE]
    assert np.all(samples["contact_force_n"][path[:, 0] > 0.01] == 0.0)
    rig.render(np.column_stack([np.linspace(0.012, 0, 400), np.full(400, -0.0019)]))
    assert rig.kinds() == []  # it came back below the skin: it did not enter through it


def test_touching_a_membrane_exactly_does_not_confuse_the_sides() -> None:
    """Quantised positions lie exactly on the skin; the side is where the probe was before."""
    rig = Rig({"skin": SKIN})
    heights = [2e-5, 0.0, -2e-5, -4e-5, 0.0, 2e-5, 0.0, 2e-5, 4e-5]
    samples = rig.render([[0.0, h] for h in heights])
    assert samples["contact_force_n"][:, 1] == pytest.approx([0, 0, 600 * 2e-5, 600 * 4e-5, 0, 0, 0, 0, 0], abs=1e-15)
    assert np.all(samples["contact_force_n"][:, 1] >= 0)


def test_fields_are_one_affine_law() -> None:
    objects = {
        "pull": {"kind": "spring", "center_m": [0.01, -0.02], "stiffness_n_per_m": 50, "damping_n_s_per_m": 0.5},
        "honey": {"kind": "viscous", "damping_n_s_per_m": 2},
        "push": {"kind": "constant", "force_n": [0.1, -0.2]},
    }
    rig = Rig(objects)
    rng = np.random.default_rng(1)
    path, speeds = rng.uniform(-0.03, 0.03, (500, 2)), rng.uniform(-0.1, 0.1, (500, 2))
    path = np.cumsum(path, axis=0) / 500
    samples = rig.render(path, velocity=speeds)
    wanted = -50 * (path - [0.01, -0.02]) - 2.5 * speeds + [0.1, -0.2]
    assert np.allclose(samples["contact_force_n"], wanted, rtol=0, atol=1e-13)


def test_display_flags_choose_force_vibration_or_both() -> None:
    for force, vibration in ((True, False), (False, True), (False, False)):
        rig = Rig({"w": FLOOR}, display={"force": force, "vibration": vibration})
        samples = rig.render(line(0.0005, 0.05, 400))
        assert bool(np.any(samples["contact_force_n"])) is force
        assert bool(np.any(samples["vibration_force_n"])) is vibration
    # The model's force counts for rupture even where it is not displayed.
    rig = Rig({"skin": SKIN}, display={"force": False, "vibration": True})
    rig.render(line(0.001, 0.1, 600))
    assert EventKind.PUNCTURE in rig.kinds()


def test_membrane_that_the_probe_left_during_a_stall_is_not_met() -> None:
    rig = Rig({"skin": SKIN})
    rig.render(line(0.001, 0.1, 201))
    samples = rig.render(still(0, -0.02, 10), periods=[500] + [1] * 9)
    assert not np.any(samples["contact_force_n"])


def test_open_membrane_whose_normal_is_turned_round_stays_open() -> None:
    cellophane = shipped_materials()["cellophane"].to_dict()
    rupture = cellophane["rupture"]
    assert isinstance(rupture, dict)
    heals = {**cellophane, "rupture": {**rupture, "heals": True}}
    rig = Rig({"skin": {**SKIN, "material": "m"}}, materials={"m": heals})
    rig.render(line(0.001, 0.1, 900))  # 8 mm through
    slot, _ = rig.compiler.slot_of("skin") or (0, 0)
    assert lib.hd_state_slot(rig.state, slot) == 2
    rig.update({"skin": {**SKIN, "material": "m", "normal": [0, -1]}})
    back = rig.render(line(-0.008, -0.05, 120))
    assert lib.hd_state_slot(rig.state, slot) == 2
    assert not np.any(back["contact_force_n"])
    rig.render(line(-0.0074, -0.05, 1600))
    assert lib.hd_state_slot(rig.state, slot) == 0  # it came out where it had gone in


def test_thousands_of_taps_in_one_tick_stay_within_the_limit_and_end() -> None:
    """More strikes than voices: two floors of 40 walls each here, the capacity is exercised in C."""
    walls = {f"w{i}": {**FLOOR, "point_m": [0, -1e-9 * i]} for i in range(60)}
    rig = Rig(walls)
    samples = rig.render(line(0.0005, 0.1, 60))
    assert np.hypot(*samples["force_n"].T).max() <= 8.9
    assert len(rig.of(EventKind.CONTACT)) == 60
    rig.render(still(0, 0.01, 400))
    assert not np.any(rig.render(still(0, 0.01, 5))["force_n"])


def test_the_limit_takes_nothing_from_a_strike_that_is_none() -> None:
    """Met without an onset, and a material without a tap: amplitude 0, scale 1."""
    silent = {"stiffness_n_per_m": 800}
    for rig, path in (
        (Rig({"w": FLOOR}), still(0, -0.002, 5)),
        (Rig({"w": {**FLOOR, "material": "silent"}}, materials={"silent": silent}), line(0.001, 0.1, 200)),
    ):
        rig.render(path)
        (contact,) = rig.of(EventKind.CONTACT)
        told = event_map(contact, "w")
        assert (told["amplitude_m_per_s2"], told["scale"]) == (0.0, 1.0)
    rig = Rig({"w": FLOOR})
    rig.render(line(0.001, 0.1, 200))
    (contact,) = rig.of(EventKind.CONTACT)
    contact["scale"] = 0.0  # the limit left nothing of a strike
    assert event_map(contact, "w")["scale"] == 0.0
