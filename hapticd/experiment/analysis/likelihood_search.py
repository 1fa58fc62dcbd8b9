"""Many psychometric functions at once: the parameters of most probability for each of b sets of answers to the same
levels.

Parameters of a set are (threshold on the axis, log of the slope, guess, lapse). The first two are bounded by the levels
(see `Box`); a guess or a lapse that is estimated has the prior Beta(1, 10) of psignifit (Schuett, Harmeling, Macke and
Wichmann, Vision Research 122, 2016), one that is given is fixed. The search is Fisher's scoring with Levenberg's
damping, on those parameters that are not held at a bound, from the best point of a coarse grid.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from hapticd.experiment.analysis.psychometric_shapes import Floats, Shape, density, rise

THRESHOLD, SLOPE, GUESS, LAPSE = range(4)
MOST_LAPSE: Final = 0.3
"""Of a guess and a lapse that are estimated."""
_PRIOR: Final = 9.0
"""Log of the prior: this times log(1 - rate), as Beta(1, 10) has it."""
ROUNDS: Final = 60
ROUNDS_OF_RESAMPLES: Final = 12
"""Resamples begin at the fit, near to where they end."""
NEAR: Final = 1e-11
NEAR_OF_RESAMPLES: Final = 1e-6
"""1.4 thousandths of a standard error."""
_NO_WAY: Final = 1e-7
_TINY: Final = 1e-12
_GRID: Final = (25, 11)
_LEAST_DAMPING, _MOST_DAMPING = 1e-9, 1e9


@dataclass(frozen=True, slots=True)
class Box:
    """Bounds (4,) of the parameters."""

    low: Floats
    high: Floats

    @classmethod
    def around(cls, places: Floats, guess: float | None, lapse: float | None) -> Box:
        """By places of levels (k,) on the axis: a threshold at most the whole range beyond either end; a slope between
        a twentieth of 1 over the range and 6 over the least distance of two levels (a logistic function that goes from
        5 to 95 % between them)."""
        ordered = np.unique(places)
        span, least = float(ordered[-1] - ordered[0]), float(np.diff(ordered).min())
        low = [ordered[0] - span, np.log(0.05 / span), *(0.0 if rate is None else rate for rate in (guess, lapse))]
        high = [
            ordered[-1] + span,
            np.log(6.0 / least),
            *(MOST_LAPSE if rate is None else rate for rate in (guess, lapse)),
        ]
        return cls(np.array(low), np.array(high))


def modelled(shape: Shape, places: Floats, parameters: Floats, sign: float) -> Floats:
    """(b, k) probabilities of positive answers, for parameters (b, 4); sign -1 makes functions that fall."""
    z = sign * (places - parameters[:, THRESHOLD, None]) * np.exp(parameters[:, SLOPE, None])
    guess, lapse = parameters[:, GUESS, None], parameters[:, LAPSE, None]
    return np.asarray(guess + (1.0 - guess - lapse) * rise(shape, z))


def log_likelihood(positive: Floats, trials: Floats, probability: Floats) -> Floats:
    """(b,) of answers (b, k), without the binomial coefficients."""
    bounded = np.clip(probability, _TINY, 1.0 - _TINY)
    return np.asarray((positive * np.log(bounded) + (trials - positive) * np.log1p(-bounded)).sum(axis=1))


def most_probable(
    shape: Shape,
    places: Floats,
    positive: Floats,
    trials: Floats,
    box: Box,
    sign: float = 1.0,
    starts: Floats | None = None,
    near: float = NEAR,
    rounds: int = ROUNDS,
) -> Floats:
    """(b, 4) parameters for answers (b, k) at places (k,) on the axis; `trials` (b, k).

    `starts` (b, 4) are where the search begins, by default the best points of a grid. It ends where a step gains less
    than `near` of the logarithm of the probability.
    """
    found = _starts(shape, places, positive, trials, box, sign) if starts is None else starts.copy()
    damping = np.full(len(found), 1e-3)
    best = _objective(shape, places, positive, trials, found, box, sign)
    left = np.arange(len(found))
    for _ in range(rounds):
        own, right, of = found[left], positive[left], trials[left]
        step = _step(shape, places, right, of, own, box, sign, damping[left])
        moved = np.clip(own + step, box.low, box.high)
        value = _objective(shape, places, right, of, moved, box, sign)
        better = value >= best[left]
        gain, way = value - best[left], np.abs(moved - own).max(axis=1)
        found[left[better]], best[left[better]] = moved[better], value[better]
        damping[left] = np.clip(
            np.where(better, damping[left] * 0.2, damping[left] * 10), _LEAST_DAMPING, _MOST_DAMPING
        )
        ended = (better & (gain < near)) | (~better & (way < _NO_WAY))
        left = left[~ended]
        if not len(left):
            break
    return found


def _starts(shape: Shape, places: Floats, positive: Floats, trials: Floats, box: Box, sign: float) -> Floats:
    inner = 0.25 * (box.high[THRESHOLD] - box.low[THRESHOLD])
    thresholds = np.linspace(box.low[THRESHOLD] + inner, box.high[THRESHOLD] - inner, _GRID[0])
    slopes = np.linspace(box.low[SLOPE], box.high[SLOPE], _GRID[1] + 2)[1:-1]
    rates = np.where(box.high[GUESS:] > box.low[GUESS:], 0.02, box.low[GUESS:])
    grid = np.array([(threshold, slope, *rates) for threshold in thresholds for slope in slopes])
    bounded = np.clip(modelled(shape, places, grid, sign), _TINY, 1.0 - _TINY)
    scores = positive @ np.log(bounded).T + (trials - positive) @ np.log1p(-bounded).T
    return np.asarray(grid[np.argmax(scores, axis=1)])


def _objective(
    shape: Shape, places: Floats, positive: Floats, trials: Floats, parameters: Floats, box: Box, sign: float
) -> Floats:
    free = box.high[GUESS:] > box.low[GUESS:]
    prior = (_PRIOR * np.log1p(-parameters[:, GUESS:]) * free).sum(axis=1)
    return np.asarray(log_likelihood(positive, trials, modelled(shape, places, parameters, sign)) + prior)


def _step(
    shape: Shape,
    places: Floats,
    positive: Floats,
    trials: Floats,
    parameters: Floats,
    box: Box,
    sign: float,
    damping: Floats,
) -> Floats:
    """(b, 4) of damped scoring; 0 for parameters that stay at a bound."""
    slope = np.exp(parameters[:, SLOPE, None])
    guess, lapse = parameters[:, GUESS, None], parameters[:, LAPSE, None]
    z = sign * (places - parameters[:, THRESHOLD, None]) * slope
    share = rise(shape, z)
    probability = np.clip(guess + (1.0 - guess - lapse) * share, _TINY, 1.0 - _TINY)
    steep = (1.0 - guess - lapse) * density(shape, z)
    free = [int(place) for place in np.flatnonzero(box.high > box.low)]
    columns = {THRESHOLD: -sign * steep * slope, SLOPE: steep * z, GUESS: 1.0 - share, LAPSE: -share}
    by = np.stack([columns[each] for each in free], axis=1)  # (b, p, k)
    variance = probability * (1.0 - probability)
    gradient = (by @ ((positive - trials * probability) / variance)[:, :, None])[:, :, 0]
    information = (by * (trials / variance)[:, None]) @ by.transpose(0, 2, 1)
    own = parameters[:, free]
    for place, rate in enumerate(free):
        if rate in (GUESS, LAPSE):
            gradient[:, place] -= _PRIOR / (1.0 - own[:, place])
            information[:, place, place] += _PRIOR / (1.0 - own[:, place]) ** 2
    held = ((own <= box.low[free]) & (gradient < 0)) | ((own >= box.high[free]) & (gradient > 0))
    gradient[held] = 0.0
    information[held[:, :, None] | held[:, None, :]] = 0.0
    diagonal = np.arange(len(free))
    damped = information[:, diagonal, diagonal] * (1.0 + damping[:, None]) + _TINY
    information[:, diagonal, diagonal] = np.where(held, 1.0, damped)
    step = np.zeros_like(parameters)
    step[:, free] = np.linalg.solve(information, gradient[:, :, None])[:, :, 0]
    return step
