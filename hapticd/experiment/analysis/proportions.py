"""Percent correct: Wilson intervals and exact tests against chance, by scipy."""

from __future__ import annotations

from dataclasses import dataclass

from hapticd.analysis.statistics import CONFIDENCE_LEVEL, FitError


@dataclass(frozen=True, slots=True)
class Proportion:
    """Successes among trials. Proportions are between 0 and 1."""

    successes: int
    trials: int
    value: float
    low: float
    """Ends of Wilson's 95 % interval ("Probable inference", J. American Statistical Association 22, 1927)."""
    high: float
    chance: float | None
    p_value: float | None
    """Of the exact binomial test against chance, two-sided; None where no chance level is given."""


def proportion(successes: int, trials: int, chance: float | None = None, level: float = CONFIDENCE_LEVEL) -> Proportion:
    """Raises FitError without trials, for counts that are none, and for a chance level outside 0 to 1."""
    if trials < 1 or not 0 <= successes <= trials:
        raise FitError(
            f"{successes} successes of {trials} trials are no proportion: needs 0 to n of n trials, n at least 1"
        )
    if chance is not None and not 0 <= chance <= 1:
        raise FitError(f"chance level {chance:g} must be a proportion, 0 to 1")
    from scipy.stats import binomtest

    test = binomtest(successes, trials, 0.5 if chance is None else chance)
    ends = test.proportion_ci(level, method="wilson")
    p_value = None if chance is None else float(test.pvalue)
    return Proportion(successes, trials, successes / trials, float(ends.low), float(ends.high), chance, p_value)
