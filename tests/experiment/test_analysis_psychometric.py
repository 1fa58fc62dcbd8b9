"""Psychometric fits compared with simulated observers, psignifit and scipy's search."""

from __future__ import annotations

import warnings

import numpy as np
import numpy.typing as npt
import pytest
from scipy import optimize, special, stats

from hapticd.analysis.statistics import FitError
from hapticd.experiment.analysis.psychometric import bootstrap, fit, goodness_of_fit, percentiles
from hapticd.experiment.analysis.psychometric_shapes import (
    PSYCHOMETRIC_SHAPES,
    Shape,
    density,
    inverse,
    probability,
    rise,
)
from hapticd.experiment.procedures.constant_stimuli import ConstantStimuli, ConstantStimuliParameters

Floats = npt.NDArray[np.float64]
OBSERVERS = 1000
LEVELS = np.linspace(70, 130, 7)


def logistic(levels: Floats, threshold: float, slope: float, guess: float = 0.0, lapse: float = 0.0) -> Floats:
    return np.asarray(guess + (1 - guess - lapse) * special.expit((levels - threshold) * slope))


@pytest.mark.parametrize(
    "shape, reference", [("logistic", stats.logistic), ("cumulative_normal", stats.norm), ("weibull", stats.gumbel_l)]
)
def test_shapes_are_scipys_distributions(shape: Shape, reference: stats.rv_continuous) -> None:
    z = np.linspace(-9, 4, 53)
    assert rise(shape, z) == pytest.approx(reference.cdf(z), rel=1e-9)
    assert density(shape, z) == pytest.approx(reference.pdf(z), rel=1e-9)
    shares = np.array([0.01, 0.25, 0.5, 0.99])
    assert inverse(shape, shares) == pytest.approx(reference.ppf(shares), rel=1e-9)


def test_a_weibull_function_is_one_of_the_level() -> None:
    levels = np.array([20.0, 100.0, 180.0])
    expected = 0.5 + 0.48 * stats.weibull_min(3.0, scale=100.0).cdf(levels)
    assert probability("weibull", levels, 100.0, 3.0, 0.5, 0.02) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("shape", PSYCHOMETRIC_SHAPES)
def test_a_fit_is_as_probable_as_scipys(shape: Shape) -> None:
    """The reference is the same likelihood, written out, and maximized by Nelder and Mead."""
    generator = np.random.Generator(np.random.PCG64(1))
    levels = np.geomspace(40, 250, 8)
    trials = np.full(8, 50)
    truth = probability(shape, levels, 100.0, 3.0, 0.5, 0.02, logarithmic=True)
    positive = generator.binomial(trials, truth)
    found = fit(levels, positive, trials, shape, guess=0.5, lapse=0.02, logarithmic=True)

    def cost(parameters: Floats) -> float:
        z = (np.log(levels) - parameters[0]) * np.exp(parameters[1])
        share = {"logistic": stats.logistic, "cumulative_normal": stats.norm, "weibull": stats.gumbel_l}[shape].cdf(z)
        return -float(stats.binom.logpmf(positive, trials, 0.5 + 0.48 * share).sum())

    best = optimize.minimize(
        cost, [np.log(100), np.log(3)], method="Nelder-Mead", options={"xatol": 1e-8, "fatol": 1e-10}
    )
    assert found.figures["threshold"] == pytest.approx(np.exp(best.x[0]), rel=1e-5)
    assert found.figures["slope"] == pytest.approx(np.exp(best.x[1]), rel=1e-4)


def test_figures_of_proportions_without_noise() -> None:
    """Expected proportions of a function give exactly its PSE, JND and Weber fraction."""
    trials = np.full(7, 1_000_000)
    positive = logistic(LEVELS, 104.0, 0.12) * trials
    found = fit(LEVELS, positive, trials, lapse=0.0, standard=100.0).figures
    assert found["pse"] == pytest.approx(104.0, abs=1e-6)
    assert found["jnd"] == pytest.approx(np.log(3) / 0.12, rel=1e-6)
    assert found["weber_fraction"] == pytest.approx(np.log(3) / 12, rel=1e-6)
    falling = fit(LEVELS, trials - positive, trials, lapse=0.0, rising=False).figures
    assert falling["pse"] == pytest.approx(104.0, abs=1e-6)
    lapsing = fit(LEVELS, logistic(LEVELS, 104.0, 0.3, 0.5, 0.05) * trials, trials, guess=0.5).figures
    assert (lapsing["lapse"], lapsing["slope"]) == pytest.approx((0.05, 0.3), rel=1e-2)


@pytest.mark.slow
@pytest.mark.parametrize("lapse", [0.02, None])
def test_a_thousand_observers(lapse: float | None) -> None:
    """The bias of the threshold is at most 5 %, and 95 % bootstrap intervals cover 93 to 97 %."""
    generator = np.random.Generator(np.random.PCG64(7))
    trials = np.full(7, 40)
    errors, covered = [], 0
    for number in range(OBSERVERS):
        threshold, slope = 100 * np.exp(generator.normal(0, 0.05)), 0.12 * np.exp(generator.normal(0, 0.2))
        positive = generator.binomial(trials, logistic(LEVELS, threshold, slope, 0.0, 0.02))
        found = bootstrap(fit(LEVELS, positive, trials, lapse=lapse), 199, seed=number)["threshold"]
        errors.append(found.value / threshold - 1)
        covered += found.low <= threshold <= found.high
    assert abs(np.mean(errors)) < 0.05
    assert 0.93 <= covered / OBSERVERS <= 0.97


@pytest.mark.slow
def test_fits_agree_with_psignifits() -> None:
    """Threshold and width of twenty data sets of two kinds are within psignifit's 95 % intervals."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        reference = pytest.importorskip("psignifit")
    generator = np.random.Generator(np.random.PCG64(8))
    for number in range(20):
        two_choices = number % 2 == 1
        guess = 0.5 if two_choices else 0.0
        shape: Shape = "logistic" if number < 10 else "cumulative_normal"
        threshold, slope = generator.uniform(90, 110), generator.uniform(0.1, 0.25)
        trials = np.full(9, 80)
        levels = np.linspace(60, 140, 9)
        positive = generator.binomial(trials, logistic(levels, threshold, slope, guess, 0.02))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            theirs = reference.psignifit(
                np.column_stack((levels, positive, trials)),
                sigmoid="logistic" if shape == "logistic" else "norm",
                experiment_type="2AFC" if two_choices else "yes/no",
                **({} if two_choices else {"fixed_parameters": {"gamma": 0.0}}),
            )
        found = fit(levels, positive, trials, shape, guess=guess)
        width = float(inverse(shape, 0.95) - inverse(shape, 0.05)) / found.figures["slope"]
        low, high = theirs.confidence_intervals["threshold"]["0.95"]
        assert low <= found.figures["threshold"] <= high, number
        low, high = theirs.confidence_intervals["width"]["0.95"]
        assert low <= width <= high, number


def test_percentiles_are_order_statistics() -> None:
    """Of 199 values the 5th and the 195th: 2.5 % of 200 lie outside at each end."""
    assert percentiles(np.arange(1.0, 200.0)[::-1]) == pytest.approx((5, 195))


def test_goodness_of_fit() -> None:
    """Answers drawn from the function are fitted well, answers that rise and fall are not."""
    trials = np.full(7, 100)
    well = fit(LEVELS, np.round(logistic(LEVELS, 100, 0.12) * trials), trials, lapse=0.0)
    assert goodness_of_fit(well, 200) > 0.2
    badly = fit(LEVELS, [5, 60, 10, 50, 20, 90, 60], trials, lapse=0.0)
    assert goodness_of_fit(badly, 200) < 0.01
    assert badly.deviance > well.deviance


@pytest.mark.parametrize(
    "levels, positive, trials, text",
    [
        ([1.0], [1], [2], "needs answers at two or more levels, has 1"),
        ([1.0, 2.0], [0, 0], [9, 9], "all answers are equal"),
        ([1.0, 2.0], [3, 1], [2, 2], "between 0 and the number of trials"),
        ([1.0, 2.0], [1], [2, 2], "must have equal lengths"),
        ([-1.0, 2.0], [1, 2], [2, 2], "must be positive, one is -1"),
    ],
)
def test_what_cannot_be_fitted(levels: list[float], positive: list[int], trials: list[int], text: str) -> None:
    with pytest.raises(FitError, match=text):
        fit(levels, positive, trials, "weibull")


@pytest.mark.parametrize(
    ("positive", "expected"),
    [
        ([2, 6, 10, 15, 19], None),
        ([0, 0, 20, 20, 20], "fit a step from chance to certainty between 20 and 30 N: more answers near it"),
        ([0, 0, 0, 0, 1], "above the highest level, 50 N: levels beyond it are needed"),
        ([19, 20, 20, 20, 20], "below the lowest level, 10 N: levels beyond it are needed"),
        ([10, 10, 15, 20, 20], None),
        ([20, 15, 10, 10, 10], "correct answers do not become more from 10 to 50 N"),
        ([10, 10, 10, 10, 10], "correct answers do not become more from 10 to 50 N"),
    ],
)
def test_answers_that_determine_no_threshold(positive: list[int], expected: str | None) -> None:
    reason = fit([10, 20, 30, 40, 50], positive, [20] * 5, lapse=0.0).undetermined("N")
    assert reason is None if expected is None else reason is not None and expected in reason


def test_constant_stimuli() -> None:
    """Each block has each level once; equal seeds give equal orders; a stored run continues as before."""
    given = ConstantStimuliParameters(levels=LEVELS.tolist(), repetitions=30, seed=4, lapse=0.0)
    one, twin = ConstantStimuli(given), ConstantStimuli(given)
    assert one.order == twin.order
    assert all(sorted(one.order[start : start + 7]) == LEVELS.tolist() for start in range(0, 210, 7))
    generator = np.random.Generator(np.random.PCG64(5))
    while (level := one.level()) is not None:
        one.answer(level, bool(generator.random() < logistic(np.array(level), 100, 0.12)))
    assert len(one.answers) == 210
    other = ConstantStimuli.restored(one.state())
    found = other.estimate()
    assert (found.low, found.high) == (one.estimate().low, one.estimate().high)
    assert found.low < 100 < found.high
    assert found.high - found.low < 10
