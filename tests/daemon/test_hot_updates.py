"""Scenes that change under the hand: states survive, and the force changes no faster than the ramp."""

from __future__ import annotations

import numpy as np
import pytest

from hapticd.base.core import EventKind, Flag, lib
from hapticd.config.configuration import load_config
from hapticd.config.materials import shipped_materials
from hapticd.daemon.reload import needing_restart
from tests.support.rig import FLOOR, SKIN, Rig, line, still

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
    wave[(since < 0) | (since > 5 / mode.decay_rate_per_s * (1 + 1e-12))] = 0  # wood: an integer number of ticks
    ringing = samples["vibration_force_n"][:, 1] - wave
    rupture = since > 0.0155  # the ringing of the puncture has ended by then
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
    """The point of a wall may be anywhere on the wall: only the surface at the probe matters."""
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
    """190 missed periods at 10 kHz are not a stall, and do not shorten a ramp that begins after them."""
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


@pytest.mark.parametrize("every", [2, 5, 20, 50])
def test_the_ramp_of_a_contact_after_a_stall_and_that_of_commands_add_up(every: int) -> None:
    """After the stall the wall is moved by 10 um, up or down, once in `every` ticks. Neither ramp is steeper than one
    ramp of the entire force, so their sum stays below two."""
    rig, _ = pressed({"w": FLOOR})
    before = rig.render(still(0, -0.002, 1), periods=[500])
    assert before["contact_force_n"][-1, 1] == 0.0
    batches = []
    for n in range(800 // every):
        rig.update({"w": {**FLOOR, "point_m": [0, 1e-5 * (n % 2)]}})
        batches.append(rig.render(still(0, -0.002, every)))
    samples = np.concatenate(batches)
    one_ramp = 800 * (0.002 + 1e-5) / (RAMP * RATE)
    assert one_ramp < steps(samples, before) < 2 * one_ramp
    assert rig.render(still(0, -0.002, 201))["contact_force_n"][-1, 1] == pytest.approx(1.608)


def test_fade_to_zero_is_due_by_the_clock() -> None:
    rig, _ = pressed({"w": FLOOR})
    lib.hd_state_enable(rig.state, 0)
    out = rig.render(still(0, -0.002, 30), periods=[10] * 30)
    assert not np.any(out["force_n"][20:])
    assert np.any(out["force_n"][18])


@pytest.mark.parametrize("kind", ["box", "disc", "membrane"])
def test_a_stall_in_which_the_slot_goes_to_another_object_leaves_no_contact(kind: str) -> None:
    """After a stall a pressed object is touched from the same side; another object in its slot is not."""
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


# ---- One rule: no command moves the limited force faster than max_force_n / ramp_s -----------------------------------

PACE = 8.9 / (RAMP * RATE) * (1 + 1e-9)
FIRM = {
    "soft": {"stiffness_n_per_m": 300},
    "firm": {"stiffness_n_per_m": 400},
    "hard": {"stiffness_n_per_m": 1000},
    "comb": {
        "stiffness_n_per_m": 1000,
        "texture": {"kind": "grooves", "display": "geometry", "spacing_m": 0.002, "width_m": 0.001, "depth_m": 0.0005},
    },
}
BETWEEN: dict[str, dict[str, object]] = {
    "membrane": {**SKIN, "center_m": [0, -0.001], "material": "hard"},
    "box": {"kind": "box", "center_m": [0, -0.002], "size_m": [0.02, 0.001], "material": "hard"},
    "disc": {"kind": "disc", "center_m": [0, -0.002], "radius_m": 0.001, "material": "hard"},
}


@pytest.mark.parametrize("kind", BETWEEN)
@pytest.mark.parametrize("where", ["new", "moved there"])
@pytest.mark.parametrize("sliding_m_per_s", [0.0, 0.05])
def test_what_comes_between_a_pressed_surface_and_the_hand(kind: str, where: str, sliding_m_per_s: float) -> None:
    item = BETWEEN[kind]
    wall = {**FLOOR, "material": "soft"}
    before_it = {"w": wall} if where == "new" else {"w": wall, "it": {**item, "center_m": [0.1, -0.002]}}
    rig = Rig(before_it, materials=FIRM)
    path = still(0, -0.006, 1000)
    path[:, 0] = sliding_m_per_s * (np.arange(1000) - 400) / RATE / 10
    before = rig.render(path[:400])
    rig.update({"it": item})
    samples = rig.render(path[400:])
    (contact,) = rig.of(EventKind.CONTACT)
    assert contact["code"] == 1  # it appeared: no tap
    assert steps(samples, before) <= PACE
    assert not np.any(samples["vibration_force_n"])
    assert samples["contact_force_n"][0, 1] == pytest.approx(1.8)
    assert samples["force_n"][-1, 1] > 6.2


def test_a_hand_that_flies_into_what_has_just_appeared_is_tapped() -> None:
    rig = Rig({}, device={"effective_mass_kg": 0.05})
    rig.render(line(0.001, 0.1, 50))
    rig.update({"w": {**FLOOR, "point_m": [0, 0.0003]}})
    samples = rig.render(line(0.0005, 0.1, 100))
    (contact,) = rig.of(EventKind.CONTACT)
    assert contact["code"] == 0 and contact["amplitude_m_per_s2"] == pytest.approx(30.9, rel=0.01)
    depth = np.maximum(0, 0.0003 - samples["position_m"][:, 1])
    assert np.allclose(samples["contact_force_n"][:, 1], 800 * depth)


def test_a_membrane_that_appears_beyond_its_rupture_depth_is_punctured_at_once() -> None:
    rig = Rig({"w": {**FLOOR, "material": "soft"}}, materials=FIRM, device={"effective_mass_kg": 0.05})
    before = rig.render(still(0, -0.006, 400))
    rig.update({"it": {**SKIN, "center_m": [0, -0.001]}})  # ruptures at 4 mm
    samples = rig.render(still(0, -0.006, 600))
    assert rig.kinds() == [EventKind.CONTACT, EventKind.PUNCTURE, EventKind.RELEASE]
    assert rig.events["code"][0] == 1 and rig.events["tick"].tolist() == [rig.events["tick"][0]] * 3
    assert np.array_equal(samples["contact_force_n"], np.tile(before["contact_force_n"][-1], (600, 1)))
    assert not np.any(samples["vibration_force_n"][0]) and np.any(samples["vibration_force_n"][1:200])


@pytest.mark.parametrize("way_m", [0.01, -0.0093, 0.0047])
@pytest.mark.parametrize("kind", ["patched", "grooved"])
def test_a_wall_that_is_moved_along_itself_throws_nobody(kind: str, way_m: float) -> None:
    wall: dict[str, object] = {**FLOOR, "material": "comb"}
    if kind == "patched":
        patches = [{"from_m": 0.005, "to_m": 0.015, "material": "hard"}]
        wall = {**FLOOR, "material": "firm", "patches": patches}
    rig = Rig({"w": wall}, materials=FIRM)
    before = rig.render(still(0, -0.005, 400))
    rig.update({"w": {**wall, "point_m": [-way_m, 0]}})
    samples = rig.render(still(0, -0.005, 400))
    assert steps(samples, before) <= PACE
    # The force goes from the old value to the new one, monotonically.
    blend = np.minimum((np.arange(400) + 1) / (RAMP * RATE), 1.0)[:, None]
    first, last = before["force_n"][-1], samples["force_n"][-1]
    assert np.allclose(samples["force_n"], first + blend * (last - first), rtol=0, atol=1e-12)
    assert rig.kinds() == []


@pytest.mark.parametrize(
    ("objects", "change"),
    [
        ({"w": FLOOR}, {"w": {**FLOOR, "point_m": [0, 1]}}),
        ({"w": FLOOR}, {"ceiling": {**FLOOR, "point_m": [0, -1], "normal": [0, -1]}}),
        ({"w": FLOOR}, {"it": {"kind": "box", "center_m": [0, 0], "size_m": [1, 1], "material": "wood"}}),
        ({}, {"it": {"kind": "spring", "center_m": [6, 8], "stiffness_n_per_m": 100}}),
        (
            {"it": {"kind": "spring", "center_m": [6, 8], "stiffness_n_per_m": 100}},
            {"it": {"kind": "spring", "center_m": [-6, -8], "stiffness_n_per_m": 100}},
        ),
        ({"w": {**FLOOR, "point_m": [0, 1]}}, {"w": None}),
    ],
)
def test_the_limited_force_takes_the_ramp_however_much_is_wanted(
    objects: dict[str, object], change: dict[str, object]
) -> None:
    rig = Rig(objects)
    before = rig.render(still(0, -0.002, 600))
    rig.update(change)
    samples = rig.render(still(0, -0.002, 600))
    change_n = float(np.hypot(*(samples["force_n"][-1] - before["force_n"][-1])))
    assert steps(samples, before) <= PACE
    ramp = np.hypot(*(samples["force_n"] - before["force_n"][-1]).T)
    assert change_n > 5 and ramp[99] <= 0.51 * change_n and ramp[499] == pytest.approx(change_n)


def test_the_display_of_a_force_beyond_the_limit_takes_the_ramp() -> None:
    rig = Rig({"w": {**FLOOR, "point_m": [0, 1]}})
    before = rig.render(still(0, -0.002, 600))
    rig.update({}, display={"force": False, "vibration": True})
    off = rig.render(still(0, -0.002, 400))
    rig.update({}, display={"force": True, "vibration": True})
    on = rig.render(still(0, -0.002, 400))
    assert steps(off, before) <= PACE and steps(on, off) <= PACE
    assert not np.any(off["force_n"][-1]) and on["force_n"][-1, 1] == pytest.approx(8.9)


def test_a_hand_that_leaves_a_wall_that_became_stiffer_is_not_held() -> None:
    """The hand is 2 mm deep in a wall that now exerts 4 N, and leaves the wall within the ramp."""
    rig, before = pressed({"w": FLOOR})
    rig.update({"w": {**FLOOR, "material": "hard"}}, {"hard": {"stiffness_n_per_m": 2000}})
    samples = rig.render(line(-0.002, -0.2, 150))
    assert np.all(samples["force_n"][:, 1] >= 0)
    assert not np.any(samples["force_n"][samples["position_m"][:, 1] > 0])
    assert samples["force_n"][:, 1].max() <= before["force_n"][-1, 1] + PACE


def test_contact_with_what_was_there_is_as_fast_as_ever_while_a_change_comes_in() -> None:
    scene = {"w": FLOOR, "pull": {"kind": "constant", "force_n": [0, 0]}}
    plain, changed = Rig(scene), Rig(scene)
    down = np.concatenate([line(0.001, 0.1, 200), line(-0.0009, -0.1, 200)])
    reference = plain.render(down)
    changed.render(down[:50])
    changed.update({"pull": {"kind": "constant", "force_n": [0.5, 0]}})
    samples = changed.render(down[50:])
    assert np.allclose(samples["force_n"][:, 1], reference["force_n"][50:, 1], rtol=0, atol=1e-12)
    ramp = np.minimum((np.arange(350) + 1) / (RAMP * RATE), 1.0)
    assert np.allclose(samples["contact_force_n"][:, 0], 0.5 * ramp, rtol=0, atol=1e-12)


def test_a_reset_while_forces_are_off_leaves_the_force_of_the_model_as_it_is() -> None:
    rig, _ = pressed({"w": FLOOR})
    lib.hd_state_enable(rig.state, 0)
    rig.render(still(0, -0.002, 300))
    lib.hd_state_reset(rig.state, lib.HD_NO_SLOT, 0, 0)
    samples = rig.render(still(0, -0.002, 300))
    assert np.all(samples["contact_force_n"][:, 1] == pytest.approx(1.6))
    assert not np.any(samples["force_n"])


def test_a_reset_under_the_hand_is_not_felt() -> None:
    rig, before = pressed({"w": FLOOR})
    lib.hd_state_reset(rig.state, lib.HD_NO_SLOT, 0, 0)
    samples = rig.render(still(0, -0.002, 300))
    assert rig.kinds() == [EventKind.RELEASE, EventKind.CONTACT]
    assert np.allclose(samples["force_n"][:, 1], before["force_n"][-1, 1], rtol=0, atol=1e-12)


SANDPAPER = {"kind": "stochastic", "peak_hz": 200, "mean_hz": 260, "velocity_gain_per_s": 100}


def test_the_noise_of_a_changed_material_comes_in_by_its_gain() -> None:
    """Compared with the noise at full level, the fraction grows by a two hundredth in each tick."""
    rough = {"stiffness_n_per_m": 800, "texture": SANDPAPER}
    path = still(0, -0.002, 2000)
    path[:, 0] = 0.1 * np.arange(2000) / RATE
    rig = Rig({"w": FLOOR}, materials={"rough": rough}, device={"effective_mass_kg": 0.05})
    rig.render(path[:400])
    rig.update({"w": {**FLOOR, "material": "rough"}})
    noise = rig.render(path[400:])["vibration_force_n"][:, 0]
    level = np.sqrt(np.mean(noise[400:] ** 2))
    assert level > 0.1
    assert abs(noise[0]) < 5 * level / 200
    assert np.sqrt(np.mean(noise[:50] ** 2)) < 0.25 * level


@pytest.mark.parametrize("down_m", [0.003, 0.03, 0.001])
def test_a_wall_that_is_moved_away_under_a_stroking_hand_strikes_no_groove(down_m: float) -> None:
    comb = {
        "stiffness_n_per_m": 800,
        "texture": {
            "kind": "grooves",
            "display": "vibration",
            "spacing_m": 0.002,
            "width_m": 0.0005,
            "velocity_gain_per_s": 1.2e3,
            "force_gain_m_per_s2_per_n": 63.4,
            "frequency_hz": 200,
            "decay_time_s": 0.005,
        },
    }
    rig = Rig({"w": {**FLOOR, "material": "comb"}}, materials={"comb": comb}, device={"effective_mass_kg": 0.01})
    path = still(0, -0.002, 500)
    path[:, 0] = 0.0001 + 0.1 * np.arange(500) / RATE
    rig.render(path[:100])
    rig.update({"w": {**FLOOR, "material": "comb", "point_m": [0.0137, -down_m]}})
    rig.render(path[100:110])
    assert EventKind.GROOVE not in rig.kinds()


def test_what_a_change_left_fades_although_a_reset_comes_in_every_tick() -> None:
    rig = Rig({"w": FLOOR, "side": {**FLOOR, "normal": [1, 0], "point_m": [0.001, 0]}}, rate_hz=1000)
    rig.render(still(0, -0.002, 60))
    rig.update({"w": None})
    forces = []
    for _ in range(200):
        lib.hd_state_reset(rig.state, lib.HD_NO_SLOT, 0, 0)
        forces.append(rig.render(still(0, -0.002, 1))["force_n"][0])
    force = np.array(forces)
    assert force[0] == pytest.approx([0.8, 1.6]) and np.all(np.diff(force[:, 1]) <= 0)
    assert np.allclose(force[:, 0], 0.8) and force[-1, 1] < 0.01


@pytest.mark.parametrize(
    "other",
    [
        {"device": {"max_force_n": 5.0}},
        {"device": {"max_speed_m_per_s": 1.0}},
        {"device": {"undisplayable": "lower"}},
        {"device": {"effective_mass_kg": 0.5}},
        {"device": {"compensation": "mass"}},
        {"device": {"handle": {"mass_kg": 0.1, "damping_n_s_per_m": 0.1, "friction_n": 0.1}}},
        {"device": {"sim": {"encoder_step_m": 0.0}}},
        {"device": {"sim": {"link": {"rate_hz": 1000}}}},
        {"device": {"sim": {"hand": {"stiffness_n_per_m": 100.0}}}},
        {"device": {"hid": {"offload": "auto"}}},
        {"servo": {"rate_hz": 5000.0}},
        {"servo": {"overruns": {"action": "step_down"}}},
    ],
)
def test_what_else_could_move_the_force_needs_a_restart(other: dict[str, object]) -> None:
    """Of a configuration, only scene and materials can be changed."""
    before, after = load_config({}), load_config(other)
    assert before != after
    assert needing_restart(before, after)


@pytest.mark.parametrize("modes", [("off", "control"), ("control", "off"), ("observe", "control")])
def test_the_passivity_controller_comes_and_goes_over_the_ramp(modes: tuple[str, str]) -> None:
    """A released wall would give energy; a controller that begins at that moment prevents this."""
    rig = Rig({"w": FLOOR}, passivity=modes[0])
    speed = -0.01
    before = rig.render(np.concatenate([still(0, -0.004, 400), line(-0.004, speed, 50)]))
    rig.update({}, passivity=modes[1])
    after = rig.render(line(before["position_m"][-1, 1], speed, 400)[1:])
    own = 800 * -speed / RATE
    assert steps(after, before) <= 8.9 / RAMP / RATE + own + 1e-9
    if modes == ("off", "control"):
        assert after["flags"][-1] & Flag.RESTRAINED
        assert after["force_n"][-1, 1] < 0.1
