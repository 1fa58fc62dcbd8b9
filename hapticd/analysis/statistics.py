"""Least squares with intervals: lines through points that are known each within its own error, and scatter besides;
and robust regression.

A point's variance is its own plus a scatter that all share, as it is or in known ratios. The scatter is the one at
which the weighted squares are as large as they should be (Paule and Mandel, "Consensus values and weighting factors",
1982), 0 if they are smaller anyway. Intervals are Student's t with the weighted squares as the scale (Hartung and
Knapp, 2001): where the points' own errors are all alike this is ordinary least squares.

Robust is Tukey's bisquare M-estimate, with intervals that need no right scales.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from hapticd.base.errors import HapticdError
from hapticd.base.yaml_source import Json

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
LEVEL: Final = 0.95
TUKEY_TUNING: Final = 4.685
"""Standard deviations from which on a point has no weight: 95 % as good as least squares for normal errors."""
MOST_ROUNDS: Final = 60


class FitError(HapticdError):
    """What the recordings do not support; one line, with the reason."""


class UnitError(FitError):
    """Recordings are in another unit or of another sign than they are taken to be: then all of a set are."""


def require_scipy(what: str = "fitting recordings") -> None:
    """Raises HapticdError (one line) where scipy is missing. `what` needs it."""
    try:
        import scipy  # noqa: F401
    except ImportError:
        raise HapticdError(f"{what} needs scipy: pip install 'hapticd[fit]'") from None


@dataclass(frozen=True, slots=True)
class Estimate:
    """A figure and the ends of its 95 % interval."""

    value: float
    low: float
    high: float

    @classmethod
    def from_error(cls, value: float, error: float, freedom: float) -> Estimate:
        """A number with 95 % bounds from its standard error, of so many degrees of freedom."""
        reach = student_t(freedom) * error
        return cls(float(value), float(value - reach), float(value + reach))

    def mapped(self, function: Callable[[float], float]) -> Estimate:
        """Through a function that only rises or only falls between the ends."""
        low, high = sorted((function(self.low), function(self.high)))
        return Estimate(function(self.value), low, high)

    @property
    def excludes_zero(self) -> bool:
        """Whether 0 lies outside of the interval."""
        return self.low > 0 or self.high < 0

    def to_dict(self) -> dict[str, Json]:
        return {"value": self.value, "low": self.low, "high": self.high}


@dataclass(frozen=True, slots=True)
class Regression:
    """y = sum of coefficients times columns."""

    coefficients: tuple[Estimate, ...]
    r_squared: float
    """1 - (sum of squares left over)/(sum of squares about the mean), both weighted; below 0 where a constant is
    nearer to the points than the model."""
    correlation: float
    """Of what was measured and what the model says, unweighted; nan where either does not vary."""
    residual: Floats
    """(n,) measured less modelled."""
    freedom: int
    scatter: float
    """Standard deviation of what the points' own errors do not explain, in the mean."""
    squares: float
    """Weighted sum of the squares of the residual."""


def student_t(freedom: float, level: float = LEVEL) -> float:
    """So many standard errors to each side hold this part, 95 % by default."""
    from scipy.special import stdtrit

    return float(stdtrit(freedom, 0.5 + level / 2))


def least_squares(
    columns: Floats, y: Floats, variances: Floats | None = None, scattered: Floats | None = None
) -> Regression:
    """Fits y (n,) by columns (n, k); `variances` (n,) are the points' own, all alike and unknown without them. What
    they scatter besides is alike, or has variances in the ratios of `scattered` (n,).

    Raises FitError where there are not more points than columns, or where the columns cannot be separated.
    """
    count, unknowns = columns.shape
    if count <= unknowns:
        raise FitError(f"{count} points cannot tell {unknowns} figures with their intervals: needs {unknowns + 1}")
    own = np.ones(count) if variances is None else variances
    ratios = np.ones(count) if scattered is None else scattered / np.mean(scattered)
    scatter = 0.0 if variances is None else _scatter(columns, y, own, ratios)
    weights = 1.0 / (own + scatter * ratios)
    root = np.sqrt(weights)
    weighted = columns * root[:, None]
    norms = np.sqrt(np.sum(weighted**2, axis=0))
    if not (norms > 0).all():
        raise FitError("a column is all zero: nothing can be told of its coefficient")
    q, r = np.linalg.qr(weighted / norms)
    if np.abs(np.diag(r)).min() < 1e-9:
        raise FitError("two columns say the same: their coefficients cannot be told apart")
    inverse = np.linalg.inv(r)
    values = inverse @ (q.T @ (root * y)) / norms
    residual = y - columns @ values
    squares = float(np.sum(weights * residual**2))
    freedom = count - unknowns
    errors = np.sqrt(np.sum(inverse**2, axis=1) * squares / freedom) / norms
    mean = float(np.sum(weights * y) / np.sum(weights))
    about = float(np.sum(weights * (y - mean) ** 2))
    return Regression(
        coefficients=tuple(
            Estimate.from_error(value, error, freedom) for value, error in zip(values, errors, strict=True)
        ),
        r_squared=1.0 - squares / about if about > 0 else math.nan,
        correlation=_correlation(y, columns @ values),
        residual=residual,
        freedom=freedom,
        scatter=math.sqrt(scatter),
        squares=squares,
    )


def through_origin(
    x: Floats, y: Floats, variances: Floats | None = None, scattered: Floats | None = None
) -> Regression:
    """y = a x; coefficients (a,)."""
    return least_squares(x[:, None], y, variances, scattered)


def with_offset(x: Floats, y: Floats, variances: Floats | None = None, scattered: Floats | None = None) -> Regression:
    """y = a x + b; coefficients (a, b)."""
    return least_squares(np.column_stack((x, np.ones_like(x))), y, variances, scattered)


def common(values: Floats, variances: Floats | None = None) -> Estimate:
    """What values (n,) with these variances have in common: their weighted mean. Raises FitError for fewer than two."""
    return least_squares(np.ones((len(values), 1)), values, variances).coefficients[0]


def improbable(squares: float, freedom: int, fuller: float, fuller_freedom: int) -> float:
    """The chance of the F test that a model with more columns explains so much more by luck."""
    from scipy.special import fdtrc

    if fuller <= 0:
        return 0.0 if squares > 0 else 1.0
    extra = freedom - fuller_freedom
    return float(fdtrc(extra, fuller_freedom, max(0.0, (squares - fuller) / extra) / (fuller / fuller_freedom)))


def aicc(squares: float, count: int, unknowns: int) -> float:
    """Akaike's criterion, corrected for few points, of a model with so many `unknowns`, which leaves these weighted
    squares of `count` points; infinite for too few points. The scale of the scatter is one unknown more."""
    known = unknowns + 1
    freedom = count - known - 1
    if freedom < 1:
        return math.inf
    return count * math.log(squares / count) + 2 * known + 2 * known * (known + 1) / freedom


def jackknife_error(without: Floats) -> Floats:
    """Standard errors (...) of figures from what they are without each of n points, or groups of them, (n, ...)."""
    count = len(without)
    return np.asarray(np.sqrt((count - 1) / count * np.sum((without - without.mean(axis=0)) ** 2, axis=0)))


def well_conditioned(columns: Floats, worst: float = 100.0) -> bool:
    """Whether columns differ by enough for their coefficients: by the condition number of the columns, scaled."""
    norms = np.linalg.norm(columns, axis=0)
    return bool((norms > 0).all()) and float(np.linalg.cond(columns / norms)) < worst


def _correlation(one: Floats, other: Floats) -> float:
    one, other = one - one.mean(), other - other.mean()
    norm = math.sqrt(float(np.sum(one**2)) * float(np.sum(other**2)))
    return float(np.sum(one * other)) / norm if norm > 0 else math.nan


def _scatter(columns: Floats, y: Floats, own: Floats, ratios: Floats) -> float:
    """The variance besides the points' own, in the mean."""
    freedom = len(y) - columns.shape[1]

    def squares(scatter: float) -> float:
        root = 1.0 / np.sqrt(own + scatter * ratios)
        values = np.linalg.lstsq(columns * root[:, None], y * root, rcond=None)[0]
        return float(np.sum(((y - columns @ values) * root) ** 2))

    if squares(0.0) <= freedom:
        return 0.0
    from scipy.optimize import brentq

    high = float(np.max(own))
    while squares(high) > freedom:
        high *= 4
    return float(brentq(lambda scatter: squares(scatter) - freedom, 0.0, high, xtol=1e-300, rtol=1e-14))


# ---- Robust regression ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Robust:
    """y = sum of coefficients times columns, whatever a few points say."""

    coefficients: tuple[Estimate, ...]
    correlation: float
    """Of what was measured and what the model says, without the outliers."""
    outliers: tuple[int, ...]
    """Points without weight."""


def robust(columns: Floats, y: Floats, shifts: Floats | None = None, grows: bool = True) -> Robust:
    """Tukey's bisquare M-estimate of y (n,) by columns (n, k), begun from Huber's.

    The scale of an error is one for all, or, if it `grows`, a + b |y as modelled|, with a and b from the absolute
    residuals. Intervals are Huber's (1981) sandwich, with residuals enlarged for their leverage (MacKinnon and White,
    1985), so that scales need not be right. `shifts` (m, n): errors of one standard deviation each that all points
    have together. FitError where there are not more points than columns.
    """
    count, unknowns = columns.shape
    if count <= unknowns:
        raise FitError(f"{count} points cannot tell {unknowns} figures with their intervals: needs {unknowns + 1}")
    scale = np.full(count, _spread(y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0], count, unknowns))
    weight = np.ones(count)
    values = np.zeros(unknowns)
    for bisquare in (False, True):
        for _ in range(MOST_ROUNDS):
            root = np.sqrt(weight) / scale
            before = values
            values = np.linalg.lstsq(columns * root[:, None], y * root, rcond=None)[0]
            modelled = columns @ values
            off = y - modelled
            if not np.abs(off).max() > 1e-12 * np.abs(y).max():
                break
            scale = _scales(off, np.abs(modelled) if grows else np.ones(count), unknowns)
            size = np.abs(off) / scale
            weight = np.maximum(1 - (size / TUKEY_TUNING) ** 2, 0) ** 2 if bisquare else 1 / np.maximum(1, size / 1.345)
            if np.abs(values - before).max() < 1e-10 * np.abs(values).max():
                break
    size = off / scale
    inside = np.abs(size) < TUKEY_TUNING
    weight = np.where(inside, (1 - (size / TUKEY_TUNING) ** 2) ** 2, 0.0)
    bend = np.where(inside, (1 - (size / TUKEY_TUNING) ** 2) * (1 - 5 * (size / TUKEY_TUNING) ** 2), 0.0)
    scaled = columns / scale[:, None]
    bread = np.linalg.pinv((scaled * bend[:, None]).T @ scaled)
    whitened = scaled * np.sqrt(weight)[:, None]
    leverage = np.sum((whitened @ np.linalg.pinv(whitened.T @ whitened)) * whitened, axis=1)
    pull = weight * size / (1 - np.minimum(leverage, 0.9))
    meat = (scaled * pull[:, None] ** 2).T @ scaled
    if shifts is not None:
        together = (shifts / scale * weight) @ scaled
        meat = meat + together.T @ together
    errors = np.sqrt(np.maximum(np.diag(bread @ meat @ bread), 0.0))
    kept = np.flatnonzero(inside)
    modelled = columns @ values
    freedom = max(1, len(kept) - unknowns)
    return Robust(
        tuple(Estimate.from_error(value, error, freedom) for value, error in zip(values, errors, strict=True)),
        _correlation(modelled[kept], y[kept]),
        tuple(int(k) for k in np.flatnonzero(~inside)),
    )


def _spread(off: Floats, count: int, unknowns: int) -> float:
    """Standard deviation, from the median of the absolute values; they are fewer than they seem by the unknowns."""
    usual = 1.4826 * float(np.median(np.abs(off))) * math.sqrt(count / (count - unknowns))
    return usual or float(np.sqrt(np.mean(off**2))) or 1.0


def _scales(off: Floats, modelled: Floats, unknowns: int) -> Floats:
    """a + b |modelled| of every point; both at least 0, and no scale far below the usual one."""
    count = len(off)
    usual = _spread(off, count, unknowns)
    far = np.minimum(np.abs(off), 3 * usual)
    columns = np.column_stack((np.ones(count), modelled))
    a, b = np.linalg.lstsq(columns, far, rcond=None)[0] if np.ptp(modelled) > 0 else (1.0, 0.0)
    if a < 0:
        a, b = 0.0, 1.0
    elif b < 0:
        a, b = 1.0, 0.0
    shape = np.maximum(a + b * modelled, 0.0)
    shape = np.maximum(shape, 0.2 * float(np.median(shape))) if np.median(shape) > 0 else np.ones(count)
    scaled: Floats = shape * _spread(off / shape, count, unknowns)
    return scaled
