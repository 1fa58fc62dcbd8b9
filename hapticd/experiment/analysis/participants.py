"""Statistics over participants: each participant contributes one value, regardless of the number of trials."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hapticd.analysis.statistics import FitError


@dataclass(frozen=True, slots=True)
class Quartiles:
    """Median and quartiles over participants, each with one value, in the unit of the values."""

    participants: int
    median: float
    low: float
    """First quartile, interpolated linearly (type 7 of Hyndman and Fan, 1996)."""
    high: float
    """Third quartile."""


def quartiles(values: Sequence[float]) -> Quartiles:
    """Return median and quartiles of one value per participant. Raises FitError without values."""
    if not len(values):
        raise FitError("no participant has a value: quartiles need at least one")
    low, median, high = np.quantile(np.asarray(values, dtype=float), (0.25, 0.5, 0.75))
    return Quartiles(len(values), float(median), float(low), float(high))


def mean_of_each(values: Mapping[str, Sequence[float]]) -> dict[str, float]:
    """Return the mean of the values of each participant. Participants without values are omitted."""
    return {name: float(np.mean(own)) for name, own in values.items() if len(own)}


def mean_ranks(rankings: Sequence[Sequence[str]]) -> tuple[dict[str, float], float]:
    """Return the mean rank of each item, 1 being first, and Kendall's coefficient of concordance W of the rankings.

    W is 0 without agreement and 1 if all rankings are equal. Raises FitError without rankings, or unless each ranking
    contains the same items, each once.
    """
    if not rankings or len(rankings[0]) < 2:
        raise FitError("mean ranks need at least one ranking of at least two items")
    items = sorted(rankings[0])
    for place, ranking in enumerate(rankings):
        if sorted(ranking) != items or len(set(ranking)) < len(ranking):
            raise FitError(f"ranking {place + 1} must contain each item of the first ranking once: {', '.join(items)}")
    ranks = np.array([[list(ranking).index(item) + 1 for item in items] for ranking in rankings], dtype=float)
    sums = ranks.sum(axis=0)
    count, raters = len(items), len(rankings)
    concordance = 12.0 * float(np.sum((sums - sums.mean()) ** 2)) / (raters**2 * (count**3 - count))
    return dict(zip(items, (ranks.mean(axis=0)).tolist(), strict=True)), concordance
