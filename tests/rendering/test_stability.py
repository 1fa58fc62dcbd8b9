"""Margins: closed forms, matrices built in another way, brute force, and simulations of safe walls."""

from __future__ import annotations

import json
import math
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import signal

from bench.stability import SEED, counted, draw, evaluated, fate_of, linear_grows
from hapticd.analysis.check import check
from hapticd.base.core import HidQuantity, ffi, lib
from hapticd.cli import main
from hapticd.config.actuator import Actuator
from hapticd.config.configuration import Config, load_config
from hapticd.config.dynamics import Dynamics, held_motion
from hapticd.hid.plan import AxisPlan, Bits, Message, Plan, Value
from hapticd.rendering import contact_sets
from hapticd.rendering.contact_sets import ContactSets
from hapticd.rendering.device_output import loop_of
from hapticd.rendering.end_state import end_of
from hapticd.rendering.joystick import new_operator, new_sim
from hapticd.rendering.offline import render, simulate_run
from hapticd.rendering.scene_stability import Stability
from hapticd.rendering.stability import (
    ASSUMED_PRESS_N,
    MAX_STABLE_RADIUS,
    Loop,
    Timing,
    held_factor,
    spectral_radius,
    timing,
)
from tests.support.marks import rest_slow

HANDLE = Dynamics(0.04, 0.2, 0.05, 0.01, 5.0, 300.0)
FLOOR = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "m"}


def config_of(objects: dict[str, Any], materials: dict[str, Any] | None = None, **sim: Any) -> Any:
    return load_config(
        {
            "device": {"sim": sim},
            "materials": materials or {"m": {"stiffness_n_per_m": 800}},
            "scene": {"objects": objects},
        }
    )


def loop_with(timing: Timing, dynamics: Dynamics = HANDLE) -> Loop:
    return Loop(timing, dynamics, 20e-6, 0.0043, 8.9, 0.075)


# ---- Timing --------------------------------------------------------------------------------------------------------


def test_a_loop_without_delay_and_one_with_a_delay_of_complete_periods() -> None:
    for ticks in range(4):
        found = timing(10_000.0, 0.0, 1e-4 * ticks)
        assert found.reach_s == pytest.approx(1e-4 * (ticks + 0.5), rel=1e-12)
        assert (found.period_s, found.delay_s) == pytest.approx((1e-4, 1e-4 * ticks))
        assert found.echo == 1.0


@pytest.mark.parametrize("frames", [1, 2, 3])
def test_a_link_delays_twice_and_holds_once(frames: int) -> None:
    found = timing(10_000.0, 1e-3, 1e-3 * frames, 1e-3, frames)
    assert found.period_s == pytest.approx(1e-3)
    assert found.delay_s == pytest.approx(2e-3 * frames)
    assert found.reach_s == pytest.approx(1e-3 * (2 * frames + 0.5), rel=1e-12)


def ages(rate_hz: float, interval_s: float, age_s: float, frame_s: float, frames: int) -> tuple[Any, Any]:
    """What time the actuator's force is from, at many times within each tick, by the rules as they are written."""
    ticks = 60
    parts = 10
    times = (np.arange(ticks * parts) + 0.5) / (parts * rate_hz)
    puts = []
    for k in range(ticks):
        now = k / rate_hz
        measured = math.floor((now - age_s) / interval_s + 1e-9) * interval_s if interval_s else now - age_s
        acts = (math.floor(now / frame_s + 1e-9) + frames) * frame_s if frame_s else now
        puts.append((acts, measured))
    source = np.array([[m for a, m in puts if a <= t + 1e-12][-1:] or [-1.0] for t in times])[:, 0]
    return times, source


@pytest.mark.long
@pytest.mark.parametrize(
    ("interval", "age", "frame", "frames"),
    rest_slow(
        [
            (0.6, 1.1, 0.4, 2),
            (0, 0, 0, 1),
            (0, 2, 0, 1),
            (2, 1, 0, 1),
            (1.5, 0.5, 0, 1),
            (0.25, 0.25, 0.25, 1),
            (2.5, 2.5, 2.5, 1),
        ]
    ),
)
def test_the_reach_is_the_norm_of_the_displacement_since_the_measurement(
    interval: float, age: float, frame: float, frames: int
) -> None:
    # The integral operator on a grid, over many ticks: its norm comes near from below.
    times, source = ages(1.0, interval, age, frame, frames)
    found = timing(1000.0, 1e-3 * interval, 1e-3 * age, 1e-3 * frame, frames)
    used = source > 0
    times, source = times[used], source[used]
    step = times[1] - times[0]
    covered = (times[None, :] <= times[:, None]) & (times[None, :] >= source[:, None])
    matrix = step * (covered - 0.5 * np.eye(len(times)))
    norm = float(np.linalg.eigvalsh(0.5 * (matrix + matrix.T))[-1])
    assert 0.97 * norm <= 1000.0 * found.reach_s
    assert 1000.0 * found.reach_s <= norm * 1.04 + 0.07


@pytest.mark.parametrize(
    "sim",
    [
        {},
        {"report_delay_s": 3e-4},
        {"report_interval_s": 5e-4, "report_delay_s": 2e-4},
        {"link": {"rate_hz": 1000}},
        {"link": {"rate_hz": 500, "delay_frames": 2}},
    ],
)
def test_the_timing_is_that_of_the_simulated_joystick(sim: dict[str, Any]) -> None:
    """A hand draws the handle along a line; the force says where it was when the force was made."""
    config = config_of({}, **sim, encoder_step_m=0, force_step_n=0, coulomb_friction_n=0, max_force_n=100)
    loop = loop_of(config, 10_000.0)
    assert loop is not None
    joystick = new_sim(config.device.sim, 10_000.0)
    hand = new_operator([[0, 0, 0], [1, 0.07, 0]], "linear")
    lib.hd_sim_operate(joystick, hand)
    reading = ffi.new("struct hd_reading *")
    vectors = [ffi.new("double[2]") for _ in range(4)]
    rows = []
    for _ in range(4000):
        lib.hd_sim_read(joystick, reading)
        vectors[3][0] = 1e-3 * reading.position_m[0]
        lib.hd_sim_put(joystick, vectors[3])
        lib.hd_sim_truth(joystick, *vectors[:3])
        rows.append((vectors[0][0], 1e3 * vectors[2][0]))
        lib.hd_sim_advance(joystick, 1)
    position, source = np.array(rows[1000:]).T
    late = 1e-4 * (np.arange(len(position)) - np.interp(source, position, np.arange(len(position))))
    late = late[200:]
    # Seen at ticks, when a tick's force has just begun.
    assert late.mean() == pytest.approx(loop.timing.delay_s + 0.5 * (loop.timing.period_s - 1e-4), rel=1e-3, abs=1e-8)


@pytest.mark.parametrize("damping_ratio", [0.2, math.sqrt(0.5), 1.0, 2.0])
def test_an_actuators_lag_adds_to_the_reach(damping_ratio: float) -> None:
    """Integrals of the impulse response of scipy's, of |h|, t |h| and t h."""
    actuator = Actuator(bandwidth_hz=300, order=2, damping_ratio=damping_ratio)
    a = actuator.rate_per_s
    t, h = signal.impulse(([a * a], [1, 2 * damping_ratio * a, a * a]), T=np.linspace(0, 150 / a, 60_001))
    step = t[1] - t[0]
    expected = [step * np.abs(h).sum(), step * (t * np.abs(h)).sum(), step * (t * h).sum()]
    np.testing.assert_allclose(actuator.moments(), expected, rtol=2e-3)
    assert Actuator(bandwidth_hz=300).moments() == pytest.approx((1, 1 / (600 * math.pi), 1 / (600 * math.pi)))


@pytest.mark.long
def test_a_slow_actuator_holds_less() -> None:
    """b > K (T/2 + 1/a): with 100 Hz a free handle of 0.2 N s/m holds 122 N/m, not 4000."""
    push = {"kind": "constant", "force_n": [0, -0.5]}
    hand = {"mass_kg": 0, "stiffness_n_per_m": 0, "damping_n_s_per_m": 0}
    sim = {"hand": hand, "encoder_step_m": 0, "coulomb_friction_n": 0, "force_step_n": 0, "start_m": [0, 0.005]}
    sim["actuator"] = {"bandwidth_hz": 100}
    limit = 0.2 / (0.5e-4 + 1 / (200 * math.pi))
    for part, fate in ((0.95, "rests"), (1.1, "cycles")):
        config = config_of({"w": FLOOR, "push": push}, {"m": {"stiffness_n_per_m": part * limit}}, **sim)
        assert evaluated(config).factors(0)["passivity"] == pytest.approx(1 / part)
        assert fate_of(config, [[0, 0, 0.005], [0.01, 0, 0.005]]).fate == fate


# ---- Eigenvalues ---------------------------------------------------------------------------------------------------


def roots(stiffness: float, damping: float, dynamics: Dynamics, period_s: float, delays: int) -> float:
    """The largest root of 1 + G(z) z^-delays (K + D (1 - z^-1) / T), G by scipy."""
    plant = ([1.0], [dynamics.mass_kg, dynamics.damping_n_s_per_m, dynamics.grip_stiffness_n_per_m])
    numerator, denominator, _ = signal.cont2discrete(plant, period_s, method="zoh")
    gain = np.array([stiffness + damping / period_s, -damping / period_s])
    whole = np.polymul(denominator, [1.0] + [0.0] * (delays + 1))
    return float(np.abs(np.roots(np.polyadd(whole, np.polymul(numerator.ravel(), gain)))).max())


@pytest.mark.long
@pytest.mark.parametrize("delays", [0, 1, 4])
def test_the_spectral_radius_is_that_of_the_transfer_function(delays: int) -> None:
    random = np.random.default_rng(delays)
    for _ in range(30):
        period_s = float(random.uniform(1e-4, 1e-3))
        dynamics = Dynamics(*random.uniform([0.01, 0, 0, 0, 0, 0], [0.3, 5, 0, 0.1, 10, 1500]).tolist())
        along, across = random.uniform(0, 20_000, 2)
        damping = float(random.choice([0.0, random.uniform(0, 5)]))
        turn = float(random.uniform(0, math.pi))
        rotation = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
        stiffness = rotation @ np.diag([along, across]) @ rotation.T
        found = spectral_radius(
            stiffness, damping * np.eye(2), loop_with(timing(1 / period_s, 0, delays * period_s), dynamics)
        )
        expected = max(roots(each, damping, dynamics, period_s, delays) for each in (along, across))
        assert float(found) == pytest.approx(expected, rel=1e-7)


def test_the_held_motion_is_scipys() -> None:
    random = np.random.default_rng(3)
    for _ in range(50):
        dynamics = Dynamics(*random.uniform([0.001, 0, 0, 0, 0, 0], [0.3, 50, 0, 0.1, 100, 1e5]).tolist())
        a = np.array([[0, 1], [-dynamics.grip_stiffness_n_per_m, -dynamics.damping_n_s_per_m]])
        a[1] /= dynamics.mass_kg
        plant = (a, np.array([[0], [1 / dynamics.mass_kg]]), np.eye(2), np.zeros((2, 1)))
        span_s = float(random.uniform(1e-5, 5e-3))
        state, push, *_ = signal.cont2discrete(plant, span_s, method="zoh")
        found = held_motion(dynamics, span_s)
        np.testing.assert_allclose(found[0], state, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(found[1], push[:, 0], rtol=1e-9, atol=1e-15)


def test_a_fractional_delay_lies_between_complete_periods() -> None:
    stiffness = np.diag([9000.0, 0.0])
    radius = [
        float(spectral_radius(stiffness, np.zeros((2, 2)), loop_with(Timing(1e-3, 1e-3 * part, 0, 1, 1e-3))))
        for part in np.linspace(0.0, 2.0, 9)
    ]
    assert radius == sorted(radius)
    assert radius[4] == pytest.approx(roots(9000.0, 0.0, HANDLE, 1e-3, 1), rel=1e-9)


def test_the_held_limit_is_where_the_radius_passes_one() -> None:
    loop = loop_with(timing(1000.0, 0.0, 1e-3))
    one = np.diag([500.0, 0.0])[None]
    factor = float(held_factor(one, np.zeros((1, 2, 2)), loop, np.zeros(1))[0])
    assert roots(500.0 * factor * 0.998, 0.0, HANDLE, 1e-3, 1) < 1.0
    assert roots(500.0 * factor * 1.002, 0.0, HANDLE, 1e-3, 1) > 1.0


@pytest.mark.long
def test_a_safe_set_is_linearly_stable() -> None:
    for index in range(60):
        trial = draw(np.random.default_rng((5, index)))
        if trial.safe:
            assert trial.radius <= MAX_STABLE_RADIUS


# ---- Limits --------------------------------------------------------------------------------------------------------


def test_the_default_floor() -> None:
    sets = evaluated(config_of({"floor": FLOOR}))
    (margin,) = sets.margins([(("floor",), 0)])
    assert margin.stiffness_n_per_m == pytest.approx(800)
    # b / (T/2), against 2 (c - q/2) / step
    assert sets.factors(0) == pytest.approx(
        {"passivity": 0.2 / 0.5e-4 / 800, "quantisation": 2 * (0.05 - 0.00215) / 20e-6 / 800}
    )
    assert margin.safe
    assert margin.limited_by == "passivity"
    assert margin.limit_n_per_m == pytest.approx(4000)
    assert margin.margin == pytest.approx(5)


def test_two_walls_in_a_corner_act_together() -> None:
    for degrees in (10, 60, 90, 150):
        normals = [[math.sin(math.radians(turn)), math.cos(math.radians(turn))] for turn in (0, 180 - degrees)]
        objects = {f"w{i}": {**FLOOR, "normal": normal} for i, normal in enumerate(normals)}
        sets = evaluated(config_of(objects))
        assert len(sets) == 1
        expected = 800 * (1 + abs(math.cos(math.radians(degrees))))
        assert sets.stiffness_n_per_m[0] == pytest.approx(expected)


def test_walls_apart_do_not_act_together() -> None:
    room = {
        "floor": FLOOR,
        "ceiling": {**FLOOR, "point_m": [0, 0.05], "normal": [0, -1]},
        "left": {**FLOOR, "point_m": [-0.03, 0], "normal": [1, 0]},
        "right": {**FLOOR, "point_m": [0.03, 0], "normal": [-1, 0]},
    }
    sets = evaluated(config_of(room))
    assert len(sets) == 4
    np.testing.assert_allclose(sets.stiffness_n_per_m, 800)
    thin = {"floor": FLOOR, "ceiling": {**FLOOR, "point_m": [0, 0.001], "normal": [0, -1]}}
    assert evaluated(config_of(thin)).stiffness_n_per_m == pytest.approx([800, 800])
    gone = {"floor": FLOOR, "ceiling": {**FLOOR, "point_m": [0, -0.001], "normal": [0, -1]}}
    assert evaluated(config_of(gone)).stiffness_n_per_m == pytest.approx([1600])


def test_friction_springs_and_fields_count() -> None:
    materials = {"m": {"stiffness_n_per_m": 300, "friction": {"coefficient": 0.3, "stiffness_n_per_m": 700}}}
    spring = {"kind": "spring", "center_m": [0, 0], "stiffness_n_per_m": 50, "damping_n_s_per_m": 0.01}
    honey = {"kind": "viscous", "damping_n_s_per_m": 0.02}
    sets = evaluated(config_of({"floor": FLOOR, "spring": spring, "honey": honey}, materials))
    assert sets.stiffness_n_per_m == pytest.approx([750])
    assert sets.damping_n_s_per_m == pytest.approx([0.03])
    alone = evaluated(config_of({"spring": spring, "honey": honey}))
    assert alone.stiffness_n_per_m == pytest.approx([50])
    assert len(evaluated(config_of({"push": {"kind": "constant", "force_n": [1, 0]}}))) == 0


def test_noise_is_the_largest_force_of_positions_off_by_half_a_step() -> None:
    random = np.random.default_rng(9)
    for _ in range(40):
        turns = random.uniform(0, 2 * math.pi, 2)
        stiffness = random.uniform(10, 5000, 2)
        normals = np.stack((np.cos(turns), np.sin(turns)), axis=1)
        objects = {f"w{i}": {**FLOOR, "normal": normals[i].tolist(), "material": f"m{i}"} for i in range(2)}
        materials = {f"m{i}": {"stiffness_n_per_m": float(stiffness[i])} for i in range(2)}
        config = config_of(objects, materials, coulomb_friction_n=0.5, force_step_n=0, encoder_step_m=1e-4)
        # Each wall may be touched or not: the force is off by at most the sum of what each does.
        worst = max(
            sum(abs(stiffness[i] * normals[i, axis] * float(normals[i] @ off)) for i in range(2))
            for axis, *signs in product((0, 1), (-1, 1), (-1, 1))
            for off in [0.5e-4 * np.array(signs)]
        )
        bound = 0.5 / evaluated(config).factors(0)["quantisation"]
        # Of two walls the corner of the box that is worst for one need not be so for the other.
        assert worst <= bound * (1 + 1e-12)
        assert bound <= 2.0 * worst


@pytest.mark.parametrize("texture", ["grooves", "patches"])
def test_stiffening_under_force_counts_up_to_the_assumed_force(texture: str) -> None:
    """The Jacobian of the rendered force, by differences, over the surface pressed with up to ASSUMED_PRESS_N."""
    grooves = {"kind": "grooves", "display": "geometry", "spacing_m": 0.002, "width_m": 0.001, "depth_m": 1e-4}
    materials: dict[str, Any] = {"m": {"stiffness_n_per_m": 800}, "n": {"stiffness_n_per_m": 500}}
    floor: dict[str, Any] = {**FLOOR}
    if texture == "grooves":
        materials["m"]["texture"] = grooves
    else:
        floor |= {"patches": [{"from_m": 0.0, "to_m": 0.01, "material": "n"}], "patch_ramp_m": 0.002}
    config = config_of({"floor": floor}, materials)
    step = 1e-7
    along, depth = np.meshgrid(np.linspace(-0.0015, 0.0015, 121), np.linspace(1.2e-4, ASSUMED_PRESS_N / 800, 30))
    middle = np.stack((along.ravel(), -depth.ravel()), axis=1)
    # A probe that was outside at first, so that nothing comes in over a ramp; one far jump is no way to be.
    forces = []
    for x, y in ((step, 0), (-step, 0), (0, step), (0, -step)):
        path = np.concatenate(([[0.0, 0.001]], middle + np.array([x, y])))
        forces.append(render(quiet(config), path, 1000, velocity_m_per_s=np.zeros_like(path))["contact_force_n"][1:])
    pressed = np.hypot(*forces[0].T) <= ASSUMED_PRESS_N
    jacobian = np.stack(((forces[0] - forces[1]) / (2 * step), (forces[2] - forces[3]) / (2 * step)), axis=-1)[pressed]
    stiffness = float(np.linalg.norm(jacobian, 2, axis=(-2, -1)).max())
    found = float(evaluated(config).stiffness_n_per_m[0])
    assert 800 < stiffness <= found
    assert found < 2.5 * stiffness


def quiet(config: Any) -> Any:
    device = config.device.model_copy(update={"max_speed_m_per_s": 1000.0, "max_force_n": 100.0})
    return config.model_copy(update={"device": device})


# ---- Who acts together ---------------------------------------------------------------------------------------------


def inside(item: dict[str, Any], point: np.ndarray) -> bool:
    if item["kind"] == "disc":
        return math.dist(item["center_m"], point) <= item["radius_m"]
    if item["kind"] == "box":
        turn = item["angle_rad"]
        away = point - item["center_m"]
        local = [away @ [math.cos(turn), math.sin(turn)], away @ [-math.sin(turn), math.cos(turn)]]
        return all(abs(x) <= size / 2 for x, size in zip(local, item["size_m"], strict=True))
    height = float((point - item["point_m"]) @ item["normal"])
    return -8.9 / 800 <= height <= 0


def crowd(random: np.random.Generator, count: int) -> dict[str, Any]:
    objects: dict[str, Any] = {}
    for index in range(count):
        center = random.uniform(-0.03, 0.03, 2).tolist()
        match int(random.integers(8)):
            case 0:
                turn = float(random.uniform(0, 2 * math.pi))
                objects[f"w{index}"] = {**FLOOR, "point_m": center, "normal": [math.cos(turn), math.sin(turn)]}
            case 1 | 2 | 3:
                size = random.uniform(0.001, 0.02, 2).tolist()
                objects[f"b{index}"] = {"kind": "box", "center_m": center, "size_m": size, "material": "m"}
                objects[f"b{index}"]["angle_rad"] = float(random.uniform(0, 3))
            case _:
                objects[f"d{index}"] = {"kind": "disc", "center_m": center, "material": "m"}
                objects[f"d{index}"]["radius_m"] = float(random.uniform(0.0005, 0.008))
    return objects


@pytest.mark.long
@pytest.mark.parametrize("way", ["pairs", "whole"])
def test_whatever_holds_a_point_at_once_is_within_a_set(way: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if way == "whole":
        monkeypatch.setattr(contact_sets, "MAX_COMPARED_PAIRS", 0)
    for seed in range(4):
        random = np.random.default_rng(seed)
        objects = crowd(random, 25)
        normals = {name: np.array(item.get("normal", (0, 0)), dtype=float) for name, item in objects.items()}
        for name, item in objects.items():
            if "normal" in item:
                item["normal"] = (normals[name] / np.linalg.norm(normals[name])).tolist()
        sets = evaluated(config_of(objects))
        names = list(objects)
        found = [{names[slot] for slot in members} for members, _ in sets.worst(10_000, unsafe=False)]
        touched = {
            frozenset(name for name, item in objects.items() if inside(item, point))
            for point in random.uniform(-0.05, 0.05, (1500, 2))
        }
        for together_here in touched:
            assert any(together_here <= each for each in found), together_here


def stacked_boxes(stiffness: float, gap_m: float = 0.001) -> Any:
    """Three boxes of 1 mm below each other, and a handle of 0.2 N s/m without friction at 1 kHz."""
    boxes = {
        name: {"kind": "box", "center_m": [0, -place * (0.001 + gap_m)], "size_m": [0.02, 0.001], "material": "m"}
        for place, name in enumerate("abc")
    }
    sim = {
        "start_m": [0, 0.005],
        "encoder_step_m": 0,
        "coulomb_friction_n": 0,
        "force_step_n": 0,
        "handle_mass_kg": 0.05,
        "handle_damping_n_s_per_m": 0.2,
        "hand": {"mass_kg": 0, "stiffness_n_per_m": 50, "damping_n_s_per_m": 0},
    }
    return load_config(
        {
            "servo": {"rate_hz": 1000},
            "device": {"sim": sim},
            "materials": {"m": {"stiffness_n_per_m": stiffness}},
            "scene": {"objects": boxes},
        }
    )


def test_boxes_that_a_hand_presses_through_one_after_the_other_act_together() -> None:
    """The first two still push when the probe is in the third; each alone would be stable up to 2 b / T = 400 N/m."""
    limit = 2 * 0.2 * 1000 / 3
    sets = evaluated(stacked_boxes(100))
    assert {sets.members(number) for number in range(len(sets))} == {(0, 1, 2)}
    np.testing.assert_allclose(sets.factor, limit / 100)
    assert len(evaluated(stacked_boxes(100, gap_m=0.09))) == 3  # 8.9 N press 89 mm deep
    press = [[0, 0, 0.005], [0.3, 0, -4 / 50 - 0.004]]
    assert end_of(stacked_boxes(0.8 * limit), press, 60.0).fate == "rests"
    assert end_of(stacked_boxes(1.02 * limit), press, 60.0).fate == "cycles"


def test_a_set_is_at_most_a_pair_and_the_surfaces_that_meet_both() -> None:
    row = {f"d{i}": {"kind": "disc", "center_m": [0.001 * i, 0], "radius_m": 6e-4, "material": "m"} for i in range(30)}
    sets = evaluated(config_of(row))
    assert len(sets) == 29
    np.testing.assert_allclose(sets.stiffness_n_per_m, 1600)


# ---- What must hold ------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_safe_sets_neither_cycle_nor_grow_and_linearly_unstable_ones_grow() -> None:
    found = counted(SEED + 1, range(70), 128.0)
    assert found.broken == []
    assert found.not_grown == []
    assert found.linear > 5
    assert sum(count for (what, _), count in found.fates.items() if what == "safe") > 25
    # The simulation distinguishes: some sets that are not safe do not come to rest.
    assert any(fate == "cycles" for _, fate in found.fates)


@pytest.mark.long
def test_walls_beyond_a_limit_cycle() -> None:
    """A free handle on a wall 1.5 times as stiff as is passive at 5 ticks of delay, and one 4 times as stiff as dry
    friction holds; each at half of it rests."""
    push = {"kind": "constant", "force_n": [0, -0.5]}
    hand = {"mass_kg": 0, "stiffness_n_per_m": 0, "damping_n_s_per_m": 0}
    still = {"encoder_step_m": 0, "coulomb_friction_n": 0, "force_step_n": 0, "report_delay_s": 5e-4}
    rough = {"encoder_step_m": 1e-4, "coulomb_friction_n": 0.01, "force_step_n": 0, "handle_damping_n_s_per_m": 5}
    for sim, limited in ((still, "passivity"), (rough, "quantisation")):
        for part, fate in ((0.5, "rests"), (1.5 if limited == "passivity" else 4.0, "cycles")):
            base = {"hand": hand, "start_m": [0, 0.005], **sim}
            factor = evaluated(config_of({"w": FLOOR, "push": push}, **base)).factors(0)
            materials = {"m": {"stiffness_n_per_m": 800 * part * min(factor.values())}}
            config = config_of({"w": FLOOR, "push": push}, materials, **base)
            assert fate_of(config, [[0, 0, 0.005], [0.01, 0, 0.005]], 64.0).fate == fate


@pytest.mark.slow
def test_the_linear_simulation_of_a_stable_set_does_not_grow() -> None:
    for index in range(60):
        trial = draw(np.random.default_rng((8, index)))
        if 0.9 < trial.radius < 0.999 and trial.config.device.sim.hand.stiffness_n_per_m > 0:
            assert not linear_grows(trial)


# ---- Where it is reported ------------------------------------------------------------------------------------------

LINKED: dict[str, Any] = {
    "device": {"sim": {"link": {"rate_hz": 1000}}},
    "scene": {"objects": {"floor": {**FLOOR, "material": "wood"}}},
}


def stability_of(config: Config) -> Stability:
    return check(config).stability


def test_an_unsafe_set_is_reported_with_its_limit() -> None:
    told: Any = stability_of(load_config(LINKED)).to_dict()
    assert (told["unknown"], told["sets"], told["unsafe"]) == (None, 1, 1)
    (worst,) = told["worst"]
    assert worst["objects"] == ["floor"]
    assert worst["limit_n_per_m"] == pytest.approx(0.2 / 2.5e-3)
    assert worst["margin"] == pytest.approx(0.1)
    assert (worst["safe"], worst["verdict"], worst["limited_by"]) == (False, "unsafe", "passivity")
    free = Dynamics(0.04, 0.2, 0.05, 0.0, 0.0, 0.0)
    assert worst["free_radius"] == pytest.approx(roots(800, 0, free, 1e-3, 2), rel=1e-6)
    assert worst["spectral_radius"] == pytest.approx(roots(800, 0, HANDLE, 1e-3, 2), rel=1e-6)
    json.dumps(told, allow_nan=False)
    softer: dict[str, Any] = {**LINKED, "materials": {"wood": {"stiffness_n_per_m": 70}}}
    told = stability_of(load_config(softer)).to_dict()
    assert (told["sets"], told["unsafe"]) == (1, 0)
    (safe,) = told["worst"]
    assert (safe["objects"], safe["verdict"], safe["remedy"]) == (["floor"], "safe", "")
    assert safe["limit_n_per_m"] == pytest.approx(0.2 / 2.5e-3)
    assert safe["margin"] == pytest.approx(80 / 70)
    second = {**FLOOR, "point_m": [0, -0.001], "material": "wood"}
    two = {"scene": {"objects": {**LINKED["scene"]["objects"], "second": second}}}
    (worst,) = stability_of(load_config(softer | two)).worst
    assert worst.objects == ("floor", "second")
    assert worst.stiffness_n_per_m == pytest.approx(140)


def test_many_sets_are_counted_and_few_are_reported() -> None:
    objects = {
        f"d{i}": {"kind": "disc", "center_m": [0.001 * i, 0], "radius_m": 2e-4, "material": "m"} for i in range(60)
    }
    materials = {"m": {"stiffness_n_per_m": 800}}
    stability = stability_of(load_config({**LINKED, "materials": materials, "scene": {"objects": objects}}))
    assert (stability.sets, stability.unsafe, len(stability.worst)) == (60, 60, contact_sets.MAX_REPORTED_SETS)
    lines = [str(problem) for problem in stability.problems()]
    assert len(lines) == contact_sets.MAX_STABILITY_LINES + 1
    more = 60 - contact_sets.MAX_STABILITY_LINES
    assert lines[-1] == f"scene.objects: {more} more sets of objects are not safe, see `hapticd check`"


def test_virtual_damping_is_unproved_until_it_shakes_the_handle() -> None:
    """D T/m beyond 2 makes a held mass diverge: with 0.05 kg at 10 kHz beyond 1000 N s/m, at 1 kHz beyond 100."""
    for damping, verdict in ((0.001, "safe"), (2.0, "unproved"), (70.0, "unproved"), (150.0, "unsafe")):
        scene = {"objects": {"honey": {"kind": "viscous", "damping_n_s_per_m": damping}}}
        stability = stability_of(load_config({"servo": {"rate_hz": 1000}, "scene": scene}))
        assert [margin.verdict for margin in stability.worst] == [verdict]
        assert len(stability.problems()) == (verdict == "unsafe")


def test_an_unknown_handle_is_reported_and_not_assumed() -> None:
    config = load_config({"device": {"kind": "hid"}})
    assert loop_of(config, 10_000.0) is None
    known = load_config({"device": {"kind": "hid", "handle": {"mass_kg": 0.1, "damping_n_s_per_m": 1}}})
    loop = loop_of(known, 10_000.0, resolution_m=1e-5, link_rate_hz=1000.0)
    assert loop is not None
    assert loop.timing == timing(10_000.0, 1e-3, 1e-3, 1e-3, 1)
    assert loop.dynamics.mass_kg == 0.1


def test_the_steps_of_a_devices_forces_are_those_of_its_numbers() -> None:
    axis = AxisPlan(Bits(0, 16, True, False), 0, 0.0, (1e-5, 1e-5))
    values = tuple(
        Value(Bits(0, 16, True, False), quantity, counts, 0.0, -32767.0, 32767.0)
        for quantity, counts in ((HidQuantity.X, 100.0), (HidQuantity.Y, -50.0), (HidQuantity.DIRECTION, 1.0))
    )
    plan = Plan(axis, axis, (Message(b"", values[:1]), Message(b"", values[1:])), (), ())
    assert plan.force_steps_n == pytest.approx((0.01, 0.02))
    assert Plan(axis, axis, (), (), ()).force_steps_n == (0.0, 0.0)


def test_a_run_warns_of_it() -> None:
    run = simulate_run(LINKED, [[0, 0, 0.01], [0.01, 0, 0.009]])
    assert [warning.where for warning in run.warnings] == ["scene.objects.floor"]
    assert "below 80 N/m it would be safe" in run.warnings[0].problem


def written(tmp_path: Path, source: dict[str, Any]) -> str:
    path = tmp_path / "config.yaml"
    path.write_text(json.dumps(source))
    return str(path)


def test_check_says_that_all_is_well(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check"]) == 0
    printed = capsys.readouterr()
    assert "all of the scene can be displayed" in printed.out
    assert printed.err == ""


def test_check_reports_silent_modes_and_unsafe_sets(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = {**LINKED, "scene": {"objects": {"floor": {**FLOOR, "material": "steel"}}}}
    assert main(["check", "-c", written(tmp_path, source)]) == 1
    printed = capsys.readouterr()
    assert "tap of steel, 1682 Hz: silent" in printed.out
    assert "below 80 N/m it would be safe" in printed.out
    assert printed.err == "hapticd: 2 things of the scene cannot be displayed as written, or may oscillate\n"
    assert main(["check", "--json", "-c", written(tmp_path, source)]) == 1
    told = json.loads(capsys.readouterr().out)
    assert told["can_be_shown"] is False
    assert told["link_hz"] == 1000
    (steel,) = [material for material in told["materials"] if material["name"] == "steel"]
    assert steel["used"]
    assert steel["sounds"][0]["shown_hz"] is None
    assert told["stability"]["worst"][0]["objects"] == ["floor"]


def test_check_reports_faults_that_the_daemon_would_refuse(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    grit = {"kind": "stochastic", "peak_hz": 450, "mean_hz": 600, "velocity_gain_per_s": 40}
    source = {
        "servo": {"rate_hz": 1000},
        "materials": {"high": {"stiffness_n_per_m": 100, "texture": grit}},
        "scene": {"objects": {"floor": {**FLOOR, "material": "high"}}},
    }
    assert main(["check", "-c", written(tmp_path, source)]) == 1
    assert "materials.high.texture.mean_hz: must be less than half the servo rate" in capsys.readouterr().out


def test_check_of_a_joystick_that_nobody_knows(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = {"device": {"kind": "hid", "hid": {"path": "/dev/nothing"}}, "scene": LINKED["scene"]}
    assert main(["check", "--offline", written(tmp_path, source)]) == 0
    out = capsys.readouterr().out
    assert "stability: not known: device.handle is not given" in out
    absent = 'device.hid: no HID device with path "/dev/nothing" is connected'
    assert absent not in out
    assert main(["check", "-c", written(tmp_path, source)]) == 1
    assert absent in capsys.readouterr().out
    assert main(["check", "-c", str(tmp_path / "none.yaml")]) == 1
    assert capsys.readouterr().err.count("\n") == 1


def test_sets_of_an_empty_scene() -> None:
    sets = evaluated(config_of({}))
    assert isinstance(sets, ContactSets)
    assert len(sets) == 0
    assert sets.worst(5, unsafe=False) == []
    assert sets.margins([]) == []
