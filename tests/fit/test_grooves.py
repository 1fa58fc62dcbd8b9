"""Grooves: fits of synthetic strokes with known parameters, and refusals."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from hapticd.analysis.statistics import FitError, least_squares, robust
from hapticd.config.materials import Material, validate_materials
from hapticd.fit.grooves import fit_grooves
from hapticd.fit.recording import Recording
from hapticd.fit.synthesize import Hand, Stylus, grooves, texture

PLACES = ((0.04, 1.0), (0.04, 2.5), (0.08, 1.0), (0.08, 2.5))


def comb(spacing_m: float = 0.002, frequency_hz: float = 200.0, decay_time_s: float = 0.003) -> Material:
    ridges = {
        "kind": "grooves",
        "display": "vibration",
        "spacing_m": spacing_m,
        "width_m": spacing_m / 4,
        "velocity_gain_per_s": 1200.0,
        "force_gain_m_per_s2_per_n": 63.4,
        "frequency_hz": frequency_hz,
        "decay_time_s": decay_time_s,
    }
    return validate_materials({"comb": {"stiffness_n_per_m": 800.0, "texture": ridges}})["comb"]


def strokes(
    material: Material | Callable[[float], Material], seed: int, scatter: float = 0.02, duration_s: float = 1.0
) -> list[Recording]:
    return [
        grooves(
            material(speed) if callable(material) else material,
            speed,
            force,
            Stylus(seed=100 * seed + k, tremor_m_per_s2=0.3, mounting_hz=8000.0, filter_hz=9000.0),
            Hand(duration_s=duration_s),
            scatter,
        )
        for k, (speed, force) in enumerate(PLACES)
    ]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("spacing_m", "frequency_hz", "decay_time_s"),
    [(0.002, 200.0, 0.003), (0.00076, 350.0, 0.008), (0.0024, 1682.0, 0.003)],
)
def test_the_truth_is_found(spacing_m: float, frequency_hz: float, decay_time_s: float) -> None:
    """The second comb still rings at the next groove; the frequency of the third is that of steel."""
    fit = fit_grooves(strokes(comb(spacing_m, frequency_hz, decay_time_s), 1))
    assert fit.spacing_m.value == pytest.approx(spacing_m, rel=0.005)
    assert fit.frequency_hz.value == pytest.approx(frequency_hz, rel=0.005)
    assert fit.decay_time_s.value == pytest.approx(decay_time_s, rel=0.03)
    # An accelerometer on a mounting of 8 kHz, behind a filter of 9 kHz, makes 1682 Hz 4.6 % larger.
    assert fit.velocity_gain_per_s.value == pytest.approx(1200.0, rel=0.05 if frequency_hz < 1000 else 0.1)
    assert fit.force_gain_m_per_s2_per_n.value == pytest.approx(63.4, rel=0.05 if frequency_hz < 1000 else 0.1)
    assert fit.correlation > 0.9
    found = validate_materials({"comb": {"stiffness_n_per_m": 800.0, **fit.material()}})["comb"]
    assert found.groove_mode is not None


@pytest.mark.slow
def test_backwards_and_by_speed_alone() -> None:
    """A stroke to the left has strikes to the left; without a position, the speed gives the spacing."""
    material = comb()
    recordings = []
    for k, (speed, force) in enumerate(PLACES):
        way = -1 if k % 2 else 1
        hand = Hand(speed_swing=0.0, position_noise_m=0.0)
        recording = grooves(material, way * speed, force, Stylus(seed=k), hand, 0.02)
        recordings.append(dataclasses.replace(recording, tangential_position_m=None, speed_m_per_s=way * speed))
    fit = fit_grooves(recordings)
    assert fit.spacing_m.value == pytest.approx(0.002, rel=0.005)
    assert fit.velocity_gain_per_s.value == pytest.approx(1200.0, rel=0.05)
    assert fit.force_gain_m_per_s2_per_n.value == pytest.approx(63.4, rel=0.05)


@pytest.mark.slow
def test_a_frequency_that_moves_with_speed_is_reported() -> None:
    fit = fit_grooves(strokes(lambda speed: comb(frequency_hz=200.0 if speed < 0.06 else 220.0), 2))
    assert any("changes with speed" in warning for warning in fit.warnings)
    assert fit.frequency_per_speed_hz_s_per_m is not None
    assert fit.frequency_per_speed_hz_s_per_m.low < 20.0 / 0.04 < fit.frequency_per_speed_hz_s_per_m.high * 1.2


@pytest.mark.slow
def test_knocks_do_not_pull_the_gains() -> None:
    """Each stroke has one knock, eight times as strong as a strike."""
    recordings = []
    for recording in strokes(comb(), 4):
        heard = recording.acceleration_m_per_s2
        assert heard is not None and recording.tangential_position_m is not None
        place = recording.tangential_position_m
        groove = 0.002 * np.ceil(place[len(place) // 2] / 0.002)
        since = np.arange(len(heard)) / recording.rate_hz - np.argmax(place >= groove) / recording.rate_hz
        late = np.maximum(since, 0)
        knock = 900.0 * np.exp(-late / 0.003) * np.sin(2 * np.pi * 200.0 * late)
        recordings.append(dataclasses.replace(recording, acceleration_m_per_s2=heard + knock))
    fit = fit_grooves(recordings)
    assert fit.velocity_gain_per_s.value == pytest.approx(1200.0, rel=0.05)
    assert fit.force_gain_m_per_s2_per_n.value == pytest.approx(63.4, rel=0.05)
    assert any("do not count" in warning for warning in fit.warnings)


@pytest.mark.slow
def test_strikes_are_searched_again_with_the_fitted_mode() -> None:
    """With the first mode, 185 strikes are found in this stroke of 75 grooves."""
    one = grooves(
        comb(0.00076, 350.0, 0.008),
        0.06727180704951209,
        1.9074880545528834,
        Stylus(seed=430_006_003),
        Hand(duration_s=0.8),
        0.05,
    )
    fit = fit_grooves([one])
    assert fit.spacing_m.value == pytest.approx(0.00076, rel=0.005)
    assert fit.decay_time_s.value == pytest.approx(0.008, rel=0.02)


@pytest.mark.long
def test_few_samples_in_a_cycle_are_reported() -> None:
    recordings = [
        grooves(comb(), speed, force, Stylus(seed=k, rate_hz=1000.0), Hand(), 0.02)
        for k, (speed, force) in enumerate(PLACES)
    ]
    assert any("5.0 samples in a cycle" in warning for warning in fit_grooves(recordings).warnings)


@pytest.mark.long
def test_recordings_of_two_combs_are_refused() -> None:
    with pytest.raises(FitError, match="other grooves"):
        fit_grooves([*strokes(comb(), 1, duration_s=0.6)[:2], *strokes(comb(0.0025), 2, duration_s=0.6)[:1]])


@pytest.mark.long
def test_sandpaper_is_no_comb() -> None:
    noise = {"kind": "stochastic", "peak_hz": 160.0, "mean_hz": 210.0, "velocity_gain_per_s": 24.0}
    grit = validate_materials({"grit": {"stiffness_n_per_m": 800.0, "texture": noise}})["grit"]
    with pytest.raises(FitError, match="no grooves here"):
        fit_grooves([texture(grit, 0.08, 1.0, Stylus())])


def test_the_estimate_is_that_of_least_squares_without_outliers() -> None:
    """Without outliers the robust estimate is nearly that of least squares, and outliers change it little."""
    random = np.random.default_rng(5)
    columns = random.uniform(1, 2, (400, 2))
    y = columns @ [3.0, 5.0] + 0.1 * random.standard_normal(400)
    plain = least_squares(columns, y)
    for outliers in (0, 20):
        y[:outliers] += 40.0
        found = robust(columns, y)
        assert len(found.outliers) == outliers
        for one, other in zip(found.coefficients, plain.coefficients, strict=True):
            assert one.value == pytest.approx(other.value, abs=0.4 * (other.high - other.low))
            assert one.high - one.low == pytest.approx(other.high - other.low, rel=0.2)


SPOILT: list[tuple[Callable[[Recording], dict[str, object]], str]] = [
    (lambda each: {"force_n": None}, "no force"),
    (lambda each: {"force_n": np.zeros_like(each.force_n)}, "0 throughout"),
    (lambda each: {"force_n": 1e-6 * each.force_n}, "too small"),
    (lambda each: {"tangential_position_m": 1e3 * each.tangential_position_m}, "in mm"),
    (lambda each: {"tangential_position_m": 0 * each.tangential_position_m}, "never moves"),
    (lambda each: {"speed_m_per_s": np.full(7, 0.1)}, "7 speeds for"),
    (lambda each: {"acceleration_m_per_s2": np.minimum(each.acceleration_m_per_s2, 30.0)}, "clipped"),
]


@pytest.mark.parametrize(("changed", "reason"), SPOILT)
def test_refusals_say_why(changed: Callable[[Recording], dict[str, object]], reason: str) -> None:
    first = strokes(comb(), 3, duration_s=0.5)[0]
    with pytest.raises(FitError, match=reason) as caught:
        fit_grooves([dataclasses.replace(first, **changed(first))])
    assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_one_speed_and_one_force_cannot_be_separated() -> None:
    hand = Hand(speed_swing=0.0, force_swing=0.0)
    with pytest.raises(FitError, match="be separated"):
        fit_grooves([grooves(comb(), 0.05, 1.0, Stylus(seed=k), hand) for k in range(2)])


def test_a_rate_too_low_for_the_mode_is_refused() -> None:
    with pytest.raises(FitError, match="too low"):
        fit_grooves([grooves(comb(frequency_hz=200.0), 0.05, 1.0, Stylus(rate_hz=450.0), Hand(duration_s=2.0))])
