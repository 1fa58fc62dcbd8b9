"""Tables of percent correct of each pair of items, as Tables 2 and 3 of Okamura, Dennerlein and Howe (1998).

Both orders of a pair are counted together. The diagonal has the comparisons of an item with itself.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hapticd.analysis.statistics import FitError, Floats, Ints


@dataclass(frozen=True, slots=True)
class OrderMatrix:
    """Trials and correct answers of each pair of k items: lower triangles with their diagonals."""

    items: tuple[str, ...]
    correct: Ints
    """Numbers of correct answers (k, k), 0 above the diagonal."""
    trials: Ints
    """Numbers of trials (k, k), 0 above the diagonal."""

    @property
    def percent(self) -> Floats:
        """Percent correct (k, k); NaN for a pair without trials, and above the diagonal."""
        return np.asarray(
            np.divide(100.0 * self.correct, self.trials, out=np.full(self.trials.shape, np.nan), where=self.trials > 0)
        )


def order_matrix(pairs: Iterable[tuple[str, str]], correct: Iterable[bool], items: Sequence[str]) -> OrderMatrix:
    """Return the trials and correct answers of each pair, with rows and columns in the order of `items`.

    `pairs` has the items of each trial, `correct` whether its answer was correct. Raises FitError for unknown items.
    """
    places = {name: place for place, name in enumerate(items)}
    trials = np.zeros((len(places), len(places)), dtype=np.int64)
    right = np.zeros_like(trials)
    for (one, other), own in zip(pairs, correct, strict=True):
        if one not in places or other not in places:
            raise FitError(f"unknown item {one if one not in places else other}; known: {', '.join(items)}")
        row, column = sorted((places[one], places[other]), reverse=True)
        trials[row, column] += 1
        right[row, column] += own
    return OrderMatrix(tuple(items), right, trials)


def rank_correlation(ours: npt.ArrayLike, published: npt.ArrayLike) -> tuple[float, int]:
    """Return Spearman's rank correlation over the cells that are finite in both tables, and the number of these cells.

    The correlation is NaN for fewer than three cells, or if either table is constant in these cells. Raises FitError
    for tables of different sizes.
    """
    one, other = np.asarray(ours, dtype=float).ravel(), np.asarray(published, dtype=float).ravel()
    if one.shape != other.shape:
        raise FitError(f"tables must have equal numbers of cells, have {one.size} and {other.size}")
    both = np.isfinite(one) & np.isfinite(other)
    one, other = one[both], other[both]
    if len(one) < 3 or np.ptp(one) == 0 or np.ptp(other) == 0:
        return float("nan"), len(one)
    from scipy.stats import spearmanr

    return float(spearmanr(one, other).statistic), len(one)
