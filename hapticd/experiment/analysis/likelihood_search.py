"""Fit many psychometric functions at once: the most probable parameters of b sets of answers to the same levels.

The parameters are threshold (on the axis), log of the slope, guess and lapse. The levels bound threshold and slope (see
`Box`). Guess and lapse are fixed, or estimated with the prior Beta(1, 10) of psignifit (Schuett, Harmeling, Macke and
Wichmann, Vision Research 122, 2016). The search begins at the best point of a coarse grid. It is Fisher scoring with
Levenberg's damping, on the parameters that are not at a bound.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from hapticd.analysis.statistics import Floats
from hapticd.experiment.analysis.psychometric_shapes import Shape, density, rise

THRESHOLD, SLOPE, GUESS, LAPSE = range(4)
MAX_ESTIMATED_RATE: Final = 0.3
"""Upper bound of an estimated guess or lapse, which are probabilities."""
_PRIOR_EXPONENT: Final = 9.0
"""Exponent of the prior Beta(1, 10) of a guess or lapse: its logarithm is this number times log(1 - rate)."""
MAX_SEARCH_ROUNDS: Final = 60
"""Largest number of iterations of a search that begins at a point of the grid."""
MAX_RESAMPLE_ROUNDS: Final = 12
"""Largest number of iterations for a resample of a fit: the search begins at the fit, near the maximum."""
SEARCH_TOLERANCE: Final = 1e-11
"""The search ends after a step that increases the log probability by less than this."""
RESAMPLE_TOLERANCE: Final = 1e-6
"""SEARCH_TOLERANCE of the search for a resample. It corresponds to 0.0014 standard errors of a parameter."""
_MIN_SEARCH_STEP: Final = 1e-7
"""The search ends after a step that gains no probability and changes every parameter by less than this."""
_MIN_POSITIVE: Final = 1e-12
"""Lower bound of probabilities, also added to the diagonal of the information matrix: avoids log(0) and 1 / 0."""
_GRID_POINTS: Final = (25, 11)
"""Numbers of thresholds and of slopes of the grid at which a search begins."""
_MIN_DAMPING, _MAX_DAMPING = 1e-9, 1e9


@dataclass(frozen=True, slots=True)
class Box:
    """Lower and upper bounds (4,) of the parameters: threshold, log of the slope, guess and lapse."""

    low: Floats
    high: Floats

    @classmethod
    def around(cls, positions: Floats, guess: float | None, lapse: float | None) -> Box:
        """Return the bounds of the parameters for stimuli at `positions` (k,) on the axis, in a range of width w.

        The threshold is at most w beyond the lowest or highest position. The slope is from 0.05 / w to 6 / d, where d
        is the smallest distance of two positions: with 6 / d a logistic function rises from 5 to 95 % within d.
        """
        ordered = np.unique(positions)
        span, step = float(ordered[-1] - ordered[0]), float(np.diff(ordered).min())
        low = [ordered[0] - span, np.log(0.05 / span), *(0.0 if rate is None else rate for rate in (guess, lapse))]
        high = [
            ordered[-1] + span,
            np.log(6.0 / step),
            *(MAX_ESTIMATED_RATE if rate is None else rate for rate in (guess, lapse)),
        ]
        return cls(np.array(low), np.array(high))


def modelled(shape: Shape, positions: Floats, parameters: Floats, sign: float) -> Floats:
    """Return the probabilities (b, k) of positive answers at `positions` (k,) on the axis, for parameters (b, 4).

    `sign` is 1 for a function that rises with the level, -1 for one that falls.
    """
    z = sign * (positions - parameters[:, THRESHOLD, None]) * np.exp(parameters[:, SLOPE, None])
    guess, lapse = parameters[:, GUESS, None], parameters[:, LAPSE, None]
    return np.asarray(guess + (1.0 - guess - lapse) * rise(shape, z))


def log_likelihood(positive: Floats, trials: Floats, probability: Floats) -> Floats:
    """Return the log likelihoods (b,) of b sets of answers to k levels, without the binomial coefficients.

    `positive` and `trials` (b, k) count positive and all answers.
    """
    bounded = np.clip(probability, _MIN_POSITIVE, 1.0 - _MIN_POSITIVE)
    return np.asarray((positive * np.log(bounded) + (trials - positive) * np.log1p(-bounded)).sum(axis=1))


def most_probable(
    shape: Shape,
    positions: Floats,
    positive: Floats,
    trials: Floats,
    box: Box,
    sign: float = 1.0,
    starts: Floats | None = None,
    tolerance: float = SEARCH_TOLERANCE,
    rounds: int = MAX_SEARCH_ROUNDS,
) -> Floats:
    """Return the most probable parameters (b, 4) for b sets of answers to stimuli at `positions` (k,) on the axis.

    `positive` and `trials` (b, k) count positive and all answers. The search begins at `starts` (b, 4), by default at
    the best points of a grid. It ends after a step that increases the log probability by less than `tolerance`.
    """
    found = _starts(shape, positions, positive, trials, box, sign) if starts is None else starts.copy()
    damping = np.full(len(found), 1e-3)
    best = _objective(shape, positions, positive, trials, found, box, sign)
    left = np.arange(len(found))
    for _ in range(rounds):
        own, right, of = found[left], positive[left], trials[left]
        step = _step(shape, positions, right, of, own, box, sign, damping[left])
        moved = np.clip(own + step, box.low, box.high)
        value = _objective(shape, positions, right, of, moved, box, sign)
        better = value >= best[left]
        gain, way = value - best[left], np.abs(moved - own).max(axis=1)
        found[left[better]], best[left[better]] = moved[better], value[better]
        damping[left] = np.clip(np.where(better, damping[left] * 0.2, damping[left] * 10), _MIN_DAMPING, _MAX_DAMPING)
        ended = (better & (gain < tolerance)) | (~better & (way < _MIN_SEARCH_STEP))
        left = left[~ended]
        if not len(left):
            break
    return found


def _starts(shape: Shape, positions: Floats, positive: Floats, trials: Floats, box: Box, sign: float) -> Floats:
    inner = 0.25 * (box.high[THRESHOLD] - box.low[THRESHOLD])
    thresholds = np.linspace(box.low[THRESHOLD] + inner, box.high[THRESHOLD] - inner, _GRID_POINTS[0])
    slopes = np.linspace(box.low[SLOPE], box.high[SLOPE], _GRID_POINTS[1] + 2)[1:-1]
    rates = np.where(box.high[GUESS:] > box.low[GUESS:], 0.02, box.low[GUESS:])
    grid = np.array([(threshold, slope, *rates) for threshold in thresholds for slope in slopes])
    bounded = np.clip(modelled(shape, positions, grid, sign), _MIN_POSITIVE, 1.0 - _MIN_POSITIVE)
    scores = positive @ np.log(bounded).T + (trials - positive) @ np.log1p(-bounded).T
    return np.asarray(grid[np.argmax(scores, axis=1)])


def _objective(
    shape: Shape, positions: Floats, positive: Floats, trials: Floats, parameters: Floats, box: Box, sign: float
) -> Floats:
    free = box.high[GUESS:] > box.low[GUESS:]
    prior = (_PRIOR_EXPONENT * np.log1p(-parameters[:, GUESS:]) * free).sum(axis=1)
    return np.asarray(log_likelihood(positive, trials, modelled(shape, positions, parameters, sign)) + prior)


def _step(
    shape: Shape,
    positions: Floats,
    positive: Floats,
    trials: Floats,
    parameters: Floats,
    box: Box,
    sign: float,
    damping: Floats,
) -> Floats:
    """Return the change (b, 4) of the parameters in a step of Fisher scoring, 0 for parameters that stay at a bound."""
    slope = np.exp(parameters[:, SLOPE, None])
    guess, lapse = parameters[:, GUESS, None], parameters[:, LAPSE, None]
    z = sign * (positions - parameters[:, THRESHOLD, None]) * slope
    risen = rise(shape, z)
    probability = np.clip(guess + (1.0 - guess - lapse) * risen, _MIN_POSITIVE, 1.0 - _MIN_POSITIVE)
    steep = (1.0 - guess - lapse) * density(shape, z)
    free = [int(place) for place in np.flatnonzero(box.high > box.low)]
    columns = {THRESHOLD: -sign * steep * slope, SLOPE: steep * z, GUESS: 1.0 - risen, LAPSE: -risen}
    by = np.stack([columns[each] for each in free], axis=1)  # (b, p, k)
    variance = probability * (1.0 - probability)
    gradient = (by @ ((positive - trials * probability) / variance)[:, :, None])[:, :, 0]
    information = (by * (trials / variance)[:, None]) @ by.transpose(0, 2, 1)
    own = parameters[:, free]
    for place, rate in enumerate(free):
        if rate in (GUESS, LAPSE):
            gradient[:, place] -= _PRIOR_EXPONENT / (1.0 - own[:, place])
            information[:, place, place] += _PRIOR_EXPONENT / (1.0 - own[:, place]) ** 2
    held = ((own <= box.low[free]) & (gradient < 0)) | ((own >= box.high[free]) & (gradient > 0))
    gradient[held] = 0.0
    information[held[:, :, None] | held[:, None, :]] = 0.0
    diagonal = np.arange(len(free))
    damped = information[:, diagonal, diagonal] * (1.0 + damping[:, None]) + _MIN_POSITIVE
    information[:, diagonal, diagonal] = np.where(held, 1.0, damped)
    step = np.zeros_like(parameters)
    step[:, free] = np.linalg.solve(information, gradient[:, :, None])[:, :, 0]
    return step
