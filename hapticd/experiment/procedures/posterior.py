"""Posteriors on a grid: probabilities of parameters given answers, expected entropies, and intervals.

Posteriors are arrays (..., g) over g grid points; the leading axes are observers. A table (l, g) has the probability of
a positive answer at each of l levels, for the parameters at each grid point.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from hapticd.analysis.statistics import Floats

POSTERIOR_INTERVAL_LEVEL: Final = 0.95
"""Probability that the interval of a threshold contains, by convention."""


def updated(posterior: Floats, likelihood: Floats) -> Floats:
    """Return the posterior by Bayes' rule: posterior times likelihood, both (..., g), normalized to 1."""
    product = posterior * likelihood
    return np.asarray(product / product.sum(axis=-1, keepdims=True))


def expected_entropies(posterior: Floats, table: Floats) -> Floats:
    """Return the entropy (..., l) in nats that is expected of a posterior (..., g) after an answer at each of l levels.

    `table` (l, g) has the probabilities of a positive answer (Watson, "QUEST+", J. Vision 17, 2017, eq. 7). For a
    posterior w and a likelihood L the entropy is log Z - (sum of w L log(w L)) / Z, where Z is the sum of w L. The sums
    over the grid are computed as matrix products.
    """
    own = np.asarray(_times_log(posterior))
    expected = np.zeros((*posterior.shape[:-1], len(table)))
    for likelihood in (table, 1.0 - table):
        total = posterior @ likelihood.T
        inner = own @ likelihood.T + posterior @ _times_log(likelihood).T
        expected += np.where(total > 0, _times_log(total) - inner, 0.0)
    return expected


def _times_log(values: Floats) -> Floats:
    """Return x log x of each value x, which is 0 for x = 0."""
    return np.asarray(values * np.log(np.where(values > 0, values, 1.0)))


def marginal(posterior: Floats, shape: tuple[int, ...], along: int) -> Floats:
    """Return the marginal (n,) of a posterior (g,) along axis `along` of its grid, which has the shape `shape`."""
    others = tuple(place for place in range(len(shape)) if place != along)
    return np.asarray(posterior.reshape(shape).sum(axis=others))


def interval(values: Floats, weights: Floats, level: float = POSTERIOR_INTERVAL_LEVEL) -> tuple[float, float]:
    """Return the ends of the central interval that contains the probability `level`.

    `values` (n,) increase. The weight (n,) of a value is distributed uniformly over a cell that ends midway to the
    neighbouring values.
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
    """Return mean and ends of the 95 % interval of values (n,) with weights (n,), which `back` converts to levels."""
    mean = float(np.sum(values * weights) / np.sum(weights))
    ends = interval(values, weights)
    found = back(np.array((mean, *ends)))
    return float(found[0]), float(found[1]), float(found[2])
