"""Compensated taps in the closed loop: a hand comes at a constant speed and stops behind the surface.

What is displayed is the motion of the handle minus that of the same tap without vibration (bench/kept_taps.py), in the
simulated joystick without dry friction and steps.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import minimize

from bench.kept_taps import Tap, displayed, random_tap
from hapticd.config.configuration import load_config
from hapticd.config.dynamics import Dynamics
from hapticd.config.materials import shipped_materials
from hapticd.rendering.compensation import Load, bounded_least_squares
from hapticd.rendering.device_output import output_of
from hapticd.rendering.displayability import preload_notes
from hapticd.rendering.kept_contact import KeptTap, kept_tap
from hapticd.rendering.offline import render

LIGHT, DEFAULT, FIRM = (0.005, 2.0, 100.0), (0.01, 5.0, 300.0), (0.02, 10.0, 600.0)
WALL_N_PER_M = 800.0


def tap(material: str, hand: tuple[float, float, float], speed: float, depth: float) -> Tap:
    found = shipped_materials()[material].to_dict()
    return Tap({key: found[key] for key in ("stiffness_n_per_m", "tap")}, hand, speed, depth)


@pytest.mark.parametrize(
    "struck",
    [
        tap("wood", LIGHT, 0.1, 0.005),
        tap("wood", LIGHT, 0.4, 0.02),
        tap("delrin", LIGHT, 0.4, 0.02),
        tap("wood", DEFAULT, 0.2, 0.003),
        tap("wood", DEFAULT, 0.4, 0.003),
        tap("delrin", DEFAULT, 0.3, 0.003),
        tap("wood", FIRM, 0.4, 0.003),
    ],
    ids=str,
)
def test_a_compensated_tap_stays_where_one_without_stays(struck: Tap) -> None:
    """They were tapped two to four times, with errors of 36 to 48 %."""
    still, off, full = displayed(struck)
    assert still == off.contacts == full.contacts == 1
    assert full.error < 0.5 * off.error


@pytest.mark.parametrize("hand", [LIGHT, DEFAULT, FIRM], ids=str)
@pytest.mark.parametrize("material", ["wood", "acrylic", "delrin"])
def test_a_hand_that_presses_long_gets_the_complete_compensation(
    material: str, hand: tuple[float, float, float]
) -> None:
    _, off, full = displayed(tap(material, hand, 0.2, 0.01))
    assert off.contacts == full.contacts == 1
    assert full.error < 0.105


def test_a_kept_tap_never_lifts_the_handle_higher_than_a_plain_one() -> None:
    """For any hand: the motion by the matrix exponential without a push."""
    kept, dynamics, _ = kept_of("wood", DEFAULT)
    mode = shipped_materials()["wood"].tap.mode
    pole = complex(-mode.decay_rate_per_s, mode.angular_frequency_rad_per_s)
    time = 1e-4 * np.arange(2000)
    forces = [
        sum((part.gain * np.exp(part.pole * time)).imag * (time <= part.end_s) for part in kept.kept[0].parts),
        np.exp(pole * time).imag * (time <= 5 / mode.decay_rate_per_s),
    ]
    mass, stiffness = dynamics.mass_kg, dynamics.grip_stiffness_n_per_m + WALL_N_PER_M
    law = np.array([[0, 1, 0], [-stiffness / mass, -dynamics.damping_n_s_per_m / mass, 1], [0, 0, 0]])
    step = expm(law * 1e-4)
    heights = []
    for force in forces:
        state, found = np.zeros(3), []
        for each in force:
            state[2] = each
            state = step @ state
            found.append(state[0])
        heights.append(np.array(found))
    assert (heights[0] - heights[1]).max() <= 0.02 * heights[1].max()


def test_random_taps() -> None:
    random = np.random.default_rng(4)
    for _ in range(12):
        still, off, full = displayed(random_tap(random))
        if still == off.contacts == 1:
            assert full.contacts == 1
            assert full.error <= off.error


def kept_of(material: str, hand: tuple[float, float, float]) -> tuple[KeptTap, Dynamics, float]:
    struck = shipped_materials()[material].tap
    assert struck is not None
    dynamics, slope = Dynamics(0.04, 0.2, 0.0, *hand), struck.largest_slope_per_s
    found = kept_tap(((struck.mode, slope),), dynamics, 10_000.0, Load(WALL_N_PER_M), True)
    assert found is not None
    return found, dynamics, slope


@pytest.mark.parametrize("hand", [LIGHT, DEFAULT, FIRM])
@pytest.mark.parametrize("material", ["wood", "delrin"])
def test_depths_are_those_of_a_motion_by_the_matrix_exponential(
    material: str, hand: tuple[float, float, float]
) -> None:
    """A hand that stops when the design says: the depth of the full force is `full_depth_s`, and nowhere 0."""
    kept, dynamics, slope = kept_of(material, hand)
    period, count = 1e-4, 2000
    mass, stiffness = dynamics.mass_kg, dynamics.grip_stiffness_n_per_m
    law = np.array([[0, 1, 0], [-stiffness / mass, -dynamics.damping_n_s_per_m / mass, 1 / mass], [0, 0, 0]])
    step = expm(law * period)
    time = period * np.arange(count)
    force = np.zeros(count)
    for part in kept.full[0].parts:
        force += (part.gain * np.exp(part.pole * time)).imag * (time <= part.end_s)
    state, depths = np.array([0.0, 1.0, 0.0]), [0.0]
    own = dynamics.handle_damping_n_s_per_m
    for at, pushed in zip(time + period / 2, slope * mass * force, strict=True):
        hand_n = own + stiffness * min(at, kept.full_s) + dynamics.grip_damping_n_s_per_m * (at < kept.full_s)
        state[2] = hand_n - WALL_N_PER_M * state[0] - pushed
        state = step @ state
        depths.append(state[0])
    moved = np.array(depths)
    assert moved[1:].min() > -5e-5
    judged = np.array(kept.full_depth_s) > np.array(kept.kept_depth_s)
    times = kept.step_s * np.arange(1, len(judged) + 1)
    expected = np.interp(times[judged], period * np.arange(count + 1), moved)
    assert np.abs(expected - np.array(kept.full_depth_s)[judged]).max(initial=0.0) < 2e-4


def test_bounded_least_squares_against_scipy() -> None:
    random = np.random.default_rng(1)
    for _ in range(20):
        columns, target = random.normal(size=(12, 4)), random.normal(size=12)
        rows, bounds = random.normal(size=(9, 4)), random.uniform(0.0, 0.3, 9)
        found = bounded_least_squares(columns, target, rows, bounds)
        assert found is not None
        assert (rows @ found <= bounds + 1e-9).all()
        best = minimize(
            lambda x, a=columns, b=target: float(((a @ x - b) ** 2).sum()),
            np.zeros(4),
            constraints={"type": "ineq", "fun": lambda x, a=rows, b=bounds: b - a @ x},
        )
        assert ((columns @ found - target) ** 2).sum() <= best.fun * (1 + 1e-6) + 1e-9
    assert bounded_least_squares(np.eye(1), np.zeros(1), np.array([[1.0], [-1.0]]), np.array([-1.0, -1.0])) is None


@pytest.mark.parametrize("last", [[0.0, 0.0, 0.0], [2.0, 4.0, 6.0]])
def test_bounded_least_squares_refuses_dependent_columns(last: list[float]) -> None:
    columns = np.array([[1.0, 2.0, 3.0], last]).T
    assert bounded_least_squares(columns, np.ones(3), np.eye(2), np.ones(2)) is None


@pytest.mark.parametrize(("rate_hz", "slow_link"), [(1000.0, False), (60.0, True)])
def test_a_tap_that_ends_before_its_second_sample_has_finite_forces(rate_hz: float, slow_link: bool) -> None:
    """It was refused by the core: gain (nan, nan)."""
    link = {"link": {"rate_hz": rate_hz}} if slow_link else {}
    device = {"kind": "sim", "compensation": "full", "sim": {"handle_mass_kg": 0.1, **link}}
    click = {"frequency_hz": 20, "decay_time_s": 4e-5, "attack_slope_per_s": 100}
    config = load_config(
        {
            "servo": {"rate_hz": 1000},
            "device": device,
            "materials": {"click": {"stiffness_n_per_m": WALL_N_PER_M, "tap": click}},
            "scene": {"objects": {"wall": {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "click"}}},
        }
    )
    depth = np.linspace(-0.001, 0.001, 50)
    force = render(config, np.column_stack((0 * depth, -depth)))["force_n"]
    assert np.isfinite(force).all()
    assert force[-1, 1] > 0.0


def test_check_says_from_which_depth_on_the_compensation_is_complete() -> None:
    config = load_config({"device": {"compensation": "full"}})
    wood = {"wood": shipped_materials()["wood"]}
    kept, *_ = kept_of("wood", DEFAULT)
    (note,) = preload_notes(wood, output_of(config, 10_000.0), 0.2)
    assert note.where == "materials.wood.tap"
    assert f"{1e3 * kept.full_s:.2g} ms after the onset, {200 * kept.full_s:.2g} mm deep at 0.2 m/s" in note.problem
    assert not preload_notes(wood, output_of(load_config({}), 10_000.0), 0.2)
    # A hand that stops a little later than it says is displayed with the error that it says; one that stops earlier
    # is not.
    late, early = (displayed(tap("wood", DEFAULT, 0.2, 0.2 * part * kept.full_s))[2] for part in (1.3, 0.75))
    assert late.error == pytest.approx(kept.full[0].error, abs=0.01)
    assert late.error < early.error
    assert late.contacts == early.contacts == 1
