"""Compares two conditions by a measure of the motion of the same participants: difference, tests and effect size."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hapticd.analysis.statistics import CONFIDENCE_LEVEL, Estimate, FitError, student_t


@dataclass(frozen=True, slots=True)
class PairedComparison:
    """A paired comparison of two conditions: differences, one minus the other, have the unit of the measure."""

    participants: int
    difference: Estimate
    """Mean difference, with its interval from Student's t distribution."""
    standard_deviation: float
    """Standard deviation of the differences."""
    effect_size: Estimate
    """Cohen's d_z, the mean of the differences divided by their standard deviation, with its interval from the
    noncentral t distribution.
    """
    t: float
    """Statistic of the paired t test."""
    p_value: float
    """p value of the paired t test, two-sided."""
    wilcoxon_p: float
    """p value of Wilcoxon's signed-rank test, two-sided; 1 if all differences are 0."""


def paired(one: npt.ArrayLike, other: npt.ArrayLike, level: float = CONFIDENCE_LEVEL) -> PairedComparison:
    """Compare the values (n,) of the same n participants, in the same order, in two conditions.

    `level` is the confidence level of the intervals. Raises FitError for fewer than two participants, for unequal
    numbers of values, for values that are not finite, and if all differences are equal.
    """
    first, second = np.asarray(one, dtype=float), np.asarray(other, dtype=float)
    if first.ndim != 1 or first.shape != second.shape:
        raise FitError("a paired comparison needs as many values of one condition as of the other")
    if len(first) < 2:
        raise FitError(f"a comparison needs at least two participants with both conditions, has {len(first)}")
    differences = first - second
    if not np.isfinite(differences).all():
        raise FitError("a paired comparison needs finite values")
    count, mean = len(differences), float(differences.mean())
    deviation = float(differences.std(ddof=1))
    if not deviation > 1e-12 * float(np.abs(first).max() + np.abs(second).max()):
        raise FitError("all differences are equal: they have neither an interval nor an effect size")
    from scipy.stats import ttest_rel, wilcoxon

    test = ttest_rel(first, second)
    half = student_t(count - 1, level) * deviation / math.sqrt(count)
    ends = noncentrality(float(test.statistic), count - 1, level)
    return PairedComparison(
        count,
        Estimate(mean, mean - half, mean + half),
        deviation,
        Estimate(mean / deviation, ends[0] / math.sqrt(count), ends[1] / math.sqrt(count)),
        float(test.statistic),
        float(test.pvalue),
        float(wilcoxon(first, second).pvalue) if differences.any() else 1.0,
    )


def noncentrality(t: float, freedom: int, level: float = CONFIDENCE_LEVEL) -> tuple[float, float]:
    """Return the interval of the noncentrality parameter of a t statistic (Steiger and Fouladi, 1997).

    `freedom` is the number of degrees of freedom, `level` the confidence level.
    """
    from scipy.optimize import brentq
    from scipy.special import nctdtr

    if t < 0:  # by symmetry; nctdtr fails for some negative t
        low, high = noncentrality(-t, freedom, level)
        return -high, -low
    rest = 0.5 * (1.0 - level)

    def end(part: float) -> float:
        reach = 6.0 * math.sqrt(1.0 + 0.5 * t**2 / freedom)
        low = max(t - reach, -4.0)  # where less than 4e-5 of the distribution is above 0
        return float(brentq(lambda each: nctdtr(freedom, each, t) - part, low, t + reach, xtol=1e-10))

    return end(1.0 - rest), end(rest)
