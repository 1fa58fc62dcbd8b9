"""Proportions of correct answers, with Wilson's intervals and exact tests against chance, by scipy."""

from __future__ import annotations

from dataclasses import dataclass

from hapticd.analysis.statistics import CONFIDENCE_LEVEL, FitError


@dataclass(frozen=True, slots=True)
class Proportion:
    """A proportion of successes among trials, between 0 and 1, with its interval and a test against chance."""

    successes: int
    trials: int
    value: float
    low: float
    """Lower end of Wilson's 95 % interval ("Probable inference", J. American Statistical Association 22, 1927)."""
    high: float
    """Upper end of Wilson's interval."""
    chance: float | None
    p_value: float | None
    """p value of the exact binomial test against chance, two-sided; None without a chance level."""


def proportion(successes: int, trials: int, chance: float | None = None, level: float = CONFIDENCE_LEVEL) -> Proportion:
    """Return the proportion of successes among trials, with its interval of confidence `level`.

    `chance` is the probability of a success by guessing. Raises FitError if `chance` is outside 0 to 1, or for
    impossible counts.
    """
    if trials < 1 or not 0 <= successes <= trials:
        raise FitError(
            f"successes must be between 0 and the number of trials (at least 1), are {successes} of {trials}"
        )
    if chance is not None and not 0 <= chance <= 1:
        raise FitError(f"the chance level must be between 0 and 1, is {chance:g}")
    from scipy.stats import binomtest

    test = binomtest(successes, trials, 0.5 if chance is None else chance)
    ends = test.proportion_ci(level, method="wilson")
    p_value = None if chance is None else float(test.pvalue)
    return Proportion(successes, trials, successes / trials, float(ends.low), float(ends.high), chance, p_value)
