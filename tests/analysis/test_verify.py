"""`verify`: the displayed error against scipy's response of the linear device, and recordings of it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import signal

from hapticd.analysis.calibration import verify
from hapticd.analysis.calibration.accelerometer import Recording
from hapticd.analysis.calibration.sweep import Axis
from hapticd.analysis.calibration.verify import Comparison, Played, Strike
from hapticd.analysis.statistics import Floats
from hapticd.base.core import lib, pointer
from hapticd.base.errors import HapticdError
from hapticd.config.configuration import Config, load_config
from hapticd.config.modes import Mode
from hapticd.rendering.displayability import strike_error
from hapticd.rendering.joystick import new_sim


def config_of(rate_hz: float = 10_000, **sim: object) -> Config:
    exact = {"coulomb_friction_n": 0, "force_step_n": 0, "encoder_step_m": 0}
    return load_config({"servo": {"rate_hz": rate_hz}, "device": {"kind": "sim", "sim": {**exact, **sim}}})


WOOD = Strike("wood", "tap", Mode(1 / 0.00648, 2 * math.pi * 67), 30.9)
STEEL = Strike("steel", "tap", Mode(1 / 0.00032, 2 * math.pi * 1682), 169.2)


def displayed(config: Config, *strikes: Strike) -> tuple[Played, list[Comparison]]:
    played = verify.play(config, list(strikes), "y")
    return played, verify.from_simulation(config, played)


def error_by_scipy(config: Config, strike: Strike) -> float:
    """The handle's acceleration in fine steps by lsim, band limited by the transform of all of it."""
    device, rate, finer = config.device.dynamics, config.servo.rate_hz, 16
    assert device is not None
    mass, damping = device.mass_kg, device.damping_n_s_per_m
    count = round((5 / strike.mode.decay_rate_per_s + verify.SIMULATION_TAIL_S) * rate)
    time_s = np.arange(count) / rate
    decay, omega = strike.mode.decay_rate_per_s, strike.mode.angular_frequency_rad_per_s
    force = mass * strike.coefficient_m_per_s2 * np.exp(-decay * time_s) * np.sin(omega * time_s)
    force[time_s > 5 / decay] = 0
    held = np.repeat(force, finer)
    fine_s = np.arange(len(held)) / (rate * finer)
    law = signal.lti([1, 0], [mass, damping, device.grip_stiffness_n_per_m])
    _, speed, _ = signal.lsim(law, held, fine_s, interp=False)
    acceleration = np.gradient(speed, fine_s)
    wanted = strike.coefficient_m_per_s2 * np.exp(-decay * fine_s) * np.sin(omega * fine_s)
    frequency = np.fft.rfftfreq(1 << 20, fine_s[1])
    inside = (frequency >= 30) & (frequency <= 0.4 * rate)
    one, other = (np.fft.rfft(each, 1 << 20)[inside] for each in (acceleration, wanted))
    return float(np.linalg.norm(one - other) / np.linalg.norm(other))


@pytest.mark.long
@pytest.mark.parametrize("strike", [WOOD, STEEL], ids=["wood", "steel"])
def test_the_simulated_handle(strike: Strike) -> None:
    config = config_of()
    _, (verdict,) = displayed(config, strike)
    assert verdict.error == pytest.approx(error_by_scipy(config, strike), abs=0.01)
    assert verdict.displayed_hz == pytest.approx(strike.mode.frequency_hz)


def wall_error_by_scipy(config: Config, force_n: Floats, stiffness_n_per_m: float, strike: Strike) -> float:
    """The handle under forces (n,) that are held, and a spring whose force is held, too; as error_by_scipy."""
    device, rate, finer = config.device.dynamics, config.servo.rate_hz, 16
    assert device is not None
    mass, damping, grip = device.mass_kg, device.damping_n_s_per_m, device.grip_stiffness_n_per_m
    law = np.array([[0, 1], [-grip / mass, -damping / mass]])
    system = (law, np.array([[0], [1 / mass]]), np.eye(2), np.zeros((2, 1)))
    a, b, *_ = signal.cont2discrete(system, 1 / (rate * finer))
    state, speeds = np.zeros(2), [0.0]
    for force in force_n:
        pushed = b[:, 0] * (force - stiffness_n_per_m * state[0])
        for _ in range(finer):
            state = a @ state + pushed
            speeds.append(float(state[1]))
    acceleration = np.diff(speeds) * rate * finer
    time_s = (np.arange(len(acceleration)) + 0.5) / (rate * finer)
    decay, omega = strike.mode.decay_rate_per_s, strike.mode.angular_frequency_rad_per_s
    wanted = strike.coefficient_m_per_s2 * np.exp(-decay * time_s) * np.sin(omega * time_s)
    frequency = np.fft.rfftfreq(1 << 20, 1 / (rate * finer))
    inside = (frequency >= 30) & (frequency <= 0.4 * rate)
    one, other = (np.fft.rfft(each, 1 << 20)[inside] for each in (acceleration, wanted))
    return float(np.linalg.norm(one - other) / np.linalg.norm(other))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["wood", "steel"])
@pytest.mark.parametrize("compensation", ["off", "full"])
def test_a_tap_on_a_wall(name: str, compensation: str) -> None:
    exact = {"coulomb_friction_n": 0, "force_step_n": 0, "encoder_step_m": 0}
    config = load_config({"device": {"kind": "sim", "compensation": compensation, "sim": exact}})
    verdict = next(each for each in verify.compare_on_walls(config) if each.strike.material == name)
    count = round((5 / verdict.strike.mode.decay_rate_per_s + verify.SIMULATION_TAIL_S) * 10_000)
    force = verify.tap_force(config, name, 0.1, count)[:, 1]
    expected = wall_error_by_scipy(config, force, 800.0, verdict.strike)
    # The error is largest at 30 Hz, where the lines of the two transforms begin at different places.
    assert verdict.error == pytest.approx(expected, abs=5e-3)
    assert verdict.error < 0.1 or compensation == "off"


@pytest.mark.parametrize("axis", ["x", "y"])
def test_a_tap_along_the_wall_does_not_meet_it(axis: Axis) -> None:
    """Along the tangent nothing pushes: as with nothing touched, along either axis."""
    tap = {"attack_slope_per_s": 300, "frequency_hz": 93, "decay_time_s": 0.0064, "direction": "tangent"}
    it = load_config({"materials": {"it": {"stiffness_n_per_m": 800, "tap": tap}}}).materials["it"]
    config = config_of().model_copy(update={"materials": {"it": it}})
    _, (free,) = displayed(config, *verify.strikes_of(config.materials))
    (walled,) = verify.compare_on_walls(config, axis=axis)
    assert walled.error == pytest.approx(free.error, rel=1e-4)


def test_taps_on_walls_are_compared_if_the_wall_pushes_and_the_mode_is_displayable() -> None:
    tap = {"attack_slope_per_s": 10, "frequency_hz": 100, "decay_time_s": 0.002}
    given = {"firm": {"stiffness_n_per_m": 500, "tap": tap}, "soft": {"stiffness_n_per_m": 0, "tap": tap}}
    known = load_config({"materials": given}).materials
    config = config_of(2000).model_copy(update={"materials": {name: known[name] for name in (*given, "steel")}})
    told = {each.strike.material: each for each in verify.compare_on_walls(config)}
    assert "soft" not in told and told["firm"].strike.use == "wall"
    assert (told["steel"].displayed_hz, told["steel"].error) == (None, 1.0)
    sideways = {each.strike.material: each for each in verify.compare_on_walls(config, axis="x")}
    assert sideways["firm"].error == pytest.approx(told["firm"].error, rel=1e-9)


def test_a_mass_alone_displays_modes_accurately() -> None:
    """Without a hand and damping, but for the hold of the force: half a period late."""
    free = {"mass_kg": 0, "stiffness_n_per_m": 0, "damping_n_s_per_m": 0}
    _, (verdict,) = displayed(config_of(handle_damping_n_s_per_m=0, hand=free), WOOD)
    assert verdict.error < 0.05
    assert verdict.strength == pytest.approx(1, abs=0.01)


def test_a_link_is_late_and_that_is_no_error() -> None:
    config = config_of(1000, link={"rate_hz": 1000, "delay_frames": 3})
    _, (late,) = displayed(config, WOOD)
    _, (at_once,) = displayed(config_of(1000), WOOD)
    assert late.error == pytest.approx(at_once.error, rel=1e-3)


def error_through_a_link_by_numpy(config: Config, played: Played, strike: Strike, begin: int) -> float:
    """RMS over a strike at every tick of a frame: the last force before each frame, held for a frame from then on."""
    link, rate, finer = config.device.sim.link, config.servo.rate_hz, 16
    assert link is not None
    ticks = round(rate / link.rate_hz)
    device = config.device.dynamics
    assert device is not None
    law = signal.lti([1, 0], [device.mass_kg, device.damping_n_s_per_m, device.grip_stiffness_n_per_m])
    count = round((5 / strike.mode.decay_rate_per_s + verify.SIMULATION_TAIL_S) * rate)
    decay, omega = strike.mode.decay_rate_per_s, strike.mode.angular_frequency_rad_per_s
    fine_s = np.arange(count * finer) / (rate * finer)
    wanted = strike.coefficient_m_per_s2 * np.exp(-decay * fine_s) * np.sin(omega * fine_s)
    frequency = np.fft.rfftfreq(1 << 20, fine_s[1])
    inside = (frequency >= 30) & (frequency <= 0.4 * link.rate_hz)
    reference = np.fft.rfft(wanted, 1 << 20)[inside]
    squares = []
    for late in range(ticks):
        sent = (np.arange(count) - late) // ticks * ticks + late  # the tick whose force acts, after the strike
        held = np.where(sent < 0, 0.0, played.force_n[begin + np.maximum(sent, 0), played.along])
        _, speed, _ = signal.lsim(law, np.repeat(held, finer), fine_s, interp=False)
        shown = np.fft.rfft(np.gradient(speed, fine_s), 1 << 20)[inside]
        squares.append(np.linalg.norm(shown - reference) ** 2 / np.linalg.norm(reference) ** 2)
    return math.sqrt(sum(squares) / len(squares))


@pytest.mark.long
@pytest.mark.parametrize("compensation", ["off", "full"])
@pytest.mark.parametrize("link_hz", [500, 1000, 2000])
def test_a_slow_link_samples_a_strike_at_any_time(link_hz: float, compensation: str) -> None:
    """`verify` has the error of numpy's link, and `check` the same: compensation was for frames, and for ticks."""
    config = config_of(handle_mass_kg=0.1, link={"rate_hz": link_hz})
    device = config.device.model_copy(update={"compensation": compensation})
    config = config.model_copy(update={"device": device})
    played, (verdict,) = displayed(config, WOOD)
    assert verdict.error == pytest.approx(
        error_through_a_link_by_numpy(config, played, WOOD, played.begins[0]), abs=0.01
    )
    assert strike_error(WOOD.mode, played.output) == pytest.approx(verdict.error, abs=0.01)


@pytest.mark.parametrize(("link_hz", "most"), [(500, 0.16), (1000, 0.07), (2000, 0.03), (8000, 0.03)])
def test_compensation_behind_a_slow_link_lessens_the_error(link_hz: float, most: float) -> None:
    errors = {}
    for compensation in ("off", "full"):
        config = config_of(handle_mass_kg=0.1, link={"rate_hz": link_hz})
        device = config.device.model_copy(update={"compensation": compensation})
        _, (verdict,) = displayed(config.model_copy(update={"device": device}), WOOD)
        errors[compensation] = verdict.error
    assert errors["full"] < min(most, 0.5 * errors["off"])


@pytest.mark.parametrize(("rate_hz", "link_hz"), [(1000, 999.7), (8000, 7999.99), (10_000, 3333), (1000, 1001)])
def test_a_link_whose_frames_drift_past_the_ticks_is_late_and_that_is_no_error(rate_hz: float, link_hz: float) -> None:
    """The age of a force at its frame is that of this strike, not the mean over all strikes."""
    config = config_of(rate_hz, handle_mass_kg=0.1, link={"rate_hz": link_hz})
    device = config.device.model_copy(update={"compensation": "full"})
    played, (_, verdict) = displayed(config.model_copy(update={"device": device}), WOOD, WOOD)
    assert strike_error(WOOD.mode, played.output) == pytest.approx(verdict.error, abs=0.02)


def test_a_strike_beyond_the_limit_is_weaker() -> None:
    config = load_config({"device": {"kind": "sim", "max_force_n": 0.3}})
    _, (verdict,) = displayed(config, WOOD)
    assert verdict.strength < 0.5
    assert verdict.force_n <= 0.3


def test_a_mode_above_the_range_of_the_rate_is_silent() -> None:
    _, (wood, steel) = displayed(config_of(2000), WOOD, STEEL)
    assert wood.displayed_hz is not None
    assert (steel.displayed_hz, steel.force_n, steel.error, steel.strength) == (None, 0.0, 1.0, 0.0)


def test_every_mode_of_the_library_is_struck() -> None:
    config = load_config({"device": {"kind": "sim"}})
    strikes = {(strike.material, strike.use): strike for strike in verify.strikes_of(config.materials)}
    assert strikes["wood", "tap"].coefficient_m_per_s2 == pytest.approx(30.9)
    assert strikes["cellophane", "rupture"].coefficient_m_per_s2 == 38
    assert strikes["comb", "groove"].coefficient_m_per_s2 == pytest.approx(1200 * 0.1 + 63.4)
    assert ("slippery", "tap") not in strikes
    doubled = verify.strikes_of(config.materials, 0.2)
    assert doubled[0].coefficient_m_per_s2 == pytest.approx(2 * strikes["wood", "tap"].coefficient_m_per_s2)


def test_an_attack_that_is_a_first_peak() -> None:
    tap = {"attack_slope_per_s": 100, "frequency_hz": 67, "decay_time_s": 0.00648, "attack": "first_peak"}
    config = load_config({"materials": {"oak": {"stiffness_n_per_m": 800, "tap": tap}}})
    oak = next(strike for strike in verify.strikes_of(config.materials) if strike.material == "oak")
    assert oak.coefficient_m_per_s2 == pytest.approx(10 / oak.mode.peak)


def recording_of(config: Config, played: Played, rate_hz: float, scale: float = 1.0) -> Recording:
    """The recording of an accelerometer on the simulated handle: a separate clock, and noise."""
    finer = 10
    force = np.repeat(played.force_n, finer, axis=0)
    motion: Floats = np.empty((len(force), 4))
    sim = new_sim(config.device.sim, played.rate_hz * finer)
    lib.hd_sim_drive(sim, pointer("double[]", force), len(force), pointer("double[]", motion))
    fine = played.rate_hz * finer
    acceleration = np.diff(motion[:, 3]) * fine
    grid = (np.arange(len(acceleration)) + 0.5) / fine
    time_s = np.arange(0.00123, grid[-1], 1 / rate_hz)
    hiss = np.random.default_rng(1).normal(0, 0.05, len(time_s))
    return Recording("felt.csv", 99.0 + time_s, scale * (np.interp(time_s, grid, acceleration) + hiss))


@pytest.mark.long
def test_a_recording_shows_the_motion_of_the_handle() -> None:
    """The strikes of a light grip, where the onset that fits best is the onset."""
    grip = {"mass_kg": 0.005, "stiffness_n_per_m": 20, "damping_n_s_per_m": 0.3}
    config = config_of(hand=grip, handle_damping_n_s_per_m=0.1)
    soft = Strike("soft", "tap", Mode(1 / 0.004, 2 * math.pi * 150), 40.0)
    played, known = displayed(config, WOOD, soft)
    heard = verify.from_recording(played, recording_of(config, played, 20_000.0))
    for one, other in zip(heard, known, strict=True):
        assert one.error == pytest.approx(other.error, abs=0.03)
        assert one.strength == pytest.approx(other.strength, abs=0.02)
    half = verify.from_recording(played, recording_of(config, played, 20_000.0, 0.5))
    assert half[0].strength == pytest.approx(heard[0].strength / 2, rel=0.02)


def test_another_recording_is_refused() -> None:
    played, _ = displayed(config_of(), WOOD)
    hiss = np.random.default_rng(2).standard_normal(20_000)
    with pytest.raises(HapticdError, match=r"felt\.csv: the drive was not found in the recording"):
        verify.from_recording(played, Recording("felt.csv", np.arange(20_000) / 1e4, hiss))
