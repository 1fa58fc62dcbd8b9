"""A scale from paired comparisons: the model of Bradley and Terry with ties by Davidson.

    P(i over j) : P(j over i) : P(tie) = s_i : s_j : v sqrt(s_i s_j)

s_i is the strength of item i, v the parameter of ties, 0 without ties (Davidson, J. American Statistical Association
65, 1970). The scale is log s with mean 0: a difference of 1 means odds of e. Newton's method finds the logarithms, as
the log-likelihood is concave. Intervals are Wald's, from the information matrix.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from hapticd.analysis.statistics import Estimate, FitError, Floats

_MAX_NEWTON_ITERATIONS: Final = 100
"""Largest number of iterations of Newton's method, after which the fit fails."""
_NORMAL_QUANTILE: Final = 1.959963984540054
"""Half the width of a 95 % interval in standard errors: the normal quantile of 0.975."""


@dataclass(frozen=True, slots=True)
class Scale:
    """A Bradley-Terry scale: log s of each item, where s is the strength of the item."""

    items: tuple[str, ...]
    strengths: tuple[Estimate, ...]
    """log s of each item, with mean 0."""
    tie: Estimate | None
    """The parameter v of ties, or None without ties."""
    covariance: Floats
    """Covariance matrix (k, k) of log s; its rows sum to 0."""
    log_likelihood: float
    comparisons: int


def bradley_terry(wins: npt.ArrayLike, ties: npt.ArrayLike | None = None, items: Sequence[str] | None = None) -> Scale:
    """Fit the Bradley-Terry scale of k items to their paired comparisons.

    `wins` (k, k) counts how often the item of the row was chosen over that of the column. `ties` (k, k) counts ties;
    (i, j) and (j, i) are added. Comparisons of an item with itself are ignored. Raises FitError if the scale has no
    finite estimate, because some items never lost to the others and never tied with them (Ford, 1957).
    """
    won = np.array(wins, dtype=float)
    tied = np.zeros_like(won) if ties is None else np.array(ties, dtype=float)
    count = len(won)
    names = tuple(str(place) for place in range(count)) if items is None else tuple(items)
    if won.shape != (count, count) or tied.shape != won.shape or len(names) != count or count < 2:
        raise FitError("wins and ties must be square tables with a row for each item, and at least two items")
    if not ((won >= 0).all() and (tied >= 0).all()):
        raise FitError("wins and ties must not be negative")
    np.fill_diagonal(won, 0.0)
    np.fill_diagonal(tied, 0.0)
    tied = tied + tied.T
    _check_connected(won + tied, names)
    one, other = np.triu_indices(count, 1)
    tables = np.stack((won[one, other], won[other, one], tied[one, other]))
    used = tables.sum(axis=0) > 0
    design = _design(one[used], other[used], count, bool(tied.any()))
    parameters, information, log_likelihood = _newton(design, tables[:, used])
    return _scale(names, parameters, information, log_likelihood, float(tables.sum()), bool(tied.any()))


def _design(one: npt.NDArray[np.intp], other: npt.NDArray[np.intp], count: int, with_ties: bool) -> Floats:
    """Return the design matrix (outcomes, pairs, parameters): times the parameters, it is the log weights.

    The parameters are log s of all items except the last, which is 0, and with ties log v. A pair has 3 outcomes, or 2
    without ties. A term that all outcomes of a pair have in common is omitted.
    """
    pairs = np.arange(len(one))
    design = np.zeros((3 if with_ties else 2, len(one), count + 1))
    design[0, pairs, one] = 1.0
    design[1, pairs, other] = 1.0
    if with_ties:
        design[2, pairs, one] = design[2, pairs, other] = 0.5
        design[2, :, count] = 1.0
    kept = [*range(count - 1), *([count] if with_ties else [])]
    return np.asarray(design[:, :, kept])


def _newton(design: Floats, tables: Floats) -> tuple[Floats, Floats, float]:
    counts = tables[: len(design)]
    totals = counts.sum(axis=0)
    parameters = np.zeros(design.shape[2])
    value = -np.inf
    step = np.zeros_like(parameters)
    for _ in range(_MAX_NEWTON_ITERATIONS):
        logits = design @ parameters
        logs = logits - np.logaddexp.reduce(logits, axis=0)
        reached = float(np.sum(counts * logs))
        if reached < value - 1e-12 * abs(value):  # the step was too long: halve it
            step = 0.5 * step
            parameters = parameters - step
            continue
        value = reached
        expected = totals * np.exp(logs)
        gradient = np.einsum("op,opq->q", counts - expected, design)
        centre = np.einsum("op,opq->pq", np.exp(logs), design)
        spread = design - centre
        information = np.einsum("op,opq,opr->qr", expected, spread, spread)
        step = np.linalg.solve(information, gradient)
        parameters = parameters + step
        if np.abs(step).max() < 1e-10:
            return parameters, information, value
    raise FitError("the scale does not converge: more comparisons are needed")


def _scale(
    names: tuple[str, ...],
    parameters: Floats,
    information: Floats,
    log_likelihood: float,
    total: float,
    with_ties: bool,
) -> Scale:
    count = len(names)
    covariance = np.linalg.inv(information)
    centring = (np.eye(count) - 1.0 / count)[:, : count - 1]
    strengths = centring @ parameters[: count - 1]
    own = centring @ covariance[: count - 1, : count - 1] @ centring.T
    reach = _NORMAL_QUANTILE * np.sqrt(np.diag(own))
    tie = None
    if with_ties:
        around = np.exp(parameters[-1] + _NORMAL_QUANTILE * np.sqrt(covariance[-1, -1]) * np.array((0.0, -1.0, 1.0)))
        tie = Estimate(float(around[0]), float(around[1]), float(around[2]))
    return Scale(
        names,
        tuple(
            Estimate(float(each), float(each - half), float(each + half))
            for each, half in zip(strengths, reach, strict=True)
        ),
        tie,
        own,
        log_likelihood,
        int(total),
    )


def _check_connected(beaten: Floats, names: tuple[str, ...]) -> None:
    from scipy.sparse.csgraph import connected_components

    parts, part_of = connected_components(beaten > 0, directed=True, connection="strong")
    if parts == 1:
        return
    groups = [", ".join(name for name, own in zip(names, part_of, strict=True) if own == part) for part in range(parts)]
    raise FitError(
        f"no finite scale: between the groups {' | '.join(groups)} all comparisons have one outcome, or are missing; "
        "more comparisons are needed"
    )
