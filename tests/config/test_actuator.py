"""The actuator's lag: the simulated joystick against scipy's matrix exponential, closed forms and small steps."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.linalg import expm

from hapticd.base.core import CData, ffi, lib, pointer
from hapticd.config.actuator import Actuator
from hapticd.config.configuration import Sim, load_config
from hapticd.rendering.joystick import new_sim

LAGS = [
    Actuator(bandwidth_hz=1600),
    Actuator(bandwidth_hz=80),
    Actuator(bandwidth_hz=1600, order=2),
    Actuator(bandwidth_hz=120, order=2, damping_ratio=0.2),
    Actuator(bandwidth_hz=500, order=2, damping_ratio=2),
]


def lag_matrix(actuator: Actuator) -> tuple[np.ndarray, np.ndarray]:
    """Return A and B of y' = A y + B u, from the transfer functions; y[0] is the force."""
    a, zeta = actuator.rate_per_s, actuator.damping_ratio
    if actuator.order == 1:
        return np.array([[-a]]), np.array([a])
    return np.array([[0, 1], [-a * a, -2 * zeta * a]]), np.array([0, a * a])


@pytest.mark.parametrize("actuator", LAGS, ids=str)
def test_the_bandwidth_is_where_3_db_are_lost(actuator: Actuator) -> None:
    matrix, drive = lag_matrix(actuator)
    s = 2j * math.pi * actuator.bandwidth_hz
    shown = np.linalg.solve(s * np.eye(len(drive)) - matrix, drive)[0]
    assert abs(shown) == pytest.approx(math.sqrt(0.5), rel=1e-12)
    assert actuator.at(s) == pytest.approx(shown, rel=1e-12)
    assert actuator.at(0j) == 1


def sim_of(actuator: Actuator | None, rate_hz: float, **more: object) -> CData:
    exact = {"coulomb_friction_n": 0, "force_step_n": 0, "encoder_step_m": 0, "force_timeout_s": 10}
    lag = None if actuator is None else actuator.model_dump()
    return new_sim(Sim.model_validate({**exact, "actuator": lag, **more}), rate_hz)


def driven(sim: CData, force: np.ndarray) -> np.ndarray:
    motion = np.empty((len(force), 4))
    lib.hd_sim_drive(sim, pointer("double[]", force), len(force), pointer("double[]", motion))
    return motion


def truth(sim: CData) -> tuple[list[float], list[float], list[float]]:
    found = tuple(ffi.new("double[2]") for _ in range(3))
    lib.hd_sim_truth(sim, *found)
    return list(found[0]), list(found[1]), list(found[2])


@pytest.mark.parametrize("rate_hz", [1000.0, 10_000.0])
@pytest.mark.parametrize("actuator", LAGS, ids=str)
def test_motion_and_force_are_the_matrix_exponential(actuator: Actuator, rate_hz: float) -> None:
    rng = np.random.default_rng(1)
    force = rng.uniform(-2, 2, (300, 2))
    sim = sim_of(actuator, rate_hz)
    motion = driven(sim, force)
    lag, drive = lag_matrix(actuator)
    mass, damping, stiffness = 0.05, 5.2, 300.0  # the default handle and hand
    size = 2 + len(drive)
    full = np.zeros((size + 1, size + 1))
    full[0, 1] = 1
    full[1, :3] = -stiffness / mass, -damping / mass, 1 / mass
    full[2:size, 2:size], full[2:size, size] = lag, drive
    step = expm(full / rate_hz)
    for axis in (0, 1):
        state = np.zeros(size + 1)
        wanted = np.empty((len(force), 2))
        for tick, push in enumerate(force[:, axis]):
            wanted[tick] = state[:2]
            state[size] = push
            state = step @ state
        assert np.allclose(motion[:, axis], wanted[:, 0], rtol=0, atol=1e-11 * np.abs(wanted[:, 0]).max())
        assert np.allclose(motion[:, 2 + axis], wanted[:, 1], rtol=0, atol=1e-11 * np.abs(wanted[:, 1]).max())
        assert truth(sim)[2][axis] == pytest.approx(state[2], abs=1e-11)


def test_a_resting_handle_moves_once_the_force_exceeds_friction() -> None:
    """With a lag of order 1 the force reaches the friction c after log(u/(u - c))/a."""
    actuator, friction, push, rate = Actuator(bandwidth_hz=50), 0.5, 1.0, 1000.0
    free = {"mass_kg": 0, "stiffness_n_per_m": 0, "damping_n_s_per_m": 0}
    sim = sim_of(actuator, rate, coulomb_friction_n=friction, handle_damping_n_s_per_m=0, hand=free)
    motion = driven(sim, np.full((20, 2), [push, -push]))
    a, mass = actuator.rate_per_s, 0.04
    away = math.log(push / (push - friction)) / a
    for tick in range(20):
        since = max(0.0, tick / rate - away)
        # m v' = u (1 - exp(-a t)) - c from t = away on, where exp(-a away) = (u - c)/u.
        left = (push - friction) / push
        speed = ((push - friction) * since - push * left * (1 - math.exp(-a * since)) / a) / mass
        assert motion[tick, 2] == pytest.approx(speed, abs=1e-12)
        assert motion[tick, 3] == pytest.approx(-speed, abs=1e-12)
    assert motion[1, 2] == motion[2, 2] == 0 < motion[3, 2]


def test_friction_and_lag_by_small_steps() -> None:
    """The complete simulation agrees with semi-implicit Euler steps of 2 us."""
    actuator, rate, friction = Actuator(bandwidth_hz=200, order=2, damping_ratio=0.4), 1000.0, 0.05
    mass, damping, stiffness = 0.05, 5.2, 300.0
    force = np.repeat(np.random.default_rng(4).uniform(-1, 1, (12, 2)), 5, axis=0)
    motion = driven(sim_of(actuator, rate, coulomb_friction_n=friction), force)
    a, zeta, parts = actuator.rate_per_s, actuator.damping_ratio, 500
    step = 1 / rate / parts
    x = v = shown = rise = 0.0
    found = []
    for push in force[:, 0].tolist():
        found.append((x, v))
        for _ in range(parts):
            rise += step * (a * a * (push - shown) - 2 * zeta * a * rise)
            shown += step * rise
            going = v + step / mass * (shown - damping * v - stiffness * x)
            drag = step / mass * friction
            v = 0.0 if abs(going) <= drag else going - math.copysign(drag, going)
            x += step * v
    wanted = np.array(found)
    assert np.abs(motion[:, 0] - wanted[:, 0]).max() < 3e-3 * np.abs(wanted[:, 0]).max()
    assert np.abs(motion[:, 2] - wanted[:, 1]).max() < 3e-3 * np.abs(wanted[:, 1]).max()


@pytest.mark.parametrize("actuator", [LAGS[1], LAGS[3]], ids=str)
def test_many_periods_at_once_equal_single_periods(actuator: Actuator) -> None:
    one, other = (sim_of(actuator, 4000, force_timeout_s=0.011) for _ in range(2))
    for push in ([1.0, -2.0], [-0.5, 0.1]):
        for sim in (one, other):
            lib.hd_sim_put(sim, ffi.new("double[2]", push))
        lib.hd_sim_advance(one, 100)
        for _ in range(100):
            lib.hd_sim_advance(other, 1)
        for alike, single in zip(truth(one), truth(other), strict=True):
            assert alike == pytest.approx(single, rel=1e-9, abs=1e-15)
    # The force has timed out and decayed meanwhile.
    lib.hd_sim_advance(one, 40_000)
    assert truth(one)[2] == [0.0, 0.0]


def test_the_lag_of_a_force_begins_after_the_delay_of_the_link() -> None:
    actuator = Actuator(bandwidth_hz=100)
    link = {"rate_hz": 1000, "delay_frames": 2}
    sim = sim_of(actuator, 1000, link=link)
    lib.hd_sim_put(sim, ffi.new("double[2]", [1.0, 0.0]))
    lib.hd_sim_advance(sim, 2)
    assert truth(sim)[2] == [0.0, 0.0]
    lib.hd_sim_advance(sim, 1)
    assert truth(sim)[2][0] == pytest.approx(1 - math.exp(-actuator.rate_per_s / 1000))


def test_the_lag_is_the_simulated_one_unless_another_is_given() -> None:
    lag = {"bandwidth_hz": 1600, "order": 2}
    assert load_config({}).device.lag is None
    assert load_config({"device": {"sim": {"actuator": lag}}}).device.lag == Actuator(**lag)  # type: ignore[arg-type]
    other = {"sim": {"actuator": lag}, "actuator": {"bandwidth_hz": 500}}
    assert load_config({"device": other}).device.lag == Actuator(bandwidth_hz=500)
    hid = {"kind": "hid", "sim": {"actuator": lag}, "effective_mass_kg": 0.1}
    assert load_config({"device": hid}).device.lag is None


@pytest.mark.parametrize(
    ("order", "rate", "fault"), [(3, 1e3, "actuator_order: 3"), (1, 0.0, "actuator_order: 1"), (1, 1e7, "is too fast")]
)
def test_impossible_lags_are_refused(order: int, rate: float, fault: str) -> None:
    from hapticd.base.core import invalid_reason

    config = ffi.new("struct hd_sim_config *")
    config.handle_mass_kg, config.workspace_m, config.force_timeout_s = 0.04, 0.075, 0.1
    config.actuator_order, config.actuator_rate_per_s = order, rate
    assert lib.hd_sim_new(config, 1e-3) == ffi.NULL
    assert fault in invalid_reason()
