"""Energy, error of the loop and error of the onset, each compared with a closed form or a separate integrator."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from bench import closed_loop
from bench.passivity import draw, simulated
from hapticd.base.core import EventKind
from hapticd.base.errors import HapticdError
from hapticd.sweeps.columns import Row
from hapticd.sweeps.keys import Run
from hapticd.sweeps.measures.continuous_wall import ContinuousWall, WallLoop
from hapticd.sweeps.measures.registry import parse_measure
from hapticd.sweeps.point import Point
from tests.support.marks import rest_slow
from tests.sweeps.results_of import FLOOR

EXACT = {"encoder_step_m": 0, "force_step_n": 0, "coulomb_friction_n": 0, "max_force_n": 100}


def document(stiffness: float, operator: dict[str, Any], **keys: Any) -> dict[str, Any]:
    return {
        "servo": {"rate_hz": keys.pop("rate_hz", 1000)},
        "device": {"max_force_n": keys.pop("max_force_n", 100), "sim": {**EXACT, **keys.pop("sim", {})}},
        "materials": {"m": {"stiffness_n_per_m": stiffness, **keys.pop("material", {})}},
        "scene": {"objects": {"floor": FLOOR, **keys.pop("objects", {})}},
        "operator": operator,
        **keys,
    }


def measured(name: str, given: dict[str, Any], run: Run = "simulate") -> Row:
    measure = parse_measure(name)
    found = measure.of(Point(given, run))
    assert list(found) == [column.name for column in measure.columns]
    return found


# ---- Energy ----------------------------------------------------------------------------------------------------------


def test_a_sampled_spring_gives_k_times_step_squared_for_each_tick_of_the_path() -> None:
    """In by N steps s, and out again: the sum of K i s s over i = N..1 minus that over 0..N-1 is K s^2 N."""
    step_m, steps, stiffness = 2.0**-14, 64, 500.0
    turn_s = steps / 1000
    way = {"waypoints": [[0, 0, 0], [turn_s, 0, -step_m * steps], [2 * turn_s, 0, 0], [2 * turn_s + 0.01, 0, 0.001]]}
    found = measured("energy_given", document(stiffness, way), "render")
    assert found["energy_given_j"] == pytest.approx(stiffness * step_m**2 * steps, rel=1e-9)


def test_force_above_the_limit_gives_no_energy() -> None:
    """A wall limited to F from the first step on takes F s in each of N - 1 steps in, and gives it in each of N out."""
    step_m, steps, limit_n = 2.0**-14, 64, 0.5
    turn_s = steps / 1000
    way = {"waypoints": [[0, 0, 0], [turn_s, 0, -step_m * steps], [2 * turn_s, 0, 0], [2 * turn_s + 0.01, 0, 0.001]]}
    found = measured("energy_given", document(1e5, way, max_force_n=limit_n), "render")
    assert found["energy_given_j"] == pytest.approx(limit_n * step_m, rel=1e-9)


def test_a_wall_with_damping_that_outweighs_the_hold_gives_nothing() -> None:
    """With D > K T/2 and a constant speed, damping takes more energy at every step than the hold gives."""
    way = {"waypoints": [[0, 0, 0.001], [0.1, 0, -0.004], [0.2, 0, 0.001]]}
    found = measured("energy_given", document(500, way, material={"damping_n_s_per_m": 0.3}), "render")
    assert found["energy_given_j"] == 0.0


def test_a_constant_force_gives_no_energy() -> None:
    way = {"waypoints": [[0, 0, 0], [0.05, 0, -0.004], [0.1, 0, 0], [0.12, 0, 0.001]]}
    push = {"push": {"kind": "constant", "force_n": [0.1, -0.2]}}
    alone = measured("energy_given", document(500, way), "render")
    pushed = measured("energy_given", document(500, way, objects=push), "render")
    assert pushed["energy_given_j"] == pytest.approx(alone["energy_given_j"], rel=1e-9)
    spring = {"pull": {"kind": "spring", "center_m": [0, 0], "stiffness_n_per_m": 50}}
    with pytest.raises(HapticdError, match="must not have fields, has pull"):
        measured("energy_given", document(500, way, objects=spring), "render")


@pytest.mark.parametrize("seed", range(4))
def test_the_energy_of_a_closed_loop_is_that_of_the_passivity_observer(seed: int) -> None:
    """The observer sums over reported positions, which here are exact and without delay."""
    case = draw(seed, "exact")
    source = case.config("observe") | {"servo": {"rate_hz": case.rate_hz}, "operator": {"waypoints": case.waypoints()}}
    observed = simulated(case, "observe").energy
    found = measured("energy_given", source)
    assert found["energy_given_j"] == pytest.approx(max(0.0, observed.largest_j), rel=1e-9, abs=1e-15)


# ---- The loop --------------------------------------------------------------------------------------------------------


def integrated(loop: WallLoop, reference: Any, speed: Any, start_m: float, times: Any) -> Any:
    """Return height and force of the continuous loop by numerical integration."""

    def pressed(y: float, v: float) -> float:
        return max(0.0, -loop.wall_stiffness_n_per_m * y - loop.wall_damping_n_s_per_m * v) if y < 0 else 0.0

    def slope(t: float, state: Any) -> list[float]:
        y, v = state
        hand = loop.hand_stiffness_n_per_m * (reference(t) - y) + loop.hand_damping_n_s_per_m * (speed(t) - v)
        return [v, (hand - loop.damping_n_s_per_m * v + loop.push_n + pressed(y, v)) / loop.mass_kg]

    found = solve_ivp(
        slope, (0, times[-1]), [start_m, 0.0], "DOP853", t_eval=times, rtol=1e-10, atol=1e-13, max_step=2e-4
    )
    return found.y[0], np.array([pressed(y, v) for y, v in found.y.T])


@pytest.mark.long
@pytest.mark.parametrize(
    "loop",
    rest_slow(
        [
            WallLoop(0.05, 0.2, 300.0, 5.0, 800.0, 2.0, 0.0),
            WallLoop(0.05, 0.2, 300.0, 0.0, 2000.0, 8.0, 0.0),  # bounces; the damper would pull if F could be below 0
            WallLoop(0.05, 20.0, 300.0, 5.0, 800.0, 0.0, 0.0),  # overdamped
            WallLoop(0.04, 0.2, 0.0, 0.0, 500.0, 1.0, -0.5),  # a free handle that a force pushes
            WallLoop(0.04, 0.0, 0.0, 0.0, 500.0, 1.0, -0.5),  # the same without damping
        ],
        fast=2,
    ),
)
@pytest.mark.parametrize("minimum_jerk", [False, True])
def test_the_continuous_loop_agrees_with_an_integrator(loop: WallLoop, minimum_jerk: bool) -> None:
    """The reference moves from 4 mm to -8 mm in 0.12 s, and then rests."""
    ends_s, begin, travel = 0.12, 0.004, -0.012

    def reference(t: float) -> float:
        s = min(t / ends_s, 1.0)
        return begin + travel * (s**3 * (10 - 15 * s + 6 * s * s) if minimum_jerk else s)

    def speed(t: float) -> float:
        s = t / ends_s
        if s >= 1.0:
            return 0.0
        return travel / ends_s * (30 * s * s * (1 - s) ** 2 if minimum_jerk else 1.0)

    times = np.arange(1, 2500) * 1e-4
    way = np.array([[0.0, begin], [ends_s, begin + travel]])
    height, force = ContinuousWall(loop, way, minimum_jerk, 0.25, 5e-5).at(times)
    expected, pressed = integrated(loop, reference, speed, begin, times)
    assert height == pytest.approx(expected, abs=1e-8)
    # Rounding may shift a touch, and with it the force D v, by a tick.
    assert np.quantile(np.abs(force - pressed), 0.99) < 1e-4


@pytest.mark.parametrize("rate_hz", [1000.0, 10_000.0])
@pytest.mark.parametrize("name", list(closed_loop.LOOPS))
def test_the_error_of_the_loop_agrees_with_the_benchmark(name: str, rate_hz: float) -> None:
    """The closed form of the benchmark is computed separately, with another search for the touch."""
    loop = closed_loop.LOOPS[name]
    times, height, force = closed_loop.simulated(loop, rate_hz)
    true_height, _, true_force = closed_loop.Continuous(loop).at(times)
    hand = {"mass_kg": 0.2 * loop.mass, "stiffness_n_per_m": loop.hand_stiffness,
            "damping_n_s_per_m": loop.hand_damping}  # fmt: skip
    sim = {"handle_mass_kg": 0.8 * loop.mass, "handle_damping_n_s_per_m": loop.handle_damping, "hand": hand}
    given = document(loop.stiffness, {"waypoints": loop.waypoints()}, rate_hz=rate_hz, sim=sim,
                     material={"damping_n_s_per_m": loop.damping})  # fmt: skip
    found = measured("loop_error", given)
    depth = np.maximum(0, -height) - np.maximum(0, -true_height)
    assert found["loop_force_error_n"] == pytest.approx(np.abs(force - true_force).max(), rel=1e-6)
    assert found["loop_penetration_error_m"] == pytest.approx(np.abs(depth).max(), rel=1e-6)


def test_the_error_is_of_first_order_in_the_period() -> None:
    operator = {"waypoints": [[0, 0, 0.004], [0.12, 0, -0.008], [0.17, 0, -0.008]]}
    errors = [measured("loop_error", document(800, operator, rate_hz=rate)) for rate in (2500.0, 5000.0, 10_000.0)]
    depths = [float(each["loop_penetration_error_m"] or 0) for each in errors]
    orders = np.diff(np.log(depths)) / -math.log(2)
    assert orders == pytest.approx([1.0, 1.0], abs=0.25)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sim": {"coulomb_friction_n": 0.1}}, "device.sim.coulomb_friction_n: 0"),
        ({"objects": {"other": {**FLOOR, "normal": [1, 0]}}}, "the scene must have one wall, has 2"),
        ({"objects": {"honey": {"kind": "viscous", "damping_n_s_per_m": 1}}}, "honey is neither"),
        ({"material": {"friction": {"coefficient": 0.3}}}, "a wall without friction: the material m has friction"),
        (
            {"material": {"tap": {"attack_slope_per_s": 100, "frequency_hz": 100, "decay_time_s": 0.01}}},
            "scene.display.vibration: false",
        ),
        ({"operator": {"waypoints": [[0, 0, -0.001], [0.1, 0, 0.01]]}}, "begins above the wall"),
    ],
)
def test_a_loop_without_a_closed_form_is_refused(change: dict[str, Any], message: str) -> None:
    operator = {"waypoints": [[0, 0, 0.004], [0.12, 0, -0.008]]}
    given = document(800, **{"operator": operator, **change}, rate_hz=10_000)
    with pytest.raises(HapticdError, match=message):
        measured("loop_error", given)
    with pytest.raises(HapticdError, match="run: simulate"):
        measured("loop_error", given, "render")


# ---- The onset -------------------------------------------------------------------------------------------------------


def test_the_onset_of_a_straight_path_is_exact() -> None:
    found = measured("onset_error", document(500, {"waypoints": [[0, 0, 0.00123], [0.1, 0, -0.004]]}), "render")
    assert found["onsets"] == 1 and abs(float(found["onset_error_s"] or 0)) < 1e-12


def test_the_onset_of_a_curved_path_has_the_error_of_the_chord() -> None:
    """The error is the zero of the chord between two ticks minus the zero of the minimum-jerk path, here at 1 kHz."""
    begin, end, duration, rate = 0.004, -0.002, 0.1, 1000.0

    def height(t: float) -> float:
        s = t / duration
        return begin + (end - begin) * s**3 * (10 - 15 * s + 6 * s * s)

    root = brentq(height, 0, duration, xtol=1e-16)
    tick = math.ceil(root * rate)
    before, after = height((tick - 1) / rate), height(tick / rate)
    chord = (tick - 1 + before / (before - after)) / rate
    operator = {"waypoints": [[0, 0, begin], [duration, 0, end]], "interpolation": "minimum_jerk"}
    found = measured("onset_error", document(500, operator, rate_hz=rate), "render")
    assert abs(chord - root) > 1e-7
    assert found["onset_error_s"] == pytest.approx(chord - root, abs=1e-11)


def test_the_onset_of_a_delayed_report_is_late_by_the_delay() -> None:
    """The true crossing is in closed form; the reported onset is that of the chord, 3 ms later."""
    loop = WallLoop(0.05, 0.2, 300.0, 5.0, 500.0, 0.0, 0.0)
    operator = {"waypoints": [[0, 0, 0.004], [0.12, 0, -0.008]]}
    delayed = measured("onset_error", document(500, operator, sim={"report_delay_s": 0.003}))
    prompt = measured("onset_error", document(500, operator))
    free = ContinuousWall(loop, np.array([[0, 0.004], [0.12, -0.008]]), False, 0.12, 1e-4)

    def height(t: float) -> float:
        return float(free.at(np.array([t]))[0][0])

    root = brentq(height, 0, 0.11, xtol=1e-15)
    tick = math.ceil(root * 1000)
    before, after = height((tick - 1) / 1000), height(tick / 1000)
    # The second height is below the surface, as without contact.
    assert prompt["onset_error_s"] == pytest.approx((tick - 1 + before / (before - after)) / 1000 - root, abs=1e-6)
    assert delayed["onset_error_s"] == pytest.approx(0.003 + float(prompt["onset_error_s"] or 0), abs=2e-6)


@pytest.mark.parametrize(
    ("item", "crossed_s"),
    [
        # Along x = 2 mm from y = 20 mm down at 0.1 m/s.
        ({"kind": "disc", "center_m": [0, 0], "radius_m": 0.005}, (0.02 - math.sqrt(0.005**2 - 0.002**2)) / 0.1),
        ({"kind": "box", "center_m": [0, 0], "size_m": [0.02, 0.01]}, (0.02 - 0.005) / 0.1),
        # A square rotated by 45 degrees, |x| + |y| = side/sqrt 2.
        (
            {"kind": "box", "center_m": [0, 0], "size_m": [0.01, 0.01], "angle_rad": math.pi / 4},
            (0.02 - (0.01 / math.sqrt(2) - 0.002)) / 0.1,
        ),
    ],
)
def test_the_crossing_of_other_shapes(item: dict[str, Any], crossed_s: float) -> None:
    operator = {"waypoints": [[0, 0.002, 0.02], [0.3, 0.002, -0.01]]}
    given = document(100, operator, rate_hz=10_000)
    given["scene"] = {"objects": {"it": {**item, "material": "m"}}}
    point = Point(given, "render")
    (event,) = point.run.events[point.run.events["kind"] == EventKind.CONTACT]
    reported_s = int(event["tick"]) / 10_000 - float(event["before_tick_s"])
    found = measured("onset_error", given, "render")
    assert found["onsets"] == 1
    assert found["onset_error_s"] == pytest.approx(reported_s - crossed_s, abs=1e-12)


def test_without_a_touch_there_is_no_error_and_a_membrane_is_refused() -> None:
    away = {"waypoints": [[0, 0, 0.01], [0.1, 0, 0.02]]}
    assert measured("onset_error", document(100, away), "render") == {"onset_error_s": None, "onsets": 0}
    given = document(100, {"waypoints": [[0, 0, 0.01], [0.1, 0, -0.005]]})
    given["scene"] = {"objects": {"skin": {"kind": "membrane", "center_m": [0, 0], "normal": [0, 1],
                                           "width_m": 0.02, "material": "m"}}}  # fmt: skip
    with pytest.raises(HapticdError, match="a membrane can be touched from both sides"):
        measured("onset_error", given, "render")
