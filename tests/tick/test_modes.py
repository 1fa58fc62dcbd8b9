"""Ringing modes against arbitrary precision and against the closed form."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest

from hapticd.base.core import EventKind, Flag
from hapticd.config.materials import Mode, shipped_materials
from hapticd.rendering.device_output import Output
from hapticd.rendering.displayability import displayed_mode
from tests.support.rig import FLOOR, Rig, line

RATES = [1000, 1333, 2000, 3000, 4000, 5000, 7000, 8000, 10_000]
TAPPED = [name for name, material in shipped_materials().items() if material.tap]
MASS = 0.05


def modes() -> list[tuple[str, Mode, float]]:
    found = []
    for name, material in shipped_materials().items():
        if material.tap:
            found.append((name, material.tap.mode, material.tap.attack_slope_per_s))
        if material.rupture:
            found.append((name, material.rupture.mode, material.rupture.amplitude_m_per_s2))
    return found


def one_strike(
    mode: Mode, slope: float, rate_hz: float, ticks: int, undisplayable: str = "mute"
) -> tuple[np.ndarray, float]:
    """A strike of the mode in mid-tick: samples from the striking tick on, and its speed. Speeds are given."""
    material = {
        "stiffness_n_per_m": 0,
        "tap": {
            "attack_slope_per_s": slope,
            "angular_frequency_rad_per_s": mode.angular_frequency_rad_per_s,
            "decay_rate_per_s": mode.decay_rate_per_s,
        },
    }
    rig = Rig(
        {"wall": {**FLOOR, "material": "m"}},
        rate_hz=rate_hz,
        materials={"m": material},
        device={"effective_mass_kg": MASS, "undisplayable": undisplayable, "max_force_n": 100},
    )
    speed = 2.0**-6
    path = np.full((ticks + 1, 2), [0.0, -(2.0**-12)])
    path[0, 1] = 2.0**-12  # the crossing is half way between the first two samples, exactly
    samples = rig.render(path, velocity=np.full((ticks + 1, 2), [0.0, -speed]))
    return samples[1:], speed


@pytest.mark.parametrize("rate_hz", RATES)
def test_rotor_against_arbitrary_precision(rate_hz: float) -> None:
    mpmath.mp.dps = 40
    for name, mode, slope in modes():
        if mode.frequency_hz > 0.4 * rate_hz:
            continue
        ticks = int(6 / mode.decay_rate_per_s * rate_hz) + 3
        samples, speed = one_strike(mode, slope, rate_hz, ticks)
        coefficient = mpmath.mpf(MASS) * slope * mpmath.mpf(speed)
        period, decay, omega = (
            mpmath.mpf(x) for x in (1 / rate_hz, mode.decay_rate_per_s, mode.angular_frequency_rad_per_s)
        )
        peak = float(coefficient) * mode.peak
        heard = samples["vibration_force_n"][:, 1]
        for k in range(ticks):
            t = k * period + period / 2
            # A tick at the very end sounds: aluminum's 5/B is 23.5 periods of 10 kHz.
            if k / rate_hz + 0.5 / rate_hz <= 5 / mode.decay_rate_per_s * (1 + 1e-12):
                reference = coefficient * mpmath.exp(-decay * t) * mpmath.sin(omega * t)
                assert abs(heard[k] - float(reference)) <= 1e-12 * peak, (name, k)
            else:
                assert heard[k] == 0.0, (name, k)
        assert heard[-1] == 0.0
        assert not np.any(samples["vibration_force_n"][:, 0])


@pytest.mark.parametrize("name", TAPPED)
@pytest.mark.parametrize("rate_hz", [8000, 10_000])
def test_approach_between_ticks(name: str, rate_hz: float) -> None:
    """Amplitude, phase and onset of a straight approach whose crossing is no tick; the wall's force exactly."""
    material = shipped_materials()[name]
    assert material.tap is not None
    mode, speed, crossing = material.tap.mode, 0.0137, 0.0100371718
    t = np.arange(round(0.1 * rate_hz)) / rate_hz
    path = np.column_stack([np.zeros_like(t), -speed * (t - crossing)])
    rig = Rig({"wall": {**FLOOR, "material": name}}, rate_hz=rate_hz, device={"effective_mass_kg": MASS})
    samples = rig.render(path)
    since = t - crossing
    coefficient = MASS * material.tap.attack_slope_per_s * speed
    closed = coefficient * np.exp(-mode.decay_rate_per_s * since) * np.sin(mode.angular_frequency_rad_per_s * since)
    closed[(since < 0) | (since > 5 / mode.decay_rate_per_s)] = 0.0
    assert np.max(np.abs(samples["vibration_force_n"][:, 1] - closed)) <= 1e-6 * coefficient * mode.peak
    wall = np.where(path[:, 1] < 0, -path[:, 1] * material.stiffness_n_per_m, 0.0)
    assert np.array_equal(samples["contact_force_n"][:, 1], wall)
    (contact,) = rig.of(EventKind.CONTACT)
    assert contact["speed_m_per_s"] == pytest.approx(speed, rel=1e-9)
    assert contact["amplitude_m_per_s2"] == pytest.approx(material.tap.attack_slope_per_s * speed, rel=1e-9)
    assert contact["tick"] / rate_hz - contact["before_tick_s"] == pytest.approx(crossing, abs=1e-12)
    assert contact["scale"] == 1.0


def test_overlapping_taps_are_the_sum_of_their_closed_forms() -> None:
    """Taps 7 ms apart on wood, which rings for 32 ms: the sum, cut five time constants after the last."""
    rate, speed = 10_000, 0.02
    material = shipped_materials()["wood"]
    assert material.tap is not None
    mode = material.tap.mode
    t = np.arange(1200) / rate
    # Down and up in straight lines: a triangle wave about the surface.
    half = 0.0035171
    phase = np.mod(t - 0.00203, 2 * half)
    height = np.where(phase < half, -speed * phase, speed * (phase - 2 * half))
    height = np.where(t < 0.00203, speed * (0.00203 - t), height + 0.3 * speed * half)
    height = np.where(t > 0.05, np.maximum(height, 0.001), height)
    path = np.column_stack([np.zeros_like(t), height])
    rig = Rig({"wall": FLOOR}, device={"effective_mass_kg": MASS})
    samples = rig.render(path)
    onsets = [event["tick"] / rate - event["before_tick_s"] for event in rig.of(EventKind.CONTACT)]
    speeds = [event["speed_m_per_s"] for event in rig.of(EventKind.CONTACT)]
    assert len(onsets) >= 5
    closed = np.zeros_like(t)
    for onset, v in zip(onsets, speeds, strict=True):
        crossing = np.flatnonzero((height[:-1] > 0) & (height[1:] <= 0))
        independent = [(k + height[k] / (height[k] - height[k + 1])) / rate for k in crossing]
        assert min(abs(onset - i) for i in independent) < 1e-12
        since = t - onset
        a = MASS * material.tap.attack_slope_per_s * v
        closed += np.where(
            since >= 0, a * np.exp(-mode.decay_rate_per_s * since) * np.sin(mode.angular_frequency_rad_per_s * since), 0
        )
    closed[t - onsets[-1] > 5 / mode.decay_rate_per_s] = 0.0
    peak = MASS * material.tap.attack_slope_per_s * speed * mode.peak
    assert np.max(np.abs(samples["vibration_force_n"][:, 1] - closed)) <= 1e-6 * peak
    assert samples["vibration_force_n"][-1, 1] == 0.0


def test_first_peak_means_the_largest_acceleration_of_the_first_cycle() -> None:
    rate, speed = 10_000, 0.01
    for name in ("wood", "acrylic", "glass"):
        tap = shipped_materials()[name].to_dict()["tap"]
        assert isinstance(tap, dict)
        material = {"stiffness_n_per_m": 0, "tap": {**tap, "attack": "first_peak"}}
        rig = Rig({"w": {**FLOOR, "material": "m"}}, materials={"m": material}, device={"effective_mass_kg": MASS})
        samples = rig.render(line(0.0005, speed, 1000, rate))
        mode = shipped_materials()[name].tap.mode  # type: ignore[union-attr]
        # What the samples can show of the peak: the closed form at the tick nearest to it is within this of it.
        curvature = (mode.angular_frequency_rad_per_s / rate) ** 2
        wanted = MASS * tap["attack_slope_per_s"] * speed
        assert samples["vibration_force_n"][:, 1].max() == pytest.approx(wanted, rel=max(1e-3, curvature))


def test_peak_ratios_of_the_paper() -> None:
    peaks = {name: shipped_materials()[name].tap.mode.peak for name in ("wood", "acrylic", "glass")}  # type: ignore[union-attr]
    assert peaks == {
        "wood": pytest.approx(0.600, abs=5e-4),
        "acrylic": pytest.approx(0.470, abs=5e-4),
        "glass": pytest.approx(0.782, abs=5e-4),
    }


@pytest.mark.parametrize("rate_hz", [1000, 2000, 3000])
def test_modes_beyond_the_rate_are_muted_or_lowered_never_aliased(rate_hz: float) -> None:
    steel = shipped_materials()["steel"].tap
    assert steel is not None
    mode = steel.mode
    ticks = int(6 / mode.decay_rate_per_s * rate_hz) + 3
    muted, _ = one_strike(mode, steel.attack_slope_per_s, rate_hz, ticks)
    assert not np.any(muted["vibration_force_n"])
    output = Output(rate_hz, MASS, 100, 5, "lower")
    shown, factor = displayed_mode(mode, output)
    assert shown is not None
    assert shown.frequency_hz == pytest.approx(0.4 * rate_hz)
    # The same peak, computed independently by a fine scan of both closed forms.
    t = np.linspace(0, 0.01, 2_000_001)

    def scan(m: Mode) -> float:
        return float(np.max(np.exp(-m.decay_rate_per_s * t) * np.sin(m.angular_frequency_rad_per_s * t)))

    assert factor * scan(shown) == pytest.approx(scan(mode), rel=1e-6)
    lowered, speed = one_strike(mode, steel.attack_slope_per_s, rate_hz, ticks, "lower")
    since = (np.arange(ticks) + 0.5) / rate_hz
    closed = (
        MASS
        * steel.attack_slope_per_s
        * speed
        * factor
        * np.exp(-mode.decay_rate_per_s * since)
        * np.sin(0.8 * np.pi * rate_hz * since)
    )
    closed[since > 5 / mode.decay_rate_per_s] = 0.0
    assert np.allclose(lowered["vibration_force_n"][:, 1], closed, rtol=0, atol=1e-12 * abs(closed).max() + 1e-300)


@pytest.mark.parametrize(
    ("omega", "decay"),
    [
        (0.05, 100.0),  # w near 0: hardly an oscillation
        (0.7999 * np.pi * 10_000, 1.0),  # just below what the rate carries
        (2 * np.pi * 1000, 1e6),  # ends within a tick
        (2 * np.pi * 1000, 60_000.0),  # 5/B is 83 us: heard in one tick, if at all
        (0.05, 1e6),
        (2 * np.pi * 100, 0.1),  # rings for 50 s
    ],
)
def test_extreme_modes_stay_finite_bounded_and_end(omega: float, decay: float) -> None:
    rate = 10_000
    mode = Mode(decay, omega)
    samples, speed = one_strike(mode, 100.0, rate, 3000)
    heard = samples["vibration_force_n"][:, 1]
    since = (np.arange(3000) + 0.5) / rate
    closed = MASS * 100.0 * speed * np.exp(-decay * since) * np.sin(omega * since)
    closed[since > 5 / decay] = 0.0
    assert np.all(np.isfinite(heard))
    assert np.allclose(heard, closed, rtol=0, atol=1e-11 * MASS * 100.0 * speed)
    assert np.all(heard[since > 5 / decay] == 0.0)


@pytest.mark.long
def test_no_subnormals_after_the_last_tap() -> None:
    """Every number of the state's output is zero or normal, for a minute."""
    rig = Rig({"wall": FLOOR})
    samples = np.concatenate([rig.render(line(0.0005, 0.05, 200)), rig.render(line(0.01, 0.0, 600_000))])
    for field in ("contact_force_n", "vibration_force_n", "force_n"):
        values = np.abs(samples[field])
        assert not np.any((values > 0) & (values < np.finfo(np.float64).tiny))
    assert not np.any(samples["vibration_force_n"][2000:])
    assert not samples["flags"][-1] & Flag.RINGING
