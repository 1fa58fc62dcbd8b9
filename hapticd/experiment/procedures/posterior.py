"""Posteriors on a grid: probabilities of parameters after answers, what a next answer would tell, and intervals.

Arrays of posteriors are (..., g): g grid points, and any number of observers before them. A table is (l, g): the
probability of a positive answer at each of l levels, by the parameters of each grid point.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from hapticd.experiment.analysis.psychometric_shapes import Floats

LEVEL_OF_INTERVALS: Final = 0.95


def updated(posterior: Floats, likelihood: Floats) -> Floats:
    """Bayes' rule: posterior times likelihood, both (..., g), normalised to 1."""
    product = posterior * likelihood
    return np.asarray(product / product.sum(axis=-1, keepdims=True))


def expected_entropies(posterior: Floats, table: Floats) -> Floats:
    """(..., l) expected entropy, nats, of posteriors (..., g) after one answer at each level (Watson, "QUEST+", J.
    Vision 17, 2017, eq. 7).

    Of a posterior w and a likelihood L the entropy is log Z - (sum of w L log(w L)) / Z with Z = sum of w L, so that
    the sums over the grid are matrix products.
    """
    own = np.asarray(_times_log(posterior))
    expected = np.zeros((*posterior.shape[:-1], len(table)))
    for likelihood in (table, 1.0 - table):
        total = posterior @ likelihood.T
        inner = own @ likelihood.T + posterior @ _times_log(likelihood).T
        expected += np.where(total > 0, _times_log(total) - inner, 0.0)
    return expected


def _times_log(values: Floats) -> Floats:
    """x log x, 0 at 0."""
    return np.asarray(values * np.log(np.where(values > 0, values, 1.0)))


def marginal(posterior: Floats, shape: tuple[int, ...], along: int) -> Floats:
    """(n,) of a posterior (g,) over a grid of `shape`, the probability of each value of one of its axes."""
    others = tuple(place for place in range(len(shape)) if place != along)
    return np.asarray(posterior.reshape(shape).sum(axis=others))


def interval(values: Floats, weights: Floats, level: float = LEVEL_OF_INTERVALS) -> tuple[float, float]:
    """The ends between which `level` of the probability lies, as much of the rest on either side.

    `values` (n,) rise; each stands for the cell that ends midway to its neighbours, in which `weights` (n,) are spread
    evenly.
    """
    if len(values) == 1:
        return float(values[0]), float(values[0])
    middles = 0.5 * (values[1:] + values[:-1])
    edges = np.concatenate(([2 * values[0] - middles[0]], middles, [2 * values[-1] - middles[-1]]))
    below = np.concatenate(([0.0], np.cumsum(weights)))
    rest = 0.5 * (1.0 - level)
    low, high = np.interp((rest, 1.0 - rest), below / below[-1], edges)
    return float(max(low, values[0])), float(min(high, values[-1]))


def summary(values: Floats, weights: Floats, back: Callable[[Floats], Floats]) -> tuple[float, float, float]:
    """Mean and 95 % interval of values (n,) with weights (n,), each as `back` maps it to the level."""
    mean = float(np.sum(values * weights) / np.sum(weights))
    ends = interval(values, weights)
    found = back(np.array((mean, *ends)))
    return float(found[0]), float(found[1]), float(found[2])
