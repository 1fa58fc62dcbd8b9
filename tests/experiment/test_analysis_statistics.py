"""Proportions, information, scales, comparisons, matrices and quartiles against scipy, statsmodels and closed forms."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import numpy.typing as npt
import pytest
import statsmodels.api as sm
from scipy import stats
from statsmodels.stats.proportion import binom_test, proportion_confint

from hapticd.analysis.statistics import FitError
from hapticd.experiment.analysis.bradley_terry import bradley_terry
from hapticd.experiment.analysis.confusion import confusion, information
from hapticd.experiment.analysis.motor import noncentrality, paired
from hapticd.experiment.analysis.order_matrices import order_matrix, rank_correlation
from hapticd.experiment.analysis.participants import mean_ranks, quartiles
from hapticd.experiment.analysis.proportions import proportion


@pytest.mark.parametrize("right, trials", [(0, 8), (8, 8), (3, 8), (64, 100), (1, 1), (139, 224)])
@pytest.mark.parametrize("chance", [1 / 3, 0.5])
def test_wilson_and_binomial(right: int, trials: int, chance: float) -> None:
    found = proportion(right, trials, chance)
    assert (found.low, found.high) == pytest.approx(proportion_confint(right, trials, method="wilson"), abs=1e-12)
    assert found.p_value == pytest.approx(binom_test(right, trials, chance), rel=1e-9)


def test_the_binomial_test_is_exact() -> None:
    """3 of 8 at 1/3: the sum over all outcomes that are not more probable, in fractions."""
    third = Fraction(1, 3)
    chances = [math.comb(8, k) * third**k * (1 - third) ** (8 - k) for k in range(9)]
    expected = sum(each for each in chances if each <= chances[6])
    assert proportion(6, 8, 1 / 3).p_value == pytest.approx(float(expected), rel=1e-12)


def test_wilsons_interval_covers() -> None:
    """Exact coverage over all outcomes of 40 trials: on average 95 % for proportions of 20 to 80 %."""
    ends = [proportion(right, 40) for right in range(41)]
    covers = []
    for truth in np.linspace(0.2, 0.8, 61):
        chances = stats.binom.pmf(np.arange(41), 40, truth)
        covers.append(sum(chance for chance, each in zip(chances, ends, strict=True) if each.low <= truth <= each.high))
    assert 0.93 <= np.mean(covers) <= 0.97


@pytest.mark.parametrize("right, trials, chance", [(3, 2, None), (0, 0, None), (1, 2, 1.5)])
def test_no_proportion(right: int, trials: int, chance: float | None) -> None:
    with pytest.raises(FitError):
        proportion(right, trials, chance)


@pytest.mark.parametrize("count", [2, 4, 7])
def test_information_of_perfect_and_random_answers(count: int) -> None:
    perfect = information(100 * np.eye(count))
    assert (perfect.transfer, perfect.corrected, perfect.stimuli) == pytest.approx((math.log2(count),) * 3, abs=1e-12)
    assert perfect.relative == pytest.approx(1)
    random = information(np.full((count, count), 10))
    assert (random.transfer, random.corrected) == pytest.approx((0, 0), abs=1e-12)


@pytest.mark.parametrize("error", [0.01, 0.1, 0.4])
def test_information_of_a_binary_symmetric_channel(error: float) -> None:
    """1 - H(error) bits (Shannon, 1948). The bias of n trials is 1/(2 n ln 2)."""
    counts = 1e6 * np.array([[1 - error, error], [error, 1 - error]])
    expected = 1 + error * math.log2(error) + (1 - error) * math.log2(1 - error)
    found = information(counts)
    assert found.transfer == pytest.approx(expected, abs=1e-12)
    assert found.transfer - found.corrected == pytest.approx(1 / (2 * 2e6 * math.log(2)), rel=1e-3)


def test_information_of_two_groups() -> None:
    """Four stimuli of which pairs are confused completely give one bit, unequal frequencies their entropy."""
    assert information(np.kron(np.eye(2), np.ones((2, 2)))).transfer == pytest.approx(1, abs=1e-12)
    assert information(np.diag([50, 25, 25])).transfer == pytest.approx(1.5, abs=1e-12)


def test_the_bias_of_few_trials_is_removed() -> None:
    """Answers independent of the stimuli give on average 0 bits, while the uncorrected estimate is larger."""
    generator = np.random.Generator(np.random.PCG64(1))
    tables = generator.multinomial(20, np.full(4, 0.25), size=(1000, 4))
    found = [information(table) for table in tables]
    expected = 9 / (2 * 80 * math.log(2))
    assert np.mean([each.transfer for each in found]) == pytest.approx(expected, rel=0.1)
    unclipped = [each.transfer - expected for each in found]
    assert abs(np.mean(unclipped)) < 0.01
    assert np.mean([each.corrected for each in found]) < 0.4 * expected


def test_a_confusion_matrix() -> None:
    found = confusion(["b", "a", "b", "b"], ["a", "a", "b", "none"], order=("a", "b"))
    assert (found.stimuli, found.answers) == (("a", "b"), ("a", "b", "none"))
    assert found.counts.tolist() == [[1, 0, 0], [1, 1, 1]]
    assert found.percent[1] == pytest.approx([100 / 3] * 3)


def comparisons(seed: int, ties: bool) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    generator = np.random.Generator(np.random.PCG64(seed))
    strengths = np.exp([-1.0, -0.5, 0.0, 0.4, 1.1])
    wins, tied = np.zeros((5, 5), dtype=np.int64), np.zeros((5, 5), dtype=np.int64)
    for one in range(5):
        for other in range(one + 1, 5):
            weights = np.array([strengths[one], strengths[other], 0.7 * math.sqrt(strengths[one] * strengths[other])])
            weights[2] *= ties
            wins[one, other], wins[other, one], tied[one, other] = generator.multinomial(30, weights / weights.sum())
    return wins, tied


def test_bradley_terry_is_a_logistic_regression() -> None:
    wins, _ = comparisons(2, ties=False)
    found = bradley_terry(wins)
    rows, answers = [], []
    for one in range(5):
        for other in range(one + 1, 5):
            rows.append(np.eye(5)[one] - np.eye(5)[other])
            answers.append((wins[one, other], wins[other, one]))
    design = np.array(rows)[:, :4]  # the last item is 0
    reference = sm.GLM(np.array(answers), design, family=sm.families.Binomial()).fit(tol=1e-12)
    expected = np.append(reference.params, 0) - np.append(reference.params, 0).mean()
    assert [each.value for each in found.strengths] == pytest.approx(expected, abs=1e-7)
    centring = (np.eye(5) - 0.2)[:, :4]
    errors = np.sqrt(np.diag(centring @ reference.cov_params() @ centring.T))
    reach = [(each.high - each.low) / 2 / 1.959963984540054 for each in found.strengths]
    assert reach == pytest.approx(errors, rel=1e-6)
    assert found.tie is None


def test_bradley_terry_with_ties_is_a_log_linear_model() -> None:
    """Davidson's model is a Poisson regression with a factor for each pair (Fienberg and Larntz, 1976)."""
    wins, ties = comparisons(3, ties=True)
    found = bradley_terry(wins, ties)
    rows, answers = [], []
    pairs = [(one, other) for one in range(5) for other in range(one + 1, 5)]
    for place, (one, other) in enumerate(pairs):
        own = np.eye(len(pairs))[place]
        half = 0.5 * (np.eye(5)[one] + np.eye(5)[other])
        for weight, tie, count in (
            (np.eye(5)[one], 0, wins[one, other]),
            (np.eye(5)[other], 0, wins[other, one]),
            (half, 1, ties[one, other]),
        ):
            rows.append(np.concatenate((weight[:4], [tie], own)))
            answers.append(count)
    reference = sm.GLM(np.array(answers), np.array(rows), family=sm.families.Poisson()).fit(tol=1e-12)
    expected = np.append(reference.params[:4], 0) - np.append(reference.params[:4], 0).mean()
    assert [each.value for each in found.strengths] == pytest.approx(expected, abs=1e-7)
    assert found.tie is not None
    assert found.tie.value == pytest.approx(math.exp(reference.params[4]), rel=1e-7)
    assert math.log(found.tie.high / found.tie.value) / 1.959963984540054 == pytest.approx(reference.bse[4], rel=1e-6)


@pytest.mark.slow
def test_bradley_terrys_intervals_cover() -> None:
    """In 1,000 sets of comparisons the bias is below 5 %, and 95 % intervals cover 93 to 97 %."""
    truth = np.array([-1.0, -0.5, 0.0, 0.4, 1.1])
    truth -= truth.mean()
    found = [bradley_terry(*comparisons(seed, ties=True)).strengths for seed in range(1000)]
    values = np.array([[(each.value, each.low, each.high) for each in scale] for scale in found])
    assert values[:, :, 0].mean(axis=0) == pytest.approx(truth, abs=0.05)
    assert 0.93 <= np.mean((values[:, :, 1] <= truth) & (truth <= values[:, :, 2])) <= 0.97


def test_a_scale_without_end() -> None:
    with pytest.raises(FitError, match=r"no finite scale: between .*c.* all comparisons have one outcome"):
        bradley_terry([[0, 5, 0], [4, 0, 0], [9, 9, 0]], items=("a", "b", "c"))
    assert bradley_terry([[0, 5, 0], [4, 0, 0], [9, 9, 0]], [[0, 0, 1], [0, 0, 0], [0, 0, 0]]).comparisons == 28


def test_paired_comparison_against_scipy() -> None:
    generator = np.random.Generator(np.random.PCG64(4))
    one = generator.normal(5, 1, 8)
    other = one + generator.normal(0.3, 0.6, 8)
    found = paired(one, other)
    reference = stats.ttest_rel(one, other)
    ends = reference.confidence_interval(0.95)
    assert (found.t, found.p_value) == pytest.approx((reference.statistic, reference.pvalue))
    assert (found.difference.low, found.difference.high) == pytest.approx((ends.low, ends.high))
    assert found.effect_size.value == pytest.approx(reference.statistic / math.sqrt(8))


@pytest.mark.parametrize("t, freedom", [(0.0, 7), (2.5, 7), (-4.0, 20)])
def test_the_noncentrality_is_that_of_scipys_distribution(t: float, freedom: int) -> None:
    low, high = noncentrality(t, freedom)
    assert stats.nct.sf(t, freedom, low) == pytest.approx(0.025, abs=1e-6)
    assert stats.nct.cdf(t, freedom, high) == pytest.approx(0.025, abs=1e-6)


@pytest.mark.slow
def test_intervals_of_differences_and_effects_cover() -> None:
    """1,000 studies with eight people, with mean and SD of the difference of the paper's puncture study, in mm."""
    generator = np.random.Generator(np.random.PCG64(5))
    differences = generator.normal(-0.161, 1.04, (1000, 8))
    found = [paired(row, np.zeros(8)) for row in differences]
    assert 0.93 <= np.mean([each.difference.low <= -0.161 <= each.difference.high for each in found]) <= 0.97
    effect = -0.161 / 1.04
    assert 0.93 <= np.mean([each.effect_size.low <= effect <= each.effect_size.high for each in found]) <= 0.97


@pytest.mark.parametrize("one, other", [([1.0], [2.0]), ([1.0, 2.0], [2.0, 3.0]), ([1.0, 2.0], [1.0, math.nan])])
def test_no_comparison(one: list[float], other: list[float]) -> None:
    with pytest.raises(FitError):
        paired(one, other)


def test_an_order_matrix() -> None:
    """Both orders of a pair are counted together. The diagonal has equal items."""
    pairs = [("a", "b"), ("b", "a"), ("c", "c"), ("a", "c")]
    found = order_matrix(pairs, [True, False, True, True], ("a", "b", "c"))
    expected = [[math.nan] * 3, [50, math.nan, math.nan], [100, math.nan, 100]]
    assert found.percent == pytest.approx(np.array(expected), nan_ok=True)
    with pytest.raises(FitError, match="unknown item d; known: "):
        order_matrix([("a", "d")], [True], ("a", "b"))


def test_rank_correlation_of_finite_cells() -> None:
    assert rank_correlation([1, 2, 3, math.nan], [10, 20, 40, 5]) == (pytest.approx(1), 3)
    assert rank_correlation([1, 2, 3, 4], [4, 3, 2, 1])[0] == pytest.approx(-1)
    assert math.isnan(rank_correlation([1, 1, 1], [1, 2, 3])[0])


def test_quartiles_and_ranks() -> None:
    """Quartiles by hand (type 7), and Kendall's W from scipy's Friedman statistic."""
    found = quartiles([1, 2, 3, 4])
    assert (found.low, found.median, found.high) == (1.75, 2.5, 3.25)
    rankings = [["a", "b", "c"], ["a", "c", "b"], ["b", "a", "c"], ["a", "b", "c"]]
    ranks, concordance = mean_ranks(rankings)
    assert ranks == {"a": 1.25, "b": 2.0, "c": 2.75}
    table = np.array([[ranking.index(item) + 1 for item in "abc"] for ranking in rankings])
    assert concordance == pytest.approx(stats.friedmanchisquare(*table.T).statistic / (4 * 2))
    with pytest.raises(FitError, match="ranking 2 must contain each item"):
        mean_ranks([["a", "b"], ["a", "c"]])
