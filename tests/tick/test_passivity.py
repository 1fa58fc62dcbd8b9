"""The energy that touched objects give to the hand: observed against closed forms, held down by the controller."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from bench.passivity import GROUPS, Energy, Group, draw, energy_of, simulated
from bench.stability import evaluated
from hapticd.base.core import Flag, lib
from hapticd.config.configuration import default_config, load_config
from hapticd.daemon.engine import Engine
from hapticd.daemon.methods import Methods
from hapticd.rendering.device_output import output_of
from hapticd.rendering.offline import simulate_run
from hapticd.sweeps.measures.energy import given_j
from tests.support.rig import FLOOR, Rig, line, still

STIFFNESS = 800.0
PLAIN = {"plain": {"stiffness_n_per_m": STIFFNESS}}
FLAT = {**FLOOR, "material": "plain"}
PERIOD_S = 1e-4
UNKNOWN = {"sim": {"handle_damping_n_s_per_m": 0, "coulomb_friction_n": 0}}
"""A handle that takes nothing itself."""


def energy(rig: Rig) -> Energy:
    return energy_of(rig.state)


def in_and_out(steps: int, way_m: float) -> np.ndarray:
    """Onto the floor and `steps` ways into it, back, and off it."""
    heights = way_m * np.concatenate((np.arange(3, -steps - 1, -1), np.arange(-steps + 1, 4)))
    return np.stack((np.zeros(len(heights)), heights), 1)


@pytest.mark.parametrize(("steps", "way_m"), [(1, 1e-5), (40, 1e-5), (100, 3e-5)])
def test_a_sampled_spring_gives_k_v2_t2_a_tick(steps: int, way_m: float) -> None:
    """In: -K h^2 n(n-1)/2, out: +K h^2 n(n+1)/2, so n K h^2 = K v^2 T^2 n in all."""
    rig = Rig({"floor": FLAT}, materials=PLAIN, passivity="observe")
    path = in_and_out(steps, way_m)
    rig.render(path[: 4 + steps])
    assert energy(rig).energy_j == pytest.approx(-STIFFNESS * way_m**2 * steps * (steps - 1) / 2, rel=1e-9, abs=1e-18)
    rig.render(path[4 + steps :])
    given = energy(rig)
    assert given.energy_j == pytest.approx(STIFFNESS * way_m**2 * steps, rel=1e-9)
    assert given.largest_j == given.energy_j
    assert (given.contacts, given.restrained, given.acted) == (1, 0, 0)


@pytest.mark.parametrize("ramps", [0.25, 1.5])
def test_a_seam_gives_what_the_stiffer_side_holds_more(ramps: float) -> None:
    """Into the soft box, over to the stiff one, `ramps` ramps on there, and out: (K - k) d^2/2 at most, and what a
    sampled spring gives."""
    side = {"kind": "box", "size_m": [0.02, 0.02]}
    objects = {
        "soft": {**side, "center_m": [-0.01, -0.01], "material": "soft"},
        "stiff": {**side, "center_m": [0.01, -0.01], "material": "plain"},
    }
    rig = Rig(objects, materials={**PLAIN, "soft": {"stiffness_n_per_m": 300.0}}, passivity="observe")
    deep, steps, slid = 1e-3, 200, round(2 * ramps * 0.02 / PERIOD_S)
    down, along = np.linspace(1e-5, -deep, steps), np.linspace(-0.004, 0.004, slid)
    path = np.vstack(
        (
            np.column_stack((np.full(steps, along[0]), down)),
            np.column_stack((along, np.full(slid, -deep))),
            np.column_stack((np.full(steps, along[-1]), down[::-1])),
        )
    )
    rig.render(path)
    if ramps < 1:  # the hand leaves while the stiffness grows: to the whole at the height where it leaves at most
        assert 0.25 * (STIFFNESS - 300.0) * deep**2 / 2 < energy(rig).energy_j < (STIFFNESS - 300.0) * deep**2 / 2
        return
    sampled = (STIFFNESS + 300.0) / 2 * deep * (deep / steps)
    assert energy(rig).energy_j == pytest.approx((STIFFNESS - 300.0) * deep**2 / 2 + sampled, rel=0.02)


def test_a_missed_tick_holds_the_force_for_the_whole_way() -> None:
    rig = Rig({"floor": FLAT}, materials=PLAIN, passivity="observe")
    rig.render(line(1e-5, 0.1, 3))  # to 10 um below
    rig.render([[0.0, -4e-5]], periods=[3])
    assert energy(rig).energy_j == pytest.approx(-STIFFNESS * 1e-5 * 3e-5, rel=1e-9)


def test_beyond_the_limit_what_was_commanded_counts() -> None:
    rig = Rig({"floor": FLAT}, materials={"plain": {"stiffness_n_per_m": 1e5}}, passivity="observe")
    rig.render(line(1e-4, 1.0, 6))  # 0.4 mm deep, 40 N
    before = energy(rig).energy_j
    samples = rig.render([[0.0, -5e-4]])
    assert samples["force_n"][0, 1] == pytest.approx(8.9)
    assert energy(rig).energy_j - before == pytest.approx(-8.9e-4, rel=1e-9)


def test_each_contact_begins_at_nothing_and_the_largest_stays() -> None:
    rig = Rig({"floor": FLAT}, materials=PLAIN, passivity="observe")
    rig.render(in_and_out(50, 2e-5))
    first = energy(rig)
    rig.render(in_and_out(10, 2e-5))
    second = energy(rig)
    assert second.contacts == 2
    assert second.energy_j == pytest.approx(first.energy_j / 5, rel=1e-9)
    assert second.largest_j == first.largest_j


def test_friction_is_counted() -> None:
    """A probe that slides takes mu F_n s from the hand."""
    material = {"plain": {"stiffness_n_per_m": STIFFNESS, "friction": {"coefficient": 0.5}}}
    rig = Rig({"floor": FLAT}, materials=material, passivity="observe")
    rig.render(line(1e-3, 0.1, 21))
    rig.render(np.stack((np.linspace(0, 0.01, 1001), np.full(1001, -1e-3)), 1))
    before = energy(rig).energy_j
    rig.render(np.stack((np.linspace(0.01, 0.02, 1001)[1:], np.full(1000, -1e-3)), 1))
    assert energy(rig).energy_j - before == pytest.approx(-0.5 * STIFFNESS * 1e-3 * 0.01, rel=1e-6)


@pytest.mark.parametrize("mode", ["observe", "control"])
def test_fields_are_not_counted_and_not_changed(mode: str) -> None:
    pull = {
        "pull": {"kind": "constant", "force_n": [0, -2]},
        "home": {"kind": "spring", "center_m": [0, 0.1], "stiffness_n_per_m": 50},
    }
    free = Rig(pull)
    rig = Rig(pull, passivity=mode)
    path = line(0.05, 0.3, 500)
    assert np.array_equal(rig.render(path), free.render(path))
    assert energy(rig) == (0, 0, 0, 0, 0)
    floor = Rig({**pull, "floor": FLAT}, materials=PLAIN, passivity=mode)
    floor.render(in_and_out(40, 1e-5)[:44])
    assert energy(floor).energy_j == pytest.approx(-STIFFNESS * 1e-10 * 40 * 39 / 2, rel=1e-9)


def random_scene(seed: int) -> tuple[dict[str, object], dict[str, object], np.ndarray]:
    random = np.random.default_rng(seed)
    objects: dict[str, object] = {
        "floor": {**FLOOR, "material": str(random.choice(["wood", "steel", "glass", "sand"]))},
        "disc": {"kind": "disc", "center_m": [0.003, 0], "radius_m": 0.004, "material": "wood"},
        "pull": {"kind": "constant", "force_n": [0.3, -0.2]},
    }
    materials: dict[str, object] = {"sand": {"stiffness_n_per_m": 500, "friction": {"coefficient": 0.4}}}
    steps = random.normal(0, 2e-5, (4000, 2))
    path = np.cumsum(np.cumsum(steps, 0) * 0.02 - 0, 0)
    return objects, materials, 0.008 * path / np.abs(path).max()


@pytest.mark.parametrize("seed", range(4))
def test_observing_changes_no_bit(seed: int) -> None:
    objects, materials, path = random_scene(seed)
    off = Rig(objects, materials=materials).render(path)
    observed = Rig(objects, materials=materials, passivity="observe")
    assert np.array_equal(observed.render(path), off)
    assert energy(observed).contacts > 0


TAP = [[0, 0, 0.01], [0.1, 0, -0.01], [0.3, 0, -0.01], [0.4, 0, 0.01], [0.5, 0, 0.01]]


def tapped(mode: str, material: str, device: Mapping[str, Any] | None = None, rate_hz: float = 10_000.0) -> np.ndarray:
    config = {
        "device": dict(device or {}),
        "materials": PLAIN,
        "scene": {"passivity": mode, "objects": {"floor": {**FLOOR, "material": material}}},
    }
    return simulate_run(config, TAP, None, rate_hz).samples


@pytest.mark.parametrize("material", ["steel", "wood", "plain"])
def test_a_press_within_the_margins_is_not_changed(material: str) -> None:
    """K T/2 < b and K Delta/2 < c: the handle itself takes what the sampled wall gives, and the controller knows."""
    assert np.array_equal(tapped("control", material), tapped("off", material))


def test_a_handle_that_takes_nothing_lets_the_controller_act_at_the_end_and_leaves_the_vibration() -> None:
    device = {"sim": {"handle_damping_n_s_per_m": 0, "coulomb_friction_n": 0, "encoder_step_m": 0}}
    off, on = tapped("observe", "steel", device), tapped("control", "steel", device)
    acted = (on["flags"] & Flag.RESTRAINED) != 0
    assert acted.any()
    first = int(np.argmax(acted))
    assert first > 3000  # while it lets go
    assert np.array_equal(on[:first], off[:first])
    assert np.abs(on["vibration_force_n"]).max() > 1
    ringing = (off["flags"][:first] & Flag.RINGING) != 0
    assert ringing.any()
    # Tapped in a rebound, too, each ring is whole: what differs is the wall's force.
    assert np.array_equal(on["vibration_force_n"][: first + 1], off["vibration_force_n"][: first + 1])


def test_while_it_acts_the_ringing_goes_on_as_it_would() -> None:
    """An open-loop way on which the controller acts while a mode rings: the same vibration to the last bit."""
    heights = np.concatenate((np.linspace(2e-4, -2e-4, 9), np.linspace(-2e-4, 2e-4, 9)))
    heights = np.concatenate((heights, heights, heights))
    path = np.stack((np.zeros(len(heights)), heights), 1)
    floor = {"floor": {**FLOOR, "material": "steel"}}
    off = Rig(floor, device=UNKNOWN).render(path)
    on = Rig(floor, device=UNKNOWN, passivity="control").render(path)
    acted = (on["flags"] & Flag.RESTRAINED) != 0
    assert (acted & ((on["flags"] & Flag.RINGING) != 0)).sum() >= 5
    assert np.array_equal(on["vibration_force_n"], off["vibration_force_n"])
    assert np.array_equal(on["contact_force_n"][~acted], off["contact_force_n"][~acted])
    assert (np.abs(on["contact_force_n"][acted]) <= np.abs(off["contact_force_n"][acted])).all()


def test_the_controller_gives_back_what_was_taken_and_no_more() -> None:
    """At a steady speed the estimate is exact, so the sum ends at nothing but what the last way gave."""
    rig = Rig({"floor": FLAT}, materials=PLAIN, device=UNKNOWN, passivity="control")
    rig.render(in_and_out(100, 1e-5))
    assert abs(energy(rig).energy_j) < 1e-15
    assert energy(rig).restrained == 1


def test_it_brakes_by_no_more_than_it_may() -> None:
    rig = Rig({"floor": FLAT}, materials=PLAIN, device=UNKNOWN, passivity="control")
    rig.render(in_and_out(30, 1e-5)[:34])
    # It jumps outwards, which gives more than was taken, and goes on outwards.
    samples = rig.render([[0, -1e-5], [0, -0.8e-5], [0, -0.6e-5]])
    assert energy(rig).energy_j > 0
    speeds = samples["velocity_m_per_s"][1:, 1]
    damping = -samples["contact_force_n"][1:, 1] / speeds
    most = rig.table.brake_n_s_per_m
    assert most == pytest.approx(0.1 * 0.04 * 10_000)
    assert (damping <= most * (1 + 1e-12)).all()
    assert (damping > 0).all()


@pytest.mark.parametrize("group", GROUPS)
def test_random_walls_and_corners_give_no_more_than_the_bound(group: Group) -> None:
    for seed in range(1000, 1040):
        case = draw(seed, group)
        given = simulated(case, "control")
        bound = case.bound_j * (1 + case.age)
        assert given.energy.largest_j <= bound * (1 + 1e-12), case
        assert given.true_j <= bound, case


@pytest.mark.parametrize(
    ("group", "seed"), [("exact", 126), ("exact", 370), ("encoder", 60), ("encoder", 363), ("delay", 23)]
)
def test_walls_that_give_more_are_held(group: Group, seed: int) -> None:
    """Cases that exceed the bound without the controller."""
    case = draw(seed, group)
    bound = case.bound_j * (1 + case.age)
    assert simulated(case, "off").true_j > bound
    assert simulated(case, "control").true_j <= bound


def test_the_benchmarks_sum_against_a_loop() -> None:
    random = np.random.default_rng(3)
    force, position = random.normal(size=(200, 2)), random.normal(size=(200, 2))
    touched = random.random(200) < 0.7
    touched[-5:] = False
    largest, total, inside = 0.0, 0.0, False
    for tick in range(199):
        total = total if inside else 0.0
        inside = bool(touched[tick])
        if inside:
            total += float(force[tick] @ (position[tick + 1] - position[tick]))
            largest = max(largest, total)
    assert given_j(force, position, touched) == pytest.approx(largest, rel=1e-12)
    assert given_j(force, position, np.zeros(200, bool)) == 0


def test_an_update_keeps_the_energy_and_switching_on_begins_anew() -> None:
    rig = Rig({"floor": FLAT}, materials=PLAIN, passivity="observe")
    path = in_and_out(40, 1e-5)
    rig.render(path[:30])
    before = energy(rig)
    rig.update({"far": {**FLAT, "point_m": [0, -1]}}, passivity="control")
    rig.render(path[30:31])
    assert energy(rig).energy_j < before.energy_j
    assert energy(rig).contacts == 1
    rig.update({}, passivity="off")
    rig.render(path[31:32])  # the controller's ramp, of a tick, goes back
    off = energy(rig)
    rig.render(path[32:33])
    assert energy(rig) == off
    rig.update({}, passivity="observe")
    rig.render(path[33:34])
    assert energy(rig).energy_j == 0
    assert energy(rig).contacts == 2


@pytest.mark.parametrize("jump", [[0.0, 0.05], [0.0, np.nan]])
def test_a_jump_and_what_is_no_number_begin_anew(jump: list[float]) -> None:
    rig = Rig({"floor": FLAT}, materials=PLAIN, passivity="control")
    rig.render(in_and_out(40, 1e-5)[:40])
    assert energy(rig).energy_j < 0
    rig.render([jump])
    rig.render(still(0.0, 0.05, 3))
    assert energy(rig).energy_j == 0
    assert np.isfinite(energy(rig).largest_j)


def test_without_forces_nothing_is_given() -> None:
    rig = Rig({"floor": FLAT}, materials=PLAIN, passivity="observe")
    lib.hd_state_enable(rig.state, 0)
    rig.render(still(0, 0.01, 300))
    rig.render(in_and_out(20, 1e-5))
    assert energy(rig).energy_j == 0


def test_the_age_of_a_position_is_that_of_the_configuration() -> None:
    def age(**sim: object) -> float:
        return output_of(load_config({"device": {"sim": sim}}), 10_000).age_s

    assert age() == 0
    assert age(report_delay_s=0.0015) == 0.0015
    # A frame each way, and half a one that a force waits.
    assert age(link={"rate_hz": 1000, "delay_frames": 1}) == pytest.approx(0.0015)
    rig = Rig({}, device={"sim": {"report_delay_s": 0.00025}})
    assert rig.table.report_age == 3
    assert Rig({}, device={"sim": {"report_delay_s": 0.0003}}).table.report_age == 3
    assert Rig({}, device={"sim": {"report_delay_s": 0.1}}).table.report_age == 512
    assert Rig({}, device={"kind": "hid"}).table.handle_damping_n_s_per_m == 0


def test_status() -> None:
    engine = Engine(default_config())
    control = Methods(engine)
    nothing = {"energy_j": 0, "largest_j": 0, "contacts": 0, "restrained": 0, "acted": 0}
    assert control.status()["passivity"] == {"mode": "off", **nothing}
    control.call("set_scene", {"scene": {"passivity": "control", "objects": {}}})
    control.call("update_scene", {"objects": {"v": {"kind": "viscous", "damping_n_s_per_m": 1}}})
    assert control.status()["passivity"] == {"mode": "control", **nothing}


def test_the_running_servo_tells_what_was_given() -> None:
    config = load_config(
        {
            "servo": {"realtime": "off", "rate_hz": 1000},
            "device": {"sim": {"start_m": [0, -0.002]}},
            "materials": PLAIN,
            "scene": {"passivity": "observe", "objects": {"floor": FLAT}},
        }
    )
    engine = Engine(config)
    engine.start()
    try:
        engine.set_operator(np.array([[0.0, 0.0, -0.004]]), "linear")
        start = engine.counters().ticks
        while engine.counters().ticks < start + 200:
            engine.wait_revision(engine.take(engine.scene.with_objects({}), engine.materials))
        found = engine.counters()
    finally:
        engine.stop()
    # After a stall longer than the ramp it is met anew.
    assert 1 <= found.contacts <= 1 + engine.counters().overruns
    assert found.energy_j != 0


GRAZED = {
    "disc": {"top": {"kind": "disc", "center_m": [0, -0.004], "radius_m": 0.004, "material": "plain"}},
    "corner": {
        side: {"kind": "wall", "point_m": [0, 0], "normal": [x, 0.6], "material": "plain"}
        for side, x in (("left", 0.8), ("right", -0.8))
    },
}


@pytest.mark.parametrize("shape", GRAZED)
def test_what_is_grazed_within_the_margins_is_not_changed(shape: str) -> None:
    """A surface that is crossed within one step of the encoder holds K d^2/2 before any force was felt: on the way in
    the handle took more than that. Met while moving on, the force goes along with the motion from its first tick."""
    device = {
        "sim": {
            "encoder_step_m": 8e-5,
            "coulomb_friction_n": 0.05,
            "handle_damping_n_s_per_m": 0.3,
            "hand": {"stiffness_n_per_m": 800, "damping_n_s_per_m": 4, "mass_kg": 0.05},
        }
    }
    source = {
        "servo": {"rate_hz": 1700.0},
        "device": device,
        "materials": {"plain": {"stiffness_n_per_m": 340.0}},
        "scene": {"objects": GRAZED[shape]},
    }
    assert evaluated(load_config(source)).safe.all()
    touched = 0
    for along in (0.03, 0.08, 0.2):
        for deep in np.linspace(5e-5, 4e-4, 5):
            path = [[0, -0.003, 0.003], [0.05, -0.001, -deep], [0.05 + 0.004 / along, 0.003, -deep]]
            off, control = (
                simulate_run({**source, "scene": {"objects": GRAZED[shape], "passivity": mode}}, path, None, 1700.0)
                for mode in ("off", "control")
            )
            touched += int((off.samples["flags"] & Flag.CONTACT != 0).sum())
            assert np.array_equal(control.samples["force_n"], off.samples["force_n"]), (along, deep)
    assert touched > 50


RINGS = {
    "stiffness_n_per_m": STIFFNESS,
    "tap": {"attack_slope_per_s": 309, "frequency_hz": 67, "decay_time_s": 0.05},
    "texture": {"kind": "stochastic", "peak_hz": 300, "mean_hz": 420, "velocity_gain_per_s": 50},
}


@pytest.mark.parametrize(
    ("material", "limit_n"),
    [({"stiffness_n_per_m": STIFFNESS}, 0.7), (RINGS, 1.05), (RINGS, 0.7)],
    ids=["a force beyond the limit", "vibration up to the limit", "a force beyond the limit and vibration"],
)
def test_at_the_limit_control_changes_no_bit_where_it_does_not_act(material: dict[str, object], limit_n: float) -> None:
    """Pressed with 0.96 N in all and stroked, in a corner and over a disc."""
    objects = {
        "left": {"kind": "wall", "point_m": [-0.005, 0], "normal": [0.8, 0.6], "material": "it"},
        "floor": {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "it"},
        "disc": {"kind": "disc", "center_m": [0.006, -0.0035], "radius_m": 0.004, "material": "it"},
    }
    ways = [[0, 0.001], [0, -0.0012], [-0.004, -0.0009], [0.0004, -0.0012], [0.0058, -0.0003], [0.0058, 0.0012]]
    path = np.concatenate([np.linspace(a, b, 300) for a, b in pairwise(ways)])
    found = {}
    for mode in ("off", "control"):
        rig = Rig(objects, materials={"it": material}, device={"max_force_n": limit_n}, passivity=mode)
        found[mode] = rig.render(path)
    off, control = found["off"], found["control"]
    assert not np.any(control["flags"] & Flag.RESTRAINED)
    assert np.count_nonzero(off["flags"] & Flag.SATURATED) > 50
    assert np.array_equal(control["force_n"], off["force_n"])
    assert np.array_equal(control["vibration_force_n"], off["vibration_force_n"])
