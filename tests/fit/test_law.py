"""The law of a tap's amplitude versus speed: the chosen law, the criterion, and the points of a power law."""

from __future__ import annotations

import dataclasses
import math
import re

import numpy as np
import pytest
from scipy import optimize

from hapticd.analysis.statistics import Estimate, FitError, Floats, rank_correlation
from hapticd.fit import speed_law
from hapticd.fit.from_files import fit_taps
from hapticd.fit.panels import page_of
from hapticd.fit.recording import Recording, Source
from hapticd.fit.speed_law import LawKind, law_of
from hapticd.fit.tap import Figures, TapFit, fit_tap, modes_of
from hapticd.fit.verdict import Warnings

SPEEDS = np.geomspace(0.05, 0.5, 12)
SLOW = np.concatenate(([0.002], np.geomspace(0.05, 0.5, 11)))
"""Speeds of which one is far below the others."""
FAST = np.concatenate((np.geomspace(0.05, 0.15, 11), [2.0]))
RATE_HZ = 10_000.0


def scattered(amplitudes: Floats, part: float, seed: int = 1) -> Floats:
    return amplitudes * (1 + part * np.random.default_rng(seed).standard_normal(len(amplitudes)))


def test_a_power_law_is_the_one_of_scipy() -> None:
    amplitudes = scattered(100 * SPEEDS**0.5, 0.05)
    law = law_of(SPEEDS, amplitudes, np.full(12, 1e-9))
    best, covariance = optimize.curve_fit(
        lambda v, a, e: a * v**e, SPEEDS, amplitudes, p0=(100, 0.5), sigma=100 * SPEEDS**0.5, absolute_sigma=False
    )
    assert law.kind == "power" and law.power is not None
    assert law.power.exponent.value == pytest.approx(best[1], abs=0.003)
    assert law.power.coefficient_m_per_s2.value == pytest.approx(best[0], rel=0.003)
    wide = 2.228 * math.sqrt(covariance[1, 1])  # Student's t of 10
    assert law.power.exponent.high - law.power.exponent.value == pytest.approx(wide, rel=0.05)


@pytest.mark.parametrize("exponent", [0.3, 0.5, 1.5, 3.0])
def test_the_points_of_a_power_law_are_as_near_to_it_as_they_say(exponent: float) -> None:
    power = law_of(SPEEDS, 100 * SPEEDS**exponent, np.full(12, 1e-12)).power
    assert power is not None and len(power.points) <= 256
    nodes, heights = np.array([(speed, amplitude.value) for speed, amplitude in power.points]).T
    assert nodes[0] == pytest.approx(0.025) and nodes[-1] == pytest.approx(1.0)
    speeds = np.geomspace(nodes[0], nodes[-1], 20_001)
    off = np.abs(np.interp(speeds, nodes, heights) / (100 * speeds**exponent) - 1).max()
    assert off == pytest.approx(power.off, rel=0.01, abs=1e-9) and off <= 1e-3


def test_the_criterion_is_that_of_its_definition() -> None:
    """If the error is only scatter proportional to the amplitude, the weights are those of the amplitudes."""
    amplitudes = scattered(100 * SPEEDS**0.5, 0.03, 4)
    law = law_of(SPEEDS, amplitudes, np.full(12, 1e-12))
    weights = 1 / (100 * SPEEDS**0.5) ** 2

    def criterion(squares: float, unknowns: int) -> float:
        known = unknowns + 1
        return 12 * math.log(squares / 12) + 2 * known + 2 * known * (known + 1) / (12 - known - 1)

    slope = np.sum(weights * SPEEDS * amplitudes) / np.sum(weights * SPEEDS**2)
    power = optimize.least_squares(
        lambda p: np.sqrt(weights) * (amplitudes - p[0] * SPEEDS ** p[1]), (100.0, 0.5), x_scale=(100, 1)
    )
    line = criterion(float(np.sum(weights * (amplitudes - slope * SPEEDS) ** 2)), 1)
    assert law.above["line"] - law.above["power"] == pytest.approx(line - criterion(2 * power.cost, 2), abs=1.0)


@pytest.mark.slow
def test_a_line_is_seldom_taken_for_another_law() -> None:
    kinds = [law_of(SPEEDS, scattered(500 * SPEEDS, 0.1, seed), np.full(12, 1e-6)).kind for seed in range(60)]
    # About 10 % of the sets have an AICc lower by 2 by chance; more than 12 of 60 are improbable.
    assert sum(kind != "line" for kind in kinds) <= 12
    # A law that differs from the line by less than 5 % is a line, however certain.
    assert law_of(SPEEDS, 500 * SPEEDS**1.01, np.full(12, 1e-9)).kind == "line"


def test_amplitudes_that_hardly_follow_the_speed_are_a_law_too() -> None:
    law = law_of(SPEEDS, scattered(np.full(12, 80.0), 0.03), np.full(12, 0.01))
    assert law.kind in ("power", "table") and law.left < 0.06
    assert "for a line" in law.why


def test_few_taps_are_a_line() -> None:
    law = law_of(SPEEDS[:3], 500 * SPEEDS[:3] ** 0.5, np.full(3, 1e-6))
    assert law.kind == "line" and law.why == "too few taps to compare laws"


def test_three_taps_have_a_power_law_whose_interval_is_finite() -> None:
    law = law_of(np.array([0.106, 0.11, 0.103]), np.array([0.2, 7.3, 6.5]), np.ones(3), "power")
    assert law.power is not None and 0 < law.power.coefficient_m_per_s2.high < math.inf


# ---- Judgement -------------------------------------------------------------------------------------------------------


def tapped(speeds: Floats, amplitudes: Floats) -> list[Recording]:
    """Return a recording of each tap: 200 Hz that decay within 12 ms, and noise."""
    random = np.random.default_rng(5)
    since = np.arange(1500) / RATE_HZ - 0.0503
    shape = np.where(since > 0, np.exp(-since / 0.012) * np.sin(400 * np.pi * since), 0.0)
    return [
        Recording(
            f"tap {index}",
            RATE_HZ,
            amplitude * shape + 0.02 * random.standard_normal(1500),
            None,
            None,
            None,
            float(speed),
            Source("", ""),
        )
        for index, (speed, amplitude) in enumerate(zip(speeds, amplitudes, strict=True))
    ]


@pytest.mark.long
@pytest.mark.parametrize(
    ("speeds", "exponent", "part", "seed"),
    [
        (SLOW, 0.45, 0.1, 14),
        (SLOW, 0.2, 0.0, 14),
        (np.concatenate(([0.002, 0.004], np.geomspace(0.05, 0.5, 10))), 0.2, 0.05, 14),
        (np.geomspace(0.05, 0.5, 5), 0.45, 0.05, 2),
        (np.geomspace(0.05, 0.5, 5), 2.0, 0.03, 14),
        (FAST, 0.45, 0.1, 14),
    ],
    ids=["slow tap", "slow tap, weak", "two slow taps", "few taps", "few taps, square", "fast tap"],
)
def test_a_power_law_is_judged_as_a_power_law(speeds: Floats, exponent: float, part: float, seed: int) -> None:
    fit = fit_tap(tapped(speeds, scattered(60 * speeds**exponent, part, seed)))
    assert fit.judged.quality == "good", fit.verdict
    assert fit.power is not None and fit.law.kind == "power"
    assert fit.power.exponent.value == pytest.approx(exponent, abs=0.06 + part)


@pytest.mark.long
@pytest.mark.parametrize("kind", ["line", "power", "table"])
def test_the_law_of_the_fit_is_that_of_the_material(kind: LawKind) -> None:
    amplitudes = scattered(60 * SLOW**0.45, 0.1, 14)
    fit = fit_taps(tapped(SLOW, amplitudes), law=kind)
    assert isinstance(fit, TapFit) and fit.law.kind == kind and fit.linear == (kind == "line")
    tap = fit.material()["tap"]
    assert isinstance(tap, dict)
    dots, model, *_ = page_of("tap", "", fit, []).rows[0][0].curves
    assert (dots.label, model.label) == ("recorded", "model")
    if kind == "line":
        # A line is wrong for these taps, but their amplitudes do follow the speed.
        assert "differ from a line through the origin" in fit.verdict and fit.judged.quality == "poor"
        assert np.allclose(model.y, tap["attack_slope_per_s"] * model.x)
        return
    assert fit.judged.quality == "good"
    speeds, heights = np.array(tap["amplitudes"]).T
    assert np.allclose(model.y, np.interp(model.x, (0.0, *speeds), (0.0, *heights)))
    assert np.interp(0.1, speeds, heights) == pytest.approx(60 * 0.1**0.45, rel=0.15)


@pytest.mark.parametrize("speeds", [SPEEDS, SLOW, FAST, np.linspace(0.15, 0.25, 12)])
@pytest.mark.parametrize("falls", [0.0, -0.3])
def test_an_amplitude_that_does_not_rise_is_refused(speeds: Floats, falls: float) -> None:
    with pytest.raises(FitError, match="the amplitude does not rise with the speed: the rank correlation of 12 taps"):
        fit_tap(tapped(speeds, scattered(60 * speeds**falls, 0.03)))


def judged(speeds: Floats, amplitudes: Floats) -> str:
    """Return the verdict on the law alone: refused, poor, fair or good."""
    law = law_of(speeds, amplitudes, np.full(len(speeds), 1e-4))
    warnings = Warnings()
    try:
        speed_law.check_rises(law, len(speeds))
    except FitError:
        return "refused"
    speed_law.check_law(warnings, law)
    assert law.rank_correlation <= 0.8 or "explains the amplitude poorly" not in str(warnings.reasons)
    return warnings.verdict("").quality


@pytest.mark.long
def test_random_amplitudes_are_not_accepted() -> None:
    for seed in range(20):
        random = np.random.default_rng(seed)
        for speeds in (SPEEDS, SLOW):
            assert judged(speeds, random.uniform(5, 100, 12)) in ("refused", "poor"), seed
            assert judged(speeds, random.permutation(300 * SPEEDS)) in ("refused", "poor"), seed


@pytest.mark.long
@pytest.mark.parametrize("exponent", [0.5, 1.0, 2.0])
def test_scatter_is_not_called_a_speed_that_explains_nothing(exponent: float) -> None:
    """Scatter of 30 % over two decades is never refused, and not called good throughout."""
    speeds = np.geomspace(0.01, 1.0, 20)
    found = [judged(speeds, scattered(60 * speeds**exponent, 0.3, seed)) for seed in range(12)]
    assert "refused" not in found and "fair" in found


def test_the_rank_correlation_is_that_of_scipy() -> None:
    from scipy.stats import spearmanr

    random = np.random.default_rng(1)
    for size in (3, 12, 40):
        one, other = random.integers(0, 8, (2, size)).astype(float)
        assert rank_correlation(one, other) == pytest.approx(spearmanr(one, other).statistic)
    assert rank_correlation(np.ones(5), np.arange(5.0)) == 0.0


def test_a_unit_off_by_a_thousand_is_refused_whatever_the_law() -> None:
    for speeds, amplitudes in ((SLOW, 0.06 * SLOW**0.45), (SPEEDS, 3e6 * SPEEDS)):
        with pytest.raises(FitError, match="off by a thousand"):
            speed_law.check_hardness(speeds, amplitudes, 400 * math.pi, "the angular frequency")
    speed_law.check_hardness(SLOW, 60 * SLOW**0.2, 400 * math.pi, "the angular frequency")


# ---- Tables of modes -------------------------------------------------------------------------------------------------


def figures(speeds: Floats, decay_times_s: Floats) -> Figures:
    """Return taps of 200 Hz with these decay times, almost without noise."""
    small, angular = np.full(len(speeds), 1e-6), np.full(len(speeds), math.log(400 * math.pi))
    amplitude = (300 * speeds, small)
    return Figures(speeds, small, amplitude, amplitude, (-np.log(decay_times_s), small), (angular, small))


FREQUENCY = Estimate(200.0, 199.0, 201.0)


@pytest.mark.long
def test_no_value_of_a_table_is_far_from_those_of_the_taps() -> None:
    """A decay that rises steeply above an almost constant one; a straight line through it would be negative."""
    speeds, made = np.linspace(0.05, 0.5, 9), 0
    for seed in range(30):
        times = (0.0012 + 0.06 * speeds**2) * np.exp(0.3 * np.random.default_rng(seed).standard_normal(9))
        table, why = modes_of(figures(speeds, times), FREQUENCY, Estimate(0.005, 0.004, 0.006))
        if table is None:
            continue
        made += 1
        along = table.decay_time_at(np.linspace(0.01, 1.0, 200))
        assert times.min() / 3 < along.min() and along.max() < 3 * times.max()
        assert all(0 < each.low <= each.value <= each.high for each in table.decay_times_s)
        assert "the decay time rises by" in why
    assert made >= 20


@pytest.mark.long
def test_a_table_is_the_line_of_the_logarithms() -> None:
    """Scatter is proportional to the decay time; the reference minimises the same sum by scipy."""
    speeds = np.geomspace(0.05, 0.5, 12)
    times = (0.002 + 0.03 * speeds) * np.exp(0.1 * np.random.default_rng(3).standard_normal(12))
    table, _ = modes_of(figures(speeds, times), FREQUENCY, Estimate(0.005, 0.004, 0.006))
    assert table is not None and len(table.speeds_m_per_s) == 2
    best = optimize.least_squares(
        lambda ends: np.log(np.interp(speeds, speeds[[0, -1]], ends) / times), (0.004, 0.01), x_scale=(1e-3, 1e-3)
    )
    assert [each.value for each in table.decay_times_s] == pytest.approx(best.x, rel=1e-4)


@pytest.mark.long
def test_a_table_that_is_too_uncertain_is_reported() -> None:
    """The decay time of six taps rises with the speed, but its scatter is far too large for a value at each speed."""
    times_s = np.array([0.59e-3, 0.85e-3, 2.35e-3, 2.44e-3, 6.94e-3, 13.03e-3])
    since = np.arange(3000) / RATE_HZ - 0.0503
    random = np.random.default_rng(2)
    taps = []
    for each, time_s in zip(tapped(np.linspace(0.05, 0.5, 6), np.ones(6)), times_s, strict=True):
        ringing = np.where(since > 0, np.exp(-since / time_s) * np.sin(800 * np.pi * since), 0.0)
        seen = 300 * float(each.speed_m_per_s) * ringing + 0.01 * random.standard_normal(3000)  # type: ignore[arg-type]
        taps.append(dataclasses.replace(each, acceleration_m_per_s2=seen))
    fit = fit_tap(taps)
    (told,) = (line for line in fit.warnings if "decay time" in line)
    assert re.fullmatch(
        r"the decay time rises by \d+ % from the slowest to the fastest, but no table over the speed is certain "
        r"enough; the material has one frequency and one decay time",
        told,
    )
    assert told in fit.judged.reasons and fit.modes is None and "mode_table" not in fit.material()["tap"]  # type: ignore[operator]
    with pytest.raises(FitError, match=r"certain enough: there is no table of modes; --no-mode-table needs none"):
        fit_tap(taps, mode_table=True)
    (told,) = (line for line in fit_tap(taps, mode_table=False).warnings if "decay time" in line)
    assert "certain enough" in told
