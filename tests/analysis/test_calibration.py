"""Calibration: the drive, the fit against independent integrations, its bounds, and the accelerometer."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy import signal, stats

from hapticd.analysis.calibration import accelerometer, handle, sweep
from hapticd.analysis.calibration.accelerometer import Recording
from hapticd.analysis.calibration.fit import Estimate, Fit, Point, difference, fit, model_motion
from hapticd.analysis.calibration.handle import Calibration
from hapticd.analysis.calibration.rig import SimRig
from hapticd.analysis.calibration.sweep import Burst, Record, Sweep, sweep_config
from hapticd.analysis.statistics import Floats
from hapticd.base.core import ffi, lib, pointer
from hapticd.base.errors import HapticdError
from hapticd.config.configuration import Config, load_config
from hapticd.rendering.joystick import new_sim
from tests.support.marks import rest_slow

STEP_M = 20e-6


def quiet(_: object) -> None:
    """Nobody is asked, nothing is shown."""


def config_of(rate_hz: float = 1000, **sim: object) -> Config:
    return load_config({"servo": {"rate_hz": rate_hz}, "device": {"kind": "sim", "sim": sim}})


def calibrated(config: Config, force_n: float = 1.0, *, wide: bool = False) -> Calibration:
    return handle.calibrate(config, "x", force_n, quiet, quiet, wide=wide)


def off(estimate: Estimate, truth: float) -> float:
    return abs(estimate.value / truth - 1)


# ---- The fit against other integrations -------------------------------------------------------------------------


def drive_force(rate_hz: float, frequencies: list[float], amplitude_n: float) -> tuple[Floats, tuple[Burst, ...]]:
    """Decaying sines, one after the other, to both sides."""
    parts: list[Floats] = [np.zeros(round(0.1 * rate_hz))]
    bursts = []
    begin = len(parts[0])
    for frequency in frequencies:
        for side in (1.0, -1.0):
            time_s = np.arange(round(9 / frequency * rate_hz)) / rate_hz
            parts.append(side * amplitude_n * np.exp(-time_s * frequency / 3) * np.sin(2 * np.pi * frequency * time_s))
            bursts.append(Burst(frequency, side * amplitude_n, begin, begin + len(time_s)))
            begin += len(time_s)
    return np.concatenate(parts), tuple(bursts)


def record_of(force: Floats, position: Floats, bursts: tuple[Burst, ...], rate_hz: float, held: bool) -> Record:
    return Record(rate_hz, 1 / rate_hz, held, force, position, bursts)


def quantised(position: Floats) -> Floats:
    return np.round(position / STEP_M) * STEP_M


@pytest.mark.long
def test_a_linear_device_by_scipy() -> None:
    """Zero-order hold of the state-space form, by scipy; friction, which is not there, comes out as none."""
    rate, mass, damping, stiffness = 2000.0, 0.07, 4.0, 400.0
    force, bursts = drive_force(rate, [3, 5, 8, 12, 18, 27, 40, 60, 90], 0.8)
    law = signal.StateSpace([[0, 1], [-stiffness / mass, -damping / mass]], [[0], [1 / mass]], [[1, 0]], [[0]])
    _, position = signal.dlsim(law.to_discrete(1 / rate), force)[:2]
    found = fit(record_of(force, quantised(position[:, 0] + 1.3e-5), bursts, rate, held=True))
    for which, truth in ((0, mass), (1, damping), (3, stiffness)):
        estimate = found.estimate(which)
        assert off(estimate, truth) < 0.01
        assert estimate.high - estimate.value < 0.02 * truth
    assert found.friction_n < 0.003
    assert abs(found.delay_s) < 2e-5
    assert found.residual_m == pytest.approx(STEP_M / math.sqrt(12), rel=0.1)
    response = found.response(np.array([10.0]))[0]
    s = 2j * math.pi * 10
    assert response == pytest.approx(
        1 / (found.mass_kg * s * s + found.damping_n_s_per_m * s + found.stiffness_n_per_m)
    )


@pytest.mark.slow
@pytest.mark.parametrize(("order", "ratio"), [(1, 1.0), (2, 0.36), (2, 1.5)])
@pytest.mark.parametrize("bandwidth_hz", [100, 300])
def test_the_actuators_bandwidth_is_not_below_the_reported_bound(bandwidth_hz: float, order: int, ratio: float) -> None:
    """The lag by scipy's zero-order hold: the 3 dB point of 1/(1 + s/a), or of 1/(1 + 2 zeta s/a + (s/a)^2)."""
    rate, mass, damping = 2000.0, 0.07, 0.4
    force, bursts = drive_force(rate, [3, 5, 8, 12, 18, 27, 40, 60, 90], 0.8)
    half = 2 * ratio**2 - 1
    natural = 2 * math.pi * bandwidth_hz / (1 if order == 1 else math.sqrt(math.sqrt(half**2 + 1) - half))
    lag = [1 / natural, 1] if order == 1 else [1 / natural**2, 2 * ratio / natural, 1]
    law = signal.TransferFunction([1], np.polymul(lag, [mass, damping, 0])).to_ss()
    _, position = signal.dlsim(law.to_discrete(1 / rate), force)[:2]
    record = record_of(force, quantised(position[:, 0]), bursts, rate, held=False)
    free = fit(record)
    found = Calibration("sim", "x", (record, record), free, free)
    assert found.bandwidth_at_least_hz <= bandwidth_hz
    if order == 1:
        assert found.bandwidth_at_least_hz > 0.75 * bandwidth_hz
    assert "actuator" not in found.section()["device"]  # type: ignore[operator]


@pytest.mark.parametrize(
    ("delay_s", "told"),
    [
        (1e-4, r"actuator: its bandwidth is 14\d\d Hz or more .* so device\.actuator is not written"),
        (1e-6, r"actuator: its bandwidth is above 5000 Hz, .*"),
        (-1e-4, r"actuator: its bandwidth is above 5000 Hz, .*"),
    ],
)
def test_the_note_on_the_actuator(delay_s: float, told: str) -> None:
    free = Fit(0.04, 0.2, 0.05, 0.0, delay_s, (0, 0, 0, 0, 1e-7), 20, 1e-6, 1e-3, (Point(60.0, 1 + 0j),))
    record = Record(1000.0, 1e-3, False, np.zeros(2), np.zeros(2), ())
    found = Calibration("sim", "x", (record, record), free, free)
    (line,) = (note for note in found.notes() if note.startswith("actuator"))
    assert re.fullmatch(told, line)
    least = found.to_dict()["actuator_bandwidth_at_least_hz"]
    assert least == pytest.approx(5000 if delay_s < 2e-6 else 1429.6, rel=0.01)
    assert "actuator" not in found.section()["device"]  # type: ignore[operator]


def integrated(force: Floats, rate_hz: float, mass: float, damping: float, friction: float, stiffness: float) -> Floats:
    """Coulomb's friction by small steps of time: slides against its direction, sticks where it can hold the force."""
    parts = 40
    step = 1 / rate_hz / parts
    x = v = 0.0
    found = []
    for push in force.tolist():
        found.append(x)
        for _ in range(parts):
            net = push - stiffness * x - damping * v
            drag = friction * step / mass
            free = v + net / mass * step
            v = 0.0 if abs(free) <= drag else free - math.copysign(drag, free)
            x += v * step
    return np.array(found)


@pytest.mark.long
@pytest.mark.parametrize(("stiffness", "friction"), rest_slow([(0.0, 0.08), (500.0, 0.1)]))
def test_dry_friction_by_small_steps(stiffness: float, friction: float) -> None:
    rate, mass, damping = 1000.0, 0.05, 1.0
    force, bursts = drive_force(rate, [6, 9, 14, 20, 30, 45], 0.7)
    position = quantised(integrated(force, rate, mass, damping, friction, stiffness))
    found = fit(record_of(force, position, bursts, rate, held=stiffness > 0))
    assert found.mass_kg == pytest.approx(mass, rel=0.01)
    assert found.damping_n_s_per_m == pytest.approx(damping, rel=0.02)
    assert found.friction_n == pytest.approx(friction, rel=0.02)
    assert found.stiffness_n_per_m == pytest.approx(stiffness, rel=0.01)


@pytest.mark.long
def test_a_delay_is_distinguished_from_damping() -> None:
    rate, mass, damping, late = 2000.0, 0.05, 0.5, 7
    force, bursts = drive_force(rate, [6, 9, 14, 20, 30, 45, 70], 0.7)
    position = integrated(force, rate, mass, damping, 0.05, 0.0)
    position = np.concatenate((np.zeros(late), position[:-late]))
    found = fit(record_of(force, quantised(position), bursts, rate, held=False))
    assert found.delay_s == pytest.approx(late / rate, abs=2e-5)
    assert found.damping_n_s_per_m == pytest.approx(damping, rel=0.02)


@pytest.mark.slow
def test_a_drift_of_the_hand_does_no_harm() -> None:
    """A constant force that changes from burst to burst is not mistaken for anything."""
    rate, mass, damping, stiffness = 1000.0, 0.05, 5.0, 300.0
    force, bursts = drive_force(rate, [3, 5, 8, 12, 18, 27, 40], 0.7)
    slow = 0.05 * np.sin(2 * np.pi * 0.05 * np.arange(len(force)) / rate)
    position = integrated(force + slow, rate, mass, damping, 0.0, stiffness)
    found = fit(record_of(force, quantised(position), bursts, rate, held=True))
    assert found.mass_kg == pytest.approx(mass, rel=0.02)
    assert found.stiffness_n_per_m == pytest.approx(stiffness, rel=0.02)


def test_a_handle_that_stands_says_nothing() -> None:
    force, bursts = drive_force(1000.0, [10, 20, 30, 40], 0.5)
    with pytest.raises(HapticdError, match=r"the handle moved in 0 bursts, at least 6 are needed"):
        fit(record_of(force, np.zeros(len(force)), bursts, 1000.0, held=False))


@pytest.mark.slow
def test_bounds_hold_the_truth() -> None:
    """Over many handles, phases and offsets, 95 % bounds hold the truth in about 95 % of cases."""
    rng = np.random.default_rng(5)
    inside = []
    for _ in range(25):
        mass, damping, friction, stiffness = rng.uniform([0.03, 2, 0.02, 150], [0.15, 9, 0.1, 700]).tolist()
        frequencies = (rng.uniform(0.85, 1.15, 8) * [4, 6, 9, 13, 19, 28, 40, 60]).tolist()
        force, bursts = drive_force(1000.0, frequencies, float(rng.uniform(0.6, 0.9)))
        made = lib.hd_sim_new(
            ffi.new(
                "struct hd_sim_config *",
                {
                    "handle_mass_kg": mass,
                    "handle_damping_n_s_per_m": damping,
                    "coulomb_friction_n": friction,
                    "max_force_n": 10.0,
                    "workspace_m": 1.0,
                    "force_timeout_s": 1.0,
                    "hand_stiffness_n_per_m": stiffness,
                    "start_m": [float(rng.uniform(-STEP_M, STEP_M)), 0.0],
                },
            ),
            1e-3,
        )
        pushed, motion = np.zeros((len(force), 2)), np.empty((len(force), 4))
        pushed[:, 0] = force
        lib.hd_sim_drive(
            ffi.gc(made, lib.hd_sim_free), pointer("double[]", pushed), len(force), pointer("double[]", motion)
        )
        found = fit(record_of(force, quantised(motion[:, 0]), bursts, 1000.0, held=True))
        for which, truth in enumerate((mass, damping, friction, stiffness)):
            estimate = found.estimate(which)
            inside.append(2 * estimate.value - estimate.high <= truth <= estimate.high)
    # Of 100 with 95 %, less than 87 have a probability of 5e-4, if they were independent.
    assert 87 <= sum(inside) < 100


def test_difference_adds_variances() -> None:
    free = Fit(0.04, 0.2, 0.05, 0.0, 0.0, (3e-4, 0, 0, 0, 0), 20, 0.0, 0.0, ())
    held = replace(free, mass_kg=0.05, error=(4e-4, 0, 0, 0, 0))
    found = difference(held, free, 0)
    assert found.value == pytest.approx(0.01)
    freedom = 25e-8**2 / (9e-8**2 / 20 + 16e-8**2 / 20)
    assert found.high - found.value == pytest.approx(5e-4 * stats.t.ppf(0.975, freedom), rel=1e-3)


# ---- Whole calibrations of the simulated joystick ----------------------------------------------------------------

FIRM = {"mass_kg": 0.03, "stiffness_n_per_m": 1500, "damping_n_s_per_m": 12}
SOFT = {"mass_kg": 0.01, "stiffness_n_per_m": 100, "damping_n_s_per_m": 1.0}
DEFAULT = {"mass_kg": 0.01, "stiffness_n_per_m": 300, "damping_n_s_per_m": 5.0}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rate_hz", "mass_kg", "hand", "more"),
    [
        (1000, 0.04, DEFAULT, {}),
        (10000, 0.04, DEFAULT, {}),
        (1000, 0.03, SOFT, {}),
        (2000, 0.1, FIRM, {}),
        (1000, 0.3, FIRM | {"mass_kg": 0.06}, {}),
        (1000, 0.04, DEFAULT, {"link": {"rate_hz": 250, "delay_frames": 2}}),
        (4000, 0.04, DEFAULT, {"report_interval_s": 0.001, "report_delay_s": 0.0007}),
    ],
)
def test_it_recovers_the_simulated_joystick(
    rate_hz: float, mass_kg: float, hand: dict[str, float], more: dict[str, object]
) -> None:
    """With quantisation on: the handle within 2 %, the grip within 5 %."""
    config = config_of(rate_hz, handle_mass_kg=mass_kg, hand=hand, **more)
    found = calibrated(config)
    truth = config.device.dynamics
    assert truth is not None
    for estimate, value in zip(
        found.handle, (truth.handle_mass_kg, truth.handle_damping_n_s_per_m, truth.friction_n), strict=True
    ):
        assert off(estimate, value) < 0.02
        assert estimate.high - estimate.value < 0.04 * value
    for estimate, value in zip(
        found.grip,
        (truth.grip_mass_kg, truth.grip_damping_n_s_per_m, truth.grip_stiffness_n_per_m),
        strict=True,
    ):
        assert off(estimate, value) < 0.05
        assert estimate.high - estimate.value < 0.1 * value


@pytest.mark.slow
def test_the_same_on_every_run_and_along_both_axes() -> None:
    config = config_of()
    along = calibrated(config)
    across = handle.calibrate(config, "y", 1.0, quiet, quiet)
    assert across.free.values == along.free.values
    assert across.section() == along.section()


# ---- The drive ----------------------------------------------------------------------------------------------------


def driven(config: Config, held: bool, force_n: float = 1.0, travel_m: float = 0.075) -> Record:
    alone = sweep_config(config, held=held, force_n=force_n)
    with SimRig(alone) as rig:
        return Sweep(rig, quiet, "x", held, force_n, travel_m).run()


@pytest.mark.parametrize("held", [False, True])
def test_the_drive_stays_in_its_limits(held: bool) -> None:
    record = driven(config_of(), held)
    assert np.abs(record.force_n).max() <= 1.0
    assert np.nanmax(np.abs(record.position_m)) < 0.025
    assert record.step_m == pytest.approx(STEP_M)
    frequencies = sorted({burst.frequency_hz for burst in record.bursts})
    assert frequencies[0] < 3
    assert frequencies[-1] > 100
    # The force is rounded by the actuator.
    steps = record.force_n / 0.0043
    assert np.allclose(steps, np.round(steps))


def test_the_guard_ends_the_drive() -> None:
    with pytest.raises(HapticdError, match="left the middle third of its travel") as error:
        driven(config_of(start_m=[0.03, 0]), held=True)
    assert str(error.value).startswith("stopped, the force is zero")


def test_a_handle_that_does_not_move() -> None:
    with pytest.raises(HapticdError, match=r"the handle does not move under 0\.8 N at 60 Hz"):
        driven(config_of(coulomb_friction_n=2.0), held=False)


# ---- The accelerometer ------------------------------------------------------------------------------------------


def heard(found: Calibration, rate_hz: float, scale: float = 1.0) -> Recording:
    """Both drives, one after the other, as an accelerometer with a separate clock records them."""
    parts = []
    for record, each in zip(found.records, (found.free, found.held), strict=True):
        speed = model_motion(record, each)[:, 1]
        parts += [np.zeros(round(0.7 * record.rate_hz)), np.diff(speed) * record.rate_hz]
    whole = np.concatenate(parts)
    grid = (np.arange(len(whole)) + 0.5) / found.records[0].rate_hz
    time_s = np.arange(0, grid[-1], 1 / rate_hz)
    return Recording("taps.csv", time_s + 1234.5, scale * np.interp(time_s, grid, whole))


@pytest.mark.slow
def test_the_accelerometer_sees_beyond_the_encoder() -> None:
    found = calibrated(config_of(4000), wide=True)
    recording = heard(found, 10000.0, scale=0.5)
    for record, each in zip(found.records, (found.free, found.held), strict=True):
        compared = accelerometer.compare(record, each, recording)
        assert compared.scale == pytest.approx(0.5, rel=0.01)
        encoder = max(point.frequency_hz for point in each.points)
        beyond = [point for point in compared.points if point.frequency_hz > encoder]
        assert beyond[-1].frequency_hz > 1000
        for point in beyond:
            # What straight lines between samples lose, at most: sinc squared.
            lost = 1 - np.sinc(point.frequency_hz / 4000) ** 2
            assert abs(point.ratio) == pytest.approx(1, abs=lost + 0.02)


def test_an_offset_between_samples() -> None:
    rng = np.random.default_rng(3)
    fine = np.convolve(rng.standard_normal(40_000), np.hanning(200), mode="same")
    expected = fine[10_003:30_003:10]
    recording = Recording("x", 7.0 + np.arange(4000) * 1e-3, fine[::10])
    assert accelerometer.offset_of(recording, expected, 1000.0) == pytest.approx(7.0 + 1.0003, abs=2e-5)
    with pytest.raises(HapticdError, match="the drive was not found in the recording"):
        accelerometer.offset_of(Recording("x", recording.time_s, rng.standard_normal(4000)), expected, 1000.0)


# ---- What it stands on in C -----------------------------------------------------------------------------------------


def test_drive_is_put_and_advance() -> None:
    sim = config_of().device.sim
    rng = np.random.default_rng(1)
    force = rng.uniform(-2, 2, (500, 2))
    one, other = new_sim(sim, 1000), new_sim(sim, 1000)
    for each in (one, other):
        assert lib.hd_sim_place(each, ffi.new("double[2]", [0.01, -0.02]), ffi.new("double[2]", [0.1, 0.0])) == 0
    motion = np.empty((500, 4))
    lib.hd_sim_drive(one, pointer("double[]", force), 500, pointer("double[]", motion))
    assert motion[0].tolist() == [0.01, -0.02, 0.1, 0.0]
    position, velocity, actuator = (ffi.new("double[2]") for _ in range(3))
    for row, push in zip(motion, force, strict=True):
        lib.hd_sim_truth(other, position, velocity, actuator)
        assert row.tolist() == [*position, *velocity]
        lib.hd_sim_put(other, ffi.new("double[2]", push.tolist()))
        lib.hd_sim_advance(other, 1)


@pytest.mark.parametrize("place", [[0.2, 0.0], [0.0, math.nan]])
def test_a_handle_is_placed_between_its_stops(place: list[float]) -> None:
    sim = new_sim(config_of().device.sim, 1000)
    still = ffi.new("double[2]")
    assert lib.hd_sim_place(sim, ffi.new("double[2]", place), still) < 0
    for fast in (math.inf, math.nan, 1e300, -2e6):
        assert lib.hd_sim_place(sim, still, ffi.new("double[2]", [fast, 0.0])) < 0


def test_a_played_mode_is_its_closed_form() -> None:
    from hapticd.config.modes import Mode

    config = sweep_config(config_of(), held=True, force_n=5.0)
    quiet_scene = config.model_copy(update={"scene": config.scene.model_copy(update={"objects": {}})})
    with SimRig(quiet_scene) as rig:
        rig.run(0.01)
        mode = Mode(50.0, 2 * math.pi * 80)
        tick = rig.strike(mode, 1.5, (0.0, -2.0))
        assert tick == 10
        samples = rig.run(0.1)
    time_s = np.arange(100) / 1000
    closed = -1.5 * np.exp(-50 * time_s) * np.sin(2 * math.pi * 80 * time_s)
    assert np.allclose(samples["vibration_force_n"][:, 1], closed, atol=1e-12)
    assert samples["time_ns"][0] == 10_000_000


def test_the_sweeps_configuration() -> None:
    config = load_config({"device": {"kind": "sim", "max_force_n": 4}})
    free = sweep_config(config, held=False, force_n=0.5)
    assert free.device.max_force_n == 0.5
    assert free.device.sim.hand.stiffness_n_per_m == free.device.sim.hand.mass_kg == 0
    assert sweep_config(config, held=True, force_n=0.5).device.sim.hand == config.device.sim.hand
    assert sweep.travel_m(config) == config.device.sim.workspace_m
