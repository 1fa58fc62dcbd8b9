"""Psychometric functions: the probability of a positive answer as a function of the level of a stimulus.

    P(x) = guess + (1 - guess - lapse) F((u(x) - u(threshold)) slope)

`F` is one of PSYCHOMETRIC_SHAPES; `u` is the level itself, or its natural logarithm on a logarithmic axis. The
threshold has the unit of the level. The slope has the inverse unit of u: 1/s of a logistic function, 1/standard
deviation of a cumulative normal, the exponent (beta) of a Weibull function. F(0) is 1/2, for a Weibull function
1 - 1/e. (Wichmann and Hill, "The psychometric function: I", Perception & Psychophysics 63, 2001.)
"""

from __future__ import annotations

import math
from typing import Final, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

Floats: TypeAlias = npt.NDArray[np.float64]
Shape: TypeAlias = Literal["logistic", "weibull", "cumulative_normal"]
PSYCHOMETRIC_SHAPES: Final[tuple[Shape, ...]] = ("logistic", "weibull", "cumulative_normal")
_MAX_EXPONENT: Final = 700.0
"""Largest argument of exp; the result is still finite."""


def axis(levels: Floats, logarithmic: bool) -> Floats:
    """Return levels on the axis u: unchanged, or their natural logarithms.

    Raises ValueError for levels that are not positive on a logarithmic axis.
    """
    given = np.asarray(levels, dtype=float)
    if not logarithmic:
        return given
    if not (given > 0).all():
        raise ValueError("levels on a logarithmic axis must be positive")
    return np.asarray(np.log(given))


def level(place: Floats, logarithmic: bool) -> Floats:
    """Return the levels at positions on the axis u; the inverse of `axis`."""
    given = np.asarray(place, dtype=float)
    return np.exp(np.minimum(given, _MAX_EXPONENT)) if logarithmic else given


def is_logarithmic(shape: Shape, logarithmic: bool) -> bool:
    """Return whether the axis of a function is logarithmic; that of a Weibull function always is."""
    return logarithmic or shape == "weibull"


def rise(shape: Shape, z: Floats) -> Floats:
    """Return the psychometric function F(z), between 0 and 1, at z = (u(x) - u(threshold)) slope."""
    if shape == "logistic":
        return np.asarray(0.5 * (1.0 + np.tanh(0.5 * z)))
    if shape == "weibull":
        return np.asarray(-np.expm1(-np.exp(np.minimum(z, _MAX_EXPONENT))))
    from scipy.special import ndtr

    return np.asarray(ndtr(z))


def density(shape: Shape, z: Floats) -> Floats:
    """Return the derivative dF/dz of the psychometric function F(z)."""
    if shape == "logistic":
        return np.asarray(0.25 / np.cosh(np.clip(0.5 * z, -350, 350)) ** 2)
    if shape == "weibull":
        bounded = np.minimum(z, 50.0)
        return np.asarray(np.exp(bounded - np.exp(bounded)))
    return np.asarray(np.exp(-0.5 * z**2) / math.sqrt(2 * math.pi))


def inverse(shape: Shape, proportion: Floats | float) -> Floats:
    """Return the z where the psychometric function F(z) is `proportion`; infinite for 0 and 1, NaN outside 0 to 1."""
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
    """Return the probability of a positive answer at levels; all arguments are broadcast together.

    A negative slope is a falling function.
    """
    on_axis = is_logarithmic(shape, logarithmic)
    z = (axis(levels, on_axis) - axis(np.asarray(threshold, dtype=float), on_axis)) * slope
    return np.asarray(guess + (1.0 - np.asarray(guess) - lapse) * rise(shape, z))
