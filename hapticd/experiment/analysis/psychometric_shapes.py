"""Psychometric functions: the probability of a positive answer as a function of the level of a stimulus.

    P(x) = guess + (1 - guess - lapse) F((u(x) - u(threshold)) slope)

F is one of PSYCHOMETRIC_SHAPES. u(x) is the level itself, or on a logarithmic axis its natural logarithm. The threshold
has the unit of the level. The slope has the inverse unit of u: 1 / scale of a logistic function, 1 / standard deviation
of a cumulative normal, the exponent (beta) of a Weibull function. F(0) is 1/2, for a Weibull function 1 - 1/e.
(Wichmann and Hill, "The psychometric function: I", Perception & Psychophysics 63, 2001.)
"""

from __future__ import annotations

import math
from typing import Final, Literal, TypeAlias

import numpy as np

from hapticd.analysis.statistics import Floats

Shape: TypeAlias = Literal["logistic", "weibull", "cumulative_normal"]
PSYCHOMETRIC_SHAPES: Final[tuple[Shape, ...]] = ("logistic", "weibull", "cumulative_normal")
_MAX_EXPONENT: Final = 700.0
"""Larger arguments of exp are reduced to this one, whose result is finite."""


def axis(levels: Floats, logarithmic: bool) -> Floats:
    """Return the positions of levels on the axis: the levels, or their natural logarithms on a logarithmic axis.

    Raises ValueError for levels that are not positive on a logarithmic axis.
    """
    given = np.asarray(levels, dtype=float)
    if not logarithmic:
        return given
    if not (given > 0).all():
        raise ValueError("levels on a logarithmic axis must be positive")
    return np.asarray(np.log(given))


def level(place: Floats, logarithmic: bool) -> Floats:
    """Return the levels at positions on the axis: the inverse of `axis`."""
    given = np.asarray(place, dtype=float)
    return np.exp(np.minimum(given, _MAX_EXPONENT)) if logarithmic else given


def is_logarithmic(shape: Shape, logarithmic: bool) -> bool:
    """Return whether the axis of a psychometric function is logarithmic, as it always is for a Weibull function."""
    return logarithmic or shape == "weibull"


def rise(shape: Shape, z: Floats) -> Floats:
    """Return the psychometric function F(z) without guess and lapse, from 0 to 1; z is 0 at the threshold."""
    if shape == "logistic":
        return np.asarray(0.5 * (1.0 + np.tanh(0.5 * z)))
    if shape == "weibull":
        return np.asarray(-np.expm1(-np.exp(np.minimum(z, _MAX_EXPONENT))))
    from scipy.special import ndtr

    return np.asarray(ndtr(z))


def density(shape: Shape, z: Floats) -> Floats:
    """Return the derivative dF/dz of the psychometric function F(z) without guess and lapse."""
    if shape == "logistic":
        return np.asarray(0.25 / np.cosh(np.clip(0.5 * z, -350, 350)) ** 2)
    if shape == "weibull":
        bounded = np.minimum(z, 50.0)
        return np.asarray(np.exp(bounded - np.exp(bounded)))
    return np.asarray(np.exp(-0.5 * z**2) / math.sqrt(2 * math.pi))


def inverse(shape: Shape, proportion: Floats | float) -> Floats:
    """Return the z at which the psychometric function F(z) is `proportion`; infinite at 0 and 1, NaN outside 0 to 1."""
    p = np.asarray(proportion, dtype=float)
    with np.errstate(divide="ignore", invalid="ignore"):
        if shape == "logistic":
            return np.asarray(np.log(p) - np.log1p(-p))
        if shape == "weibull":
            return np.asarray(np.log(-np.log1p(-p)))
    from scipy.special import ndtri

    return np.asarray(ndtri(p))


def probability(
    shape: Shape,
    levels: Floats,
    threshold: Floats | float,
    slope: Floats | float,
    guess: Floats | float = 0.0,
    lapse: Floats | float = 0.0,
    logarithmic: bool = False,
) -> Floats:
    """Return the probability of a positive answer at levels. The arrays of all arguments are broadcast together.

    The function falls with the level if the slope is negative.
    """
    on_axis = is_logarithmic(shape, logarithmic)
    z = (axis(levels, on_axis) - axis(np.asarray(threshold, dtype=float), on_axis)) * slope
    return np.asarray(guess + (1.0 - np.asarray(guess) - lapse) * rise(shape, z))
