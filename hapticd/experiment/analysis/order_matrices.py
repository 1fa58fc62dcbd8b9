"""Percent correct of each pair of items, as Tables 2 and 3 of Okamura, Dennerlein and Howe (1998) show it.

A pair counts in either order. The diagonal is of items that were compared with themselves.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hapticd.analysis.statistics import FitError, Floats, Ints


@dataclass(frozen=True, slots=True)
class OrderMatrix:
    """Trials and correct answers of each pair: a lower triangle with its diagonal."""

    items: tuple[str, ...]
    correct: Ints
    """(k, k); above the diagonal 0."""
    trials: Ints

    @property
    def percent(self) -> Floats:
        """(k, k) percent correct; nan where nothing was asked, and above the diagonal."""
        return np.asarray(
            np.divide(100.0 * self.correct, self.trials, out=np.full(self.trials.shape, np.nan), where=self.trials > 0)
        )


def order_matrix(pairs: Iterable[tuple[str, str]], correct: Iterable[bool], items: Sequence[str]) -> OrderMatrix:
    """The matrix of trials, rows and columns in the order of `items`. Raises FitError for an item that is none of
    them."""
    places = {name: place for place, name in enumerate(items)}
    trials = np.zeros((len(places), len(places)), dtype=np.int64)
    right = np.zeros_like(trials)
    for (one, other), own in zip(pairs, correct, strict=True):
        if one not in places or other not in places:
            raise FitError(f"{one if one not in places else other} is none of the items: {', '.join(items)}")
        row, column = sorted((places[one], places[other]), reverse=True)
        trials[row, column] += 1
        right[row, column] += own
    return OrderMatrix(tuple(items), right, trials)


def rank_correlation(ours: npt.ArrayLike, published: npt.ArrayLike) -> tuple[float, int]:
    """Spearman's rank correlation of two tables of one shape, over the cells that are finite in both, and their number.

    nan where there are fewer than three cells, or where one table is the same in all of them.
    """
    one, other = np.asarray(ours, dtype=float).ravel(), np.asarray(published, dtype=float).ravel()
    if one.shape != other.shape:
        raise FitError(f"tables of {one.size} and {other.size} cells cannot be compared")
    both = np.isfinite(one) & np.isfinite(other)
    one, other = one[both], other[both]
    if len(one) < 3 or np.ptp(one) == 0 or np.ptp(other) == 0:
        return float("nan"), len(one)
    from scipy.stats import spearmanr

    return float(spearmanr(one, other).statistic), len(one)
