"""Taps: fits of synthetic recordings with known parameters, and refusals."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from collections.abc import Callable

import numpy as np
import pytest
from scipy import integrate, optimize, signal, stats

import hapticd
from hapticd.analysis.recordings.sensor import Sensor
from hapticd.analysis.statistics import (
    Estimate,
    FitError,
    Floats,
    common,
    f_test_p,
    least_squares,
    through_origin,
    with_offset,
)
from hapticd.config.materials import Tap, shipped_materials
from hapticd.config.modes import Mode
from hapticd.fit.recording import Recording, Source
from hapticd.fit.ringing import fit_ringing
from hapticd.fit.synthesize import Stylus, TapTruth, taps
from hapticd.fit.tap import TapFit, fit_tap
from tests.support.marks import rest_slow

SEVEN = ("wood", "acrylic", "delrin", "aluminum", "glass", "cast_iron", "steel")
SPEEDS = np.linspace(0.1, 0.4, 10)


def tap_of(name: str) -> Tap:
    tap = shipped_materials()[name].tap
    assert tap is not None
    return tap


def made(name: str = "delrin", speeds: Floats = SPEEDS, **stylus: float) -> tuple[Recording, TapTruth]:
    return taps(tap_of(name), speeds, Stylus(**stylus))  # type: ignore[arg-type]


def with_samples(recording: Recording, acceleration: Floats) -> Recording:
    return dataclasses.replace(recording, acceleration_m_per_s2=acceleration)


def samples_of(recording: Recording) -> Floats:
    assert recording.acceleration_m_per_s2 is not None
    return recording.acceleration_m_per_s2


def off(estimate: Estimate, truth: float) -> float:
    return abs(estimate.value / truth - 1)


# ---- Regression ------------------------------------------------------------------------------------------------------


def test_a_line_has_the_slope_and_interval_of_scipy() -> None:
    random = np.random.default_rng(3)
    x = random.uniform(0.1, 1.0, 12)
    y = 3.0 * x + 0.7 + random.normal(0, 0.2, 12)
    line = with_offset(x, y)
    reference = stats.linregress(x, y)
    wide = stats.t.ppf(0.975, 10)
    slope, offset = line.coefficients
    assert slope.value == pytest.approx(reference.slope, rel=1e-12)
    assert slope.high - slope.value == pytest.approx(wide * reference.stderr, rel=1e-9)
    assert offset.value - offset.low == pytest.approx(wide * reference.intercept_stderr, rel=1e-9)
    assert line.r_squared == pytest.approx(reference.rvalue**2, rel=1e-9)
    assert line.correlation == pytest.approx(reference.rvalue, rel=1e-9)


def test_a_line_through_the_origin_is_the_closed_form() -> None:
    x, y = np.array([1.0, 2.0, 4.0]), np.array([2.1, 3.9, 8.2])
    slope = through_origin(x, y).coefficients[0]
    best = (x @ y) / (x @ x)
    error = math.sqrt(np.sum((y - best * x) ** 2) / 2 / (x @ x))
    assert slope.value == pytest.approx(best, rel=1e-12)
    assert slope.high == pytest.approx(best + stats.t.ppf(0.975, 2) * error, rel=1e-9)


def test_without_scatter_weights_are_of_the_known_variances() -> None:
    values, variances = np.array([1.0, 1.1, 0.8]), np.array([0.04, 0.01, 0.16])
    found = common(values, variances)
    assert found.value == pytest.approx(np.average(values, weights=1 / variances), rel=1e-9)


def test_scatter_is_what_makes_the_weighted_squares_as_large_as_their_freedom() -> None:
    random = np.random.default_rng(5)
    variances = np.full(8, 1e-4) * np.arange(1, 9)
    values = 2.0 + random.normal(0, 0.5, 8)
    found = least_squares(np.ones((8, 1)), values, variances)

    def excess(scatter: float) -> float:
        weights = 1 / (variances + scatter)
        return float(np.sum(weights * (values - np.average(values, weights=weights)) ** 2) - 7)

    assert found.scatter**2 == pytest.approx(optimize.brentq(excess, 0, 10, xtol=1e-12), rel=1e-6)


def test_scatter_in_ratios_is_that_of_the_scaled_problem() -> None:
    # Without further errors, y/x scatters alike at all points, whose scatter is as x: the slope is the mean of y/x.
    random = np.random.default_rng(6)
    x = random.uniform(1, 4, 9)
    y = 2.0 * x * (1 + 0.1 * random.standard_normal(9))
    slope = through_origin(x, y, np.full(9, 1e-12), x**2).coefficients[0]
    each = y / x
    assert slope.value == pytest.approx(each.mean(), rel=1e-6)
    wide = stats.t.ppf(0.975, 8) * each.std(ddof=1) / 3
    assert slope.high - slope.value == pytest.approx(wide, rel=1e-6)


def test_the_chance_of_a_fuller_model_is_of_the_f_distribution() -> None:
    assert f_test_p(12.0, 9, 7.0, 7) == pytest.approx(stats.f.sf((5 / 2) / (7 / 7), 2, 7), rel=1e-9)


def test_undetermined_coefficients_are_refused() -> None:
    with pytest.raises(FitError, match="1 points cannot determine 1 coefficients"):
        common(np.array([1.0]))
    with pytest.raises(FitError, match="two columns are linearly dependent"):
        least_squares(np.ones((5, 2)), np.arange(5.0))
    with pytest.raises(FitError, match="all zero"):
        through_origin(np.zeros(5), np.arange(5.0))


# ---- Ringing ---------------------------------------------------------------------------------------------------------


def rung(modes: list[tuple[float, Mode]], onset_s: float, samples: int = 1000, rate_hz: float = 25_000.0) -> Floats:
    since = np.arange(samples) / rate_hz - onset_s
    found = np.full(samples, 9.81)
    for coefficient, mode in modes:
        wave = np.exp(-mode.decay_rate_per_s * since) * np.sin(mode.angular_frequency_rad_per_s * since)
        found += np.where(since >= 0, coefficient * wave, 0.0)
    return found


@pytest.mark.parametrize("name", SEVEN)
def test_without_noise_a_mode_and_its_onset_come_back(name: str) -> None:
    mode = tap_of(name).mode
    found = fit_ringing(rung([(40.0, mode)], 0.00501234), 25_000)
    assert found.coefficients[0] == pytest.approx(40, rel=1e-5)
    assert found.decay_rate_per_s[0] == pytest.approx(mode.decay_rate_per_s, rel=1e-5)
    assert found.angular_frequency_rad_per_s[0] == pytest.approx(mode.angular_frequency_rad_per_s, rel=1e-5)
    assert found.onset_s == pytest.approx(0.00501234, abs=1e-8)
    assert found.variance_accounted_for == pytest.approx(1, abs=1e-8)


def test_two_modes_struck_together_come_back() -> None:
    one, two = Mode(150.0, 2 * math.pi * 90), Mode(400.0, 2 * math.pi * 700)
    found = fit_ringing(rung([(40.0, one), (12.0, two)], 0.0050071), 25_000, modes=2)
    assert found.coefficients == pytest.approx([40, 12], rel=1e-4)
    assert found.decay_rate_per_s == pytest.approx([150, 400], rel=1e-4)
    assert found.angular_frequency_rad_per_s / (2 * math.pi) == pytest.approx([90, 700], rel=1e-4)


def test_the_minimum_and_its_covariance_are_those_of_scipy() -> None:
    mode = tap_of("delrin").mode
    random = np.random.default_rng(2)
    measured = rung([(40.0, mode)], 0.0050071, 600) + random.normal(0, 0.6, 600)
    time_s = np.arange(600) / 25_000

    def model(t: Floats, a: float, b: float, w: float, onset: float, c: float, d: float) -> Floats:
        since = np.maximum(t - onset, 0)
        return np.asarray(c + d * t + a * np.exp(-b * since) * np.sin(w * since))

    truth = [40.0, mode.decay_rate_per_s, mode.angular_frequency_rad_per_s, 0.0050071, 9.81, 0.0]
    best, covariance = optimize.curve_fit(model, time_s, measured, p0=truth, method="trf", x_scale=np.abs(truth) + 1e-3)
    found = fit_ringing(measured, 25_000)
    values = [found.coefficients[0], found.decay_rate_per_s[0], found.angular_frequency_rad_per_s[0], found.onset_s]
    assert values == pytest.approx(best[:4], rel=1e-4)
    assert np.sqrt(np.diag(found.covariance)) == pytest.approx(np.sqrt(np.diag(covariance)[:4]), rel=0.02)


def test_nothing_and_next_to_nothing_do_not_ring() -> None:
    with pytest.raises(FitError, match="constant"):
        fit_ringing(np.full(100, 9.81), 25_000)
    with pytest.raises(FitError, match="10 samples are too few for 1 modes: needs 16"):
        fit_ringing(np.arange(10.0), 25_000)


# ---- The synthetic stylus --------------------------------------------------------------------------------------------


def test_a_stylus_answers_as_its_transfer_function() -> None:
    stylus = Stylus(mounting_hz=3000, mounting_damping=0.1, filter_hz=2000)
    mode = Mode(300.0, 2 * math.pi * 800)
    time_s = np.arange(2000) / 1e6
    one, two = 2 * math.pi * 3000, 2 * math.pi * 2000
    denominator = np.polymul([1, 0.2 * one, one**2], [1, math.sqrt(2) * two, two**2])
    driven = np.exp(-300 * time_s) * np.sin(mode.angular_frequency_rad_per_s * time_s)
    _, answer, _ = signal.lsim(([one**2 * two**2], denominator), driven, time_s)
    assert stylus.ringing(mode, time_s) == pytest.approx(answer, abs=2e-5)


def test_synthetic_taps_begin_at_their_onsets_and_come_at_their_speeds() -> None:
    recording, truth = made(noise_rms=0.0)
    assert recording.position_m is not None
    acceleration = samples_of(recording) - Stylus().offset_m_per_s2
    for speed, onset_s in zip(SPEEDS, truth.onsets_s, strict=True):
        first = math.ceil(onset_s * recording.rate_hz)
        since = first / recording.rate_hz - onset_s
        assert acceleration[first - 1] == pytest.approx(0, abs=1e-6)
        wave = np.exp(-truth.mode.decay_rate_per_s * since) * np.sin(truth.mode.angular_frequency_rad_per_s * since)
        assert acceleration[first] == pytest.approx(truth.slope_per_s * speed * wave, abs=1e-6)
        way = recording.position_m[first - 200 : first]
        assert np.diff(way) * recording.rate_hz == pytest.approx(speed)
        # Eight decay times after the onset, nothing is left; the integral of a ringing is A w/(B^2 + w^2).
        rings = acceleration[first - 1 : first + 1400]
        b, w = truth.mode.decay_rate_per_s, truth.mode.angular_frequency_rad_per_s
        assert integrate.trapezoid(rings, dx=1 / recording.rate_hz) == pytest.approx(
            truth.slope_per_s * speed * w / (b**2 + w**2), rel=2e-3
        )


# ---- Taps ------------------------------------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize("name", SEVEN)
def test_the_seven_materials_are_recovered(name: str) -> None:
    fits: list[tuple[TapFit, TapTruth]] = []
    for seed in range(3):
        recording, truth = made(name, seed=seed)
        fits.append((fit_tap([recording]), truth))
    assert np.median([off(fit.slope_per_s, truth.slope_per_s) for fit, truth in fits]) < 0.02
    assert (
        np.median([off(fit.first_peak_slope_per_s, truth.slope_per_s * truth.mode.peak) for fit, truth in fits]) < 0.02
    )
    assert np.median([off(fit.frequency_hz, truth.mode.frequency_hz) for fit, truth in fits]) < 0.005
    assert np.median([off(fit.decay_time_s, truth.mode.decay_time_s) for fit, truth in fits]) < 0.02
    for fit, _ in fits:
        assert fit.warnings == ()
        assert fit.verdict.startswith("good: ")
        assert fit.linear
        assert len(fit.taps) == 10


@pytest.mark.slow
def test_intervals_cover_the_truth_as_often_as_they_say() -> None:
    sets, covered = 40, np.zeros(4, dtype=int)
    for seed in range(sets):
        recording, truth = made("delrin", np.linspace(0.1, 0.4, 8), seed=seed)
        fit = fit_tap([recording])
        for which, (estimate, value) in enumerate(
            (
                (fit.slope_per_s, truth.slope_per_s),
                (fit.first_peak_slope_per_s, truth.slope_per_s * truth.mode.peak),
                (fit.frequency_hz, truth.mode.frequency_hz),
                (fit.decay_time_s, truth.mode.decay_time_s),
            )
        ):
            covered[which] += estimate.low <= value <= estimate.high
    # One of a thousand runs of intervals of 95 % is below this by chance, for each figure.
    assert (covered >= stats.binom.ppf(0.001, sets, 0.95)).all(), covered
    # Intervals that are too wide would always cover the truth.
    assert covered.min() < sets


def test_one_loud_sample_of_noise_is_no_tap() -> None:
    speeds = np.linspace(0.4, 0.1, 10)
    recording, truth = made("wood", speeds)
    acceleration = samples_of(recording).copy()
    between = round(truth.onsets_s[4:6].mean() * recording.rate_hz)
    acceleration[between] += 0.1 * np.abs(acceleration).max()
    fit = fit_tap([with_samples(recording, acceleration)])
    assert [tap.speed_m_per_s for tap in fit.taps] == pytest.approx(speeds)
    assert fit.verdict.startswith("good")


def test_the_material_is_one_that_the_library_takes() -> None:
    recording, truth = made()
    fit = fit_tap([recording])
    for attack in ("coefficient", "first_peak"):
        found = Tap.model_validate(fit.material(attack)["tap"])
        # Both attacks give the same ringing.
        amplitude = found.attack_slope_per_s * found.mode.coefficient(1.0, found.attack)
        assert amplitude == pytest.approx(truth.slope_per_s, rel=0.02)
    assert json.loads(json.dumps(fit.to_dict()))["frequency_hz"]["value"] == fit.frequency_hz.value
    with pytest.raises(FitError, match="no second mode"):
        fit.material(two_modes=True)
    table = fit_tap([recording], law="table")
    assert table.material()["tap"]["amplitudes"] == [  # type: ignore[index,call-overload]
        [speed, amplitude.value] for speed, amplitude in table.amplitudes
    ]


def test_gravity_drift_tremor_and_a_filter_do_not_matter() -> None:
    recording, truth = made("wood", drift_m_per_s3=5.0, tremor_m_per_s2=0.2, filter_hz=8000.0)
    fit = fit_tap([recording])
    assert off(fit.slope_per_s, truth.slope_per_s) < 0.02
    assert off(fit.frequency_hz, truth.mode.frequency_hz) < 0.005
    assert off(fit.decay_time_s, truth.mode.decay_time_s) < 0.02


def test_speeds_are_taken_from_the_position() -> None:
    recording, truth = made(position_step_m=1e-5)
    fit = fit_tap([dataclasses.replace(recording, speed_m_per_s=None)])
    assert [tap.speed_m_per_s for tap in fit.taps] == pytest.approx(SPEEDS, rel=0.01)
    assert off(fit.slope_per_s, truth.slope_per_s) < 0.02


def test_a_column_of_speeds_is_read_at_the_onset() -> None:
    recording, truth = made()
    column = np.zeros(len(samples_of(recording)))
    for speed, onset_s in zip(SPEEDS, truth.onsets_s, strict=True):
        first = round(onset_s * recording.rate_hz)
        column[first - 400 : first + 5] = speed
    fit = fit_tap([dataclasses.replace(recording, speed_m_per_s=column)])
    assert [tap.speed_m_per_s for tap in fit.taps] == pytest.approx(SPEEDS)


def test_a_file_for_each_tap_does_as_well() -> None:
    files, seen = [], []
    for index, speed in enumerate(SPEEDS):
        recording, truth = made("delrin", np.array([speed]), seed=index)
        files.append(dataclasses.replace(recording, name=f"tap {index}", speed_m_per_s=float(speed)))
    fit = fit_tap(files, seen.append)
    assert [recording.name for recording in seen] == [f"tap {index}" for index in range(10)]
    assert off(fit.slope_per_s, truth.slope_per_s) < 0.02


def test_taps_that_begin_downwards_are_turned() -> None:
    recording, truth = made()
    fit = fit_tap([with_samples(recording, -samples_of(recording))])
    assert off(fit.slope_per_s, truth.slope_per_s) < 0.02
    assert "downwards" in fit.warnings[0]


def test_bounces_are_left_out() -> None:
    recording, truth = made("delrin", noise_rms=0.002)
    acceleration = samples_of(recording).copy()
    acceleration += 0.3 * (np.roll(acceleration, 1200) - Stylus().offset_m_per_s2)
    fit = fit_tap([with_samples(recording, acceleration)])
    assert len(fit.taps) == 10
    assert fit.warnings == ("synthetic taps: 10 bounces after taps are left out",)
    assert off(fit.slope_per_s, truth.slope_per_s) < 0.02


@pytest.mark.long
@pytest.mark.parametrize("pressed", [False, True])
def test_weak_taps_soon_after_strong_ones_are_separated_from_bounces_by_their_position(pressed: bool) -> None:
    speeds = np.array([0.4, 0.3, 0.2, 0.1, 0.05, 0.35, 0.12, 0.25, 0.15, 0.06])
    recording, truth = made("delrin", speeds, noise_rms=0.002)
    recording = dataclasses.replace(recording, speed_m_per_s=None)
    fit = fit_tap([recording])
    assert [tap.speed_m_per_s for tap in fit.taps] == pytest.approx(speeds, rel=0.01)
    assert fit.warnings == ()
    # The stylus leaves the surface 10 ms after each touch at half the speed, and a steady push returns it by 60 ms; or
    # it stays, is pressed on evenly, and rings again.
    assert recording.position_m is not None
    acceleration, position = samples_of(recording).copy(), recording.position_m.copy()
    away_s, flight_s = 0.01, 0.05
    echo = round((away_s + flight_s) * recording.rate_hz)
    acceleration[echo:] += 0.5 * (samples_of(recording) - Stylus().offset_m_per_s2)[:-echo]
    time_s = np.arange(len(position)) / recording.rate_hz
    for speed, onset_s in zip(speeds, truth.onsets_s, strict=True):
        since = time_s - onset_s
        here = (since >= 0) & (since < away_s + flight_s + 0.005)
        flown = np.clip(since[here] - away_s, 0, flight_s)
        position[here] = 0.02 * since[here] if pressed else -0.5 * speed * flown * (1 - flown / flight_s)
    fit = fit_tap([dataclasses.replace(with_samples(recording, acceleration), position_m=position)])
    assert [tap.speed_m_per_s for tap in fit.taps] == pytest.approx(speeds, rel=0.01)
    assert fit.warnings == ("synthetic taps: 10 bounces after taps are left out",)
    assert off(fit.slope_per_s, truth.slope_per_s) < 0.02


@pytest.mark.long
def test_a_second_mode_is_reported_and_offered() -> None:
    recording, truth = made("delrin", noise_rms=0.005)
    time_s = np.arange(len(samples_of(recording))) / recording.rate_hz
    acceleration = samples_of(recording).copy()
    two = Mode(300.0, 2 * math.pi * 620)
    for speed, onset_s in zip(SPEEDS, truth.onsets_s, strict=True):
        acceleration += 0.3 * truth.slope_per_s * speed * Stylus().ringing(two, time_s - onset_s)
    fit = fit_tap([with_samples(recording, acceleration)])
    assert fit.second is not None
    assert fit.second.frequency_hz.value == pytest.approx(620, rel=0.02)
    assert fit.second.decay_time_s.value == pytest.approx(1 / 300, rel=0.05)
    assert fit.second.ratio.value == pytest.approx(0.3, rel=0.05)
    assert fit.second.first_frequency_hz.value == pytest.approx(93, rel=0.01)
    assert fit.second.variance_accounted_for > 0.99
    assert fit.second.first_slope_per_s.value == pytest.approx(truth.slope_per_s, rel=0.02)
    assert fit.material(two_modes=True)["tap"] == {
        "attack_slope_per_s": fit.second.first_slope_per_s.value,
        "frequency_hz": fit.second.first_frequency_hz.value,
        "decay_time_s": fit.second.first_decay_time_s.value,
        "second": {
            "frequency_hz": fit.second.frequency_hz.value,
            "decay_time_s": fit.second.decay_time_s.value,
            "ratio": fit.second.ratio.value,
        },
    }
    # One mode explains too little, two explain enough: the material has both by default.
    assert fit.second.kept and fit.second.alone < 0.95
    assert fit.material() == fit.material(two_modes=True) != fit.material(two_modes=False)
    assert "one mode is not enough" in fit.warnings[0]
    assert fit.verdict.startswith("good: two modes explain ")


def ceramic(ratios: Floats, first_hz: float = 1100.0, second_hz: float = 2900.0) -> Recording:
    """Return knocks that ring at two frequencies for 4 ms; `ratios` are those of the second amplitude to the first."""
    rate_hz, random = 25_000.0, np.random.default_rng(1)
    speeds = np.linspace(0.1, 0.4, len(ratios))
    time_s = np.arange(2500 * len(ratios)) / rate_hz
    onsets_s = 0.1 * (np.arange(len(ratios)) + random.uniform(0.3, 0.35, len(ratios)))
    heard = np.zeros(len(time_s))
    for speed, onset_s, ratio in zip(speeds, onsets_s, ratios, strict=True):
        since = np.maximum(time_s - onset_s, 0.0)
        waves = np.sin(2 * math.pi * first_hz * since) + ratio * np.sin(2 * math.pi * second_hz * since)
        heard += 1000.0 * speed * np.exp(-since / 0.004) * waves
    heard += 0.01 * np.abs(heard).max() * random.standard_normal(len(heard))
    return Recording("ceramic", rate_hz, heard + 9.81, None, None, None, speeds, Source("", ""))


@pytest.mark.long
@pytest.mark.parametrize(
    "ratios",
    [np.ones(12), pytest.param(np.tile([0.8, 1.25], 6), marks=pytest.mark.slow)],
    ids=["alike", "by turns"],
)
def test_two_modes_are_tried_before_a_tap_is_thrown_away(ratios: Floats) -> None:
    fit = fit_tap([ceramic(ratios)])
    # One mode explains about half of such a knock, and is the first or the second by chance.
    assert len(fit.taps) == 12 and fit.second is not None and fit.second.alone < 0.65
    found = sorted([fit.frequency_hz.value, fit.second.frequency_hz.value])
    assert found == pytest.approx([1100, 2900], rel=0.002)
    assert fit.decay_time_s.value == pytest.approx(0.004, rel=0.02)
    assert fit.second.decay_time_s.value == pytest.approx(0.004, rel=0.02)
    assert fit.slope_per_s.value == pytest.approx(1000, rel=0.02 if ratios.std() == 0 else 0.05)
    assert fit.second.ratio.value == pytest.approx(1.0, abs=0.1)
    assert Tap.model_validate(fit.material()["tap"]).second is not None
    assert fit.verdict.startswith("good: two modes explain ")
    single = fit_tap([ceramic(ratios)], one_mode=True)
    assert single.verdict.startswith(f"poor: one mode explains {100 * fit.second.alone:.1f} % of 12 taps")


@pytest.mark.slow
def test_a_knock_with_other_modes_than_the_rest_is_left_out_and_reported() -> None:
    strange = ceramic(np.ones(12), 800.0, 2000.0)
    usual = ceramic(np.ones(12))
    samples = samples_of(usual).copy()
    samples[7 * 2500 : 8 * 2500] = samples_of(strange)[7 * 2500 : 8 * 2500]
    fit = fit_tap([with_samples(usual, samples)])
    assert len(fit.taps) == 11
    assert "the tap at 0.73" in fit.warnings[0] and "lacks the two modes of the other taps" in fit.warnings[0]
    assert sorted([fit.frequency_hz.value, fit.second.frequency_hz.value if fit.second else 0.0]) == pytest.approx(
        [1100, 2900], rel=0.002
    )


@pytest.mark.long
@pytest.mark.parametrize(
    ("bent", "kind"),
    [
        (lambda v: v**2 / 0.25, "power"),
        (lambda v: v**0.5 / 4, "power"),
        (lambda v: v + 0.1, "table"),
        (lambda v: np.minimum(v, 0.2), "table"),
    ],
    ids=["square", "saturating", "offset", "corner"],
)
def test_an_amplitude_that_is_no_line_has_its_own_law(bent: Callable[[Floats], Floats], kind: str) -> None:
    speeds = np.linspace(0.1, 0.4, 16)
    recording, truth = made("delrin", bent(speeds), noise_rms=0.005)
    fit = fit_tap([dataclasses.replace(recording, speed_m_per_s=speeds)])
    assert fit.law.kind == kind and not fit.linear
    # The law is as good as a line.
    assert fit.verdict.startswith(
        f"good: one mode explains {100 * fit.variance_accounted_for:.1f} % of 16 taps, A(v) is a"
    )
    assert "not a line through the origin: AICc is higher by" in fit.warnings[0]
    tap = Tap.model_validate(fit.material()["tap"])
    for speed in np.linspace(0.1, 0.4, 61):
        # A table is compared between its points.
        assert tap.amplitude_m_per_s2(speed) == pytest.approx(truth.slope_per_s * bent(speed), rel=0.03)
    first_peak = Tap.model_validate(fit.material("first_peak")["tap"])
    assert first_peak.coefficient(first_peak.amplitude_m_per_s2(0.25)) == pytest.approx(tap.amplitude_m_per_s2(0.25))
    assert fit.choices["amplitude"].startswith("a power law of exponent" if kind == "power" else "a table of")


@pytest.mark.long
@pytest.mark.parametrize("name", rest_slow(SEVEN, fast=2))
def test_what_is_fitted_rendered_and_fitted_again_is_the_same(name: str) -> None:
    recording, _ = made(name)
    fit = fit_tap([recording])
    # At each speed the probe moves into the wall between two ticks, and out again.
    rate_hz, mass_kg, out, inside = 10_000.0, 0.05, 300, 700
    one = np.concatenate((np.full(out, 2.0**-12), np.full(inside, -(2.0**-12))))
    path = np.column_stack((np.zeros(len(SPEEDS) * len(one)), np.tile(one, len(SPEEDS))))
    velocity = np.column_stack((np.zeros(len(path)), -np.repeat(SPEEDS, len(one))))
    config = {
        "device": {"kind": "sim", "effective_mass_kg": mass_kg, "max_force_n": 100},
        "materials": {"fitted": {"stiffness_n_per_m": 0, **fit.material()}},
        "scene": {"objects": {"floor": {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "fitted"}}},
    }
    samples = hapticd.render(config, path, rate_hz, velocity_m_per_s=velocity)
    rendered = dataclasses.replace(
        recording,
        name="rendered",
        rate_hz=rate_hz,
        acceleration_m_per_s2=samples["force_n"][:, 1] / mass_kg,
        position_m=None,
    )
    again = fit_tap([rendered])
    assert off(again.slope_per_s, fit.slope_per_s.value) < 0.01
    assert off(again.frequency_hz, fit.frequency_hz.value) < 0.01
    assert off(again.decay_time_s, fit.decay_time_s.value) < 0.01


# ---- A sensor that is known ------------------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize("order", [1, 2, 4])
def test_a_sensor_answers_as_its_differential_equation_does(order: int) -> None:
    sensor = Sensor(filter_hz=3000, filter_order=order, mounting_hz=8000, mounting_damping=0.1)
    pole = complex(-300, 2 * math.pi * 1500)
    time_s = np.arange(4001) / 4e6
    filters = signal.butter(order, 2 * math.pi * 3000, analog=True)
    w = 2 * math.pi * 8000
    whole = signal.TransferFunction(w**2 * np.asarray(filters[0]), np.polymul(filters[1], [1, 2 * 0.1 * w, w**2]))
    _, answer, _ = signal.lsim(whole, np.exp(pole * time_s).imag, time_s)
    value, by_pole, by_time = sensor.response(pole, time_s)
    assert value.imag == pytest.approx(answer, abs=1e-5)
    step = 0.01
    slower, _, _ = sensor.response(pole + step, time_s)
    assert by_pole == pytest.approx((slower - value) / step, rel=1e-4, abs=1e-9)
    assert by_time[1:-1] == pytest.approx((value[2:] - value[:-2]) * 2e6, rel=1e-3, abs=1.0)


@pytest.mark.long
def test_steel_behind_a_known_filter_comes_back() -> None:
    recording, truth = made("steel", filter_hz=3000.0)
    assert off(fit_tap([recording]).slope_per_s, truth.slope_per_s) > 0.08
    known = fit_tap([dataclasses.replace(recording, sensor=Sensor(filter_hz=3000))])
    assert off(known.slope_per_s, truth.slope_per_s) < 0.02
    assert off(known.frequency_hz, truth.mode.frequency_hz) < 0.005
    assert off(known.decay_time_s, truth.mode.decay_time_s) < 0.02
    assert known.verdict.startswith("good: ")


# ---- Shapes that the model lacks -------------------------------------------------------------------------------------


def with_shape(name: str, shape: Callable[[Floats, Mode], Floats], noise_rms: float = 0.005) -> Recording:
    """Return taps plus a shape, a function of the time since the onset, times slope and speed."""
    recording, truth = made(name, noise_rms=noise_rms)
    acceleration = samples_of(recording).copy()
    time_s = np.arange(len(acceleration)) / recording.rate_hz
    for speed, onset_s in zip(SPEEDS, truth.onsets_s, strict=True):
        since = time_s - onset_s
        acceleration += np.where(since > 0, truth.slope_per_s * speed * shape(since, truth.mode), 0.0)
    return with_samples(recording, acceleration)


def pulse(since: Floats, mode: Mode) -> Floats:
    angular = mode.angular_frequency_rad_per_s
    return np.where(angular * since < math.pi, np.sin(angular * since), 0.0)


def push(since: Floats, mode: Mode) -> Floats:
    return np.where(since < 0.02, 0.3 * np.sin(math.pi * since / 0.02), 0.0)


def near(since: Floats, mode: Mode) -> Floats:
    later = np.maximum(since, 0.0)
    return 0.4 * np.exp(-mode.decay_rate_per_s * later) * np.sin(1.4 * mode.angular_frequency_rad_per_s * later)


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "shape"), rest_slow([("glass", pulse), ("wood", push), ("wood", near), ("glass", push)], fast=3)
)
def test_figures_that_another_shape_has_spoilt_are_not_called_good(
    name: str, shape: Callable[[Floats, Mode], Floats]
) -> None:
    fit = fit_tap([with_shape(name, shape)])
    assert off(fit.slope_per_s, tap_truth(name)) > 0.2
    assert not fit.verdict.startswith("good: ")
    assert any("have a pattern" in warning for warning in fit.warnings)


def tap_truth(name: str) -> float:
    return made(name)[1].slope_per_s


def test_a_tap_far_off_the_line_of_the_others_is_reported() -> None:
    recording, _ = made("glass")
    speeds = SPEEDS.copy()
    speeds[4] *= 3
    fit = fit_tap([dataclasses.replace(recording, speed_m_per_s=speeds)])
    assert "the tap at 0.43" in fit.warnings[0]
    assert "67 % below the line of the others" in fit.warnings[0] or "68 % below" in fit.warnings[0]
    assert fit.verdict.startswith("fair: ")


def test_a_frequency_that_moves_with_the_speed_is_reported() -> None:
    tap = tap_of("delrin")
    assert tap.mode.frequency_hz == pytest.approx(93)
    files = []
    for index, speed in enumerate(SPEEDS):
        faster = Tap(attack_slope_per_s=509, frequency_hz=93 * (1 + 0.15 * speed), decay_time_s=0.00412)
        recording, _ = taps(faster, [speed], Stylus(seed=index, noise_rms=0.005))
        files.append(dataclasses.replace(recording, speed_m_per_s=float(speed)))
    fit = fit_tap(files)
    assert any(re.search("the frequency rises by [45] %", warning) for warning in fit.warnings)


def moving(hertz: Callable[[float], float], decay_s: Callable[[float], float]) -> list[Recording]:
    """Return recordings of one tap each, with a different mode in each."""
    files = []
    for index, speed in enumerate(SPEEDS):
        own = Tap(attack_slope_per_s=509, frequency_hz=hertz(speed), decay_time_s=decay_s(speed))
        recording, _ = taps(own, [speed], Stylus(seed=index, noise_rms=0.005))
        files.append(dataclasses.replace(recording, speed_m_per_s=float(speed)))
    return files


@pytest.mark.long
def test_frequency_and_decay_that_follow_the_speed_are_a_table() -> None:
    fit = fit_tap(moving(lambda v: 200 * (1 + 0.3 * v), lambda v: 0.004 + 0.01 * v))
    assert fit.modes is not None and fit.verdict.startswith("good: ")
    assert "the frequency rises" in fit.choices["mode_table"] and "the decay time rises" in fit.choices["mode_table"]
    tap = Tap.model_validate(fit.material()["tap"])
    for speed in SPEEDS:
        assert tap.mode_at(speed).frequency_hz == pytest.approx(200 * (1 + 0.3 * speed), rel=0.01)
        assert tap.mode_at(speed).decay_time_s == pytest.approx(0.004 + 0.01 * speed, rel=0.03)
        assert tap.amplitude_m_per_s2(speed) == pytest.approx(509 * speed, rel=0.03)
    without = fit_tap(moving(lambda v: 200 * (1 + 0.3 * v), lambda v: 0.004 + 0.01 * v), mode_table=False)
    assert any("the decay time rises" in line and "has one frequency" in line for line in without.warnings)
    steady = Tap.model_validate(without.material()["tap"])
    assert steady.mode_table is None and steady.mode.frequency_hz == fit.frequency_hz.value


@pytest.mark.long
def test_a_decay_that_follows_the_speed_alone_leaves_the_frequency_as_it_is() -> None:
    fit = fit_tap(moving(lambda v: 200.0, lambda v: 0.004 + 0.01 * v))
    assert fit.modes is not None
    assert {each.value for each in fit.modes.frequencies_hz} == {fit.frequency_hz.value}
    steady = fit_tap(moving(lambda v: 200.0, lambda v: 0.006))
    assert steady.modes is None and "mode_table" not in steady.choices
    with pytest.raises(FitError, match="no table of modes"):
        fit_tap(moving(lambda v: 200.0, lambda v: 0.006), mode_table=True)


@pytest.mark.long
def test_a_long_rest_has_no_taps_in_its_noise() -> None:
    recording, truth = made("glass")
    random = np.random.default_rng(3)
    noise = 0.02 * np.abs(samples_of(recording) - 9.80665).max()
    rest = 9.80665 + noise * random.standard_normal(1_000_000)
    fit = fit_tap([with_samples(recording, np.concatenate((rest, samples_of(recording), rest)))])
    assert len(fit.taps) == 10
    assert off(fit.slope_per_s, truth.slope_per_s) < 0.02


@pytest.mark.long
def test_the_second_mode_has_intervals_and_a_table() -> None:
    def other(since: Floats, mode: Mode) -> Floats:
        later = np.maximum(since, 0.0)
        return 0.3 * np.exp(-300 * later) * np.sin(2 * math.pi * 620 * later)

    fit = fit_tap([with_shape("delrin", other, 0.02)])
    second = fit.second
    assert second is not None
    for estimate, truth in (
        (second.frequency_hz, 620.0),
        (second.decay_time_s, 1 / 300),
        (second.ratio, 0.3),
        (second.first_slope_per_s, tap_truth("delrin")),
    ):
        assert off(estimate, truth) < 0.05
        assert estimate.low < estimate.value < estimate.high
        assert estimate.high - estimate.low < 0.3 * truth
    figures = fit_tap([with_shape("delrin", other, 0.02)], law="table").material(two_modes=True)
    loaded = Tap.model_validate(figures["tap"])
    assert loaded.second is not None and loaded.amplitudes is not None
    assert loaded.amplitude_m_per_s2(0.25) == pytest.approx(0.25 * tap_truth("delrin"), rel=0.03)
    # Another law of both modes has other points.
    curved = fit_tap([with_shape("delrin", other, 0.02)], law="power")
    tap = Tap.model_validate(curved.material(two_modes=True)["tap"])
    assert tap.amplitudes is not None and curved.power is not None
    assert tap.amplitudes[0][0] == pytest.approx(curved.power.points[0][0])
    assert tap.amplitude_m_per_s2(0.25) == pytest.approx(0.25 * tap_truth("delrin"), rel=0.03)
    with pytest.raises(FitError, match="need attack: coefficient"):
        fit.material("first_peak", two_modes=True)


@pytest.mark.long
def test_the_table_is_of_the_lines_that_are_nearest() -> None:
    # A(v) is two straight lines whose corner is at a speed of the table, which loses nothing.
    speeds = np.repeat([0.1, 0.2, 0.3, 0.4], 3)
    as_if = np.interp(speeds, [0.1, 0.2, 0.3, 0.4], [0.02, 0.2, 0.3, 0.35])
    recording, truth = made("delrin", as_if, noise_rms=0.001)
    fit = fit_tap([dataclasses.replace(recording, speed_m_per_s=speeds)])
    found = {speed: amplitude for speed, amplitude in fit.amplitudes}
    assert list(found) == pytest.approx([0.1, 0.2, 0.3, 0.4])
    for (speed, amplitude), true in zip(found.items(), (0.02, 0.2, 0.3, 0.35), strict=True):
        assert amplitude.value == pytest.approx(truth.slope_per_s * true, rel=0.02), speed
        assert amplitude.low <= amplitude.value <= amplitude.high


# ---- Refusals --------------------------------------------------------------------------------------------------------


def refused(recording: Recording) -> str:
    with pytest.raises(FitError) as caught:
        fit_tap([recording])
    text = str(caught.value)
    assert "\n" not in text
    return text


def test_noise_has_no_onset() -> None:
    recording, _ = made()
    noise = np.random.default_rng(1).normal(9.81, 0.3, len(samples_of(recording)))
    assert "no onset" in refused(with_samples(recording, noise))
    assert "no onset" in refused(with_samples(recording, np.full(10_000, 9.81)))


def events(shape: Floats, rate_hz: float = 25_000.0) -> list[Recording]:
    """Return a recording with the same shape four times, at four speeds."""
    random = np.random.default_rng(8)
    found = []
    for speed in (0.1, 0.2, 0.3, 0.4):
        one = np.concatenate((np.zeros(1000), speed * shape, np.zeros(3000)))
        acceleration = np.tile(one, 4) + random.normal(0, 1e-3, 4 * len(one))
        found.append(Recording("other", rate_hz, acceleration, None, None, None, speed, Source("", "")))
    return found


@pytest.mark.long
@pytest.mark.parametrize(
    ("shape", "message"),
    [
        (np.ones(1), "a glitch|the shape is not a ringing: the peak is 10[0-9] times the noise"),
        pytest.param(
            np.random.default_rng(7).normal(0, 1, 1000), "a decaying sinusoid explains", marks=pytest.mark.slow
        ),
        pytest.param(np.sin(2 * np.pi * 50 * np.arange(12_500) / 25_000), "does not decay", marks=pytest.mark.slow),
        (1e6 * np.ones(30), "acceleration must be between|units|off by a thousand"),
        pytest.param(np.sin(2 * np.pi * 5 * np.arange(5000) / 25_000), "a hand's motion", marks=pytest.mark.slow),
    ],
    ids=["spikes", "noise", "lasting", "huge", "slow"],
)
def test_what_is_no_tap_is_refused(shape: Floats, message: str) -> None:
    with pytest.raises(FitError, match=message):
        fit_tap(events(shape))


def test_taps_at_one_speed_are_refused() -> None:
    recording, _ = made(speeds=np.full(6, 0.2))
    assert "all 6 taps have about one speed" in refused(recording)


@pytest.mark.long
def test_clipped_taps_are_left_out_and_all_of_them_refused() -> None:
    recording, truth = made(full_scale_m_per_s2=110.0)
    fit = fit_tap([recording])
    assert 3 <= len(fit.taps) < 10
    assert len(fit.warnings) == 10 - len(fit.taps)
    assert all("left out: clipped" in warning for warning in fit.warnings)
    assert off(fit.slope_per_s, truth.slope_per_s) < 0.02
    recording, _ = made(full_scale_m_per_s2=20.0)
    assert "clipped at 20 m/s^2" in refused(recording)


def test_a_tap_too_weak_for_its_noise_is_left_out() -> None:
    # The slowest tap's peak is 3 times the noise.
    speeds = SPEEDS**2 / 0.25
    recording, truth = made(speeds=speeds)
    fit = fit_tap([recording])
    assert "too weak for the noise" in fit.warnings[0]
    assert [tap.speed_m_per_s for tap in fit.taps] == pytest.approx(speeds[1:])
    assert off(fit.slope_per_s, truth.slope_per_s) < 0.02


@pytest.mark.long
def test_a_coarse_converter_is_not_taken_for_clipping() -> None:
    recording, truth = made("wood", noise_rms=0.0)
    step = np.abs(samples_of(recording)).max() / 2**11
    fit = fit_tap([with_samples(recording, np.round(samples_of(recording) / step) * step)])
    assert fit.warnings == ()
    assert off(fit.slope_per_s, truth.slope_per_s) < 0.02


def test_a_rate_too_low_for_the_frequency_is_refused() -> None:
    recording, _ = made("steel", rate_hz=3600.0, noise_rms=0.005)
    assert "at least 2.05 times" in refused(recording)


@pytest.mark.long
def test_units_off_by_a_thousand_are_refused() -> None:
    recording, _ = made()
    assert "in mm/s" in refused(dataclasses.replace(recording, speed_m_per_s=1e3 * SPEEDS))
    assert "km/s" in refused(dataclasses.replace(recording, speed_m_per_s=1e-3 * SPEEDS))
    for factor in (1e3, 1e-3):
        assert "off by a thousand" in refused(with_samples(recording, factor * samples_of(recording)))


def test_what_is_missing_is_named() -> None:
    recording, _ = made()
    assert "no acceleration" in refused(dataclasses.replace(recording, acceleration_m_per_s2=None))
    assert "neither speed nor position" in refused(dataclasses.replace(recording, speed_m_per_s=None, position_m=None))
    assert "9 speeds for 10 taps" in refused(dataclasses.replace(recording, speed_m_per_s=SPEEDS[:9]))
    assert "2 taps are too few" in refused(made(speeds=np.array([0.1, 0.3]))[0])


@pytest.mark.long
def test_events_that_only_resemble_taps_are_refused() -> None:
    recording, _ = made()
    assert "the force is 0 throughout" in refused(dataclasses.replace(recording, force_n=np.zeros(25_000)))
    assert "throughout" in refused(dataclasses.replace(recording, force_n=np.ones(25_000)))
    assert "never positive" in refused(dataclasses.replace(recording, force_n=-np.linspace(0.1, 1, 25_000)))
    still = dataclasses.replace(recording, speed_m_per_s=None, position_m=np.zeros(25_000))
    assert "never moves" in refused(still)
    noise = np.random.default_rng(4).normal(0, 3e-3, 25_000)
    assert "is the position the right column?" in refused(
        dataclasses.replace(recording, speed_m_per_s=None, position_m=noise)
    )
    unknown = dataclasses.replace(recording, speed_m_per_s=np.where(np.arange(10) == 9, 0.002, SPEEDS))
    assert "does not rise with the speed" in refused(unknown)
    signs = np.repeat([1.0, 1.0, -1.0, 1.0, -1.0, 1.0, 1.0, -1.0, -1.0, 1.0], 2500)
    assert "4 of 10 taps begin with the opposite sign" in refused(
        with_samples(recording, signs * (samples_of(recording) - 9.80665))
    )
    twice = dataclasses.replace(recording, source=Source("taps.npz", "ab"))
    with pytest.raises(FitError, match="duplicate of"):
        fit_tap([twice, twice])


def test_gravity_in_the_wrong_unit_is_reported() -> None:
    recording, _ = made("steel")
    fit = fit_tap([with_samples(recording, samples_of(recording) / 9.80665)])
    assert "is the acceleration in g?" in fit.warnings[0]


@pytest.mark.slow
def test_position_and_acceleration_swapped_are_refused() -> None:
    recording, _ = made()
    assert recording.position_m is not None
    swapped = dataclasses.replace(
        recording, acceleration_m_per_s2=recording.position_m, position_m=samples_of(recording)
    )
    assert refused(dataclasses.replace(swapped, speed_m_per_s=None))
