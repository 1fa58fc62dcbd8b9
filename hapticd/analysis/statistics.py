"""Least squares for points with unequal errors and additional scatter, and robust regression, both with intervals.

The variance of a point is its known measurement variance plus that of an additional scatter, which is equal for all
points or in known ratios. The scatter is chosen so that the weighted sum of squared residuals equals its degrees of
freedom (Paule and Mandel, "Consensus values and weighting factors", 1982), and is 0 if the sum is smaller without it.
Intervals are Student's t scaled by that sum (Hartung and Knapp, 2001). With equal measurement variances this is
ordinary least squares.

The robust regression is Tukey's bisquare M-estimate; its intervals hold even if the scales of the errors are wrong.
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
from hapticd.system.extras import install_command

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
CONFIDENCE_LEVEL: Final = 0.95
"""Confidence level of the intervals of fits and calibrations."""
TUKEY_TUNING: Final = 4.685
"""Residual, in standard deviations, beyond which a point has no weight; the efficiency for normal errors is 95 %."""
MAX_REWEIGHTING_ROUNDS: Final = 60
"""Limit of the rounds of iteratively reweighted least squares."""


class FitError(HapticdError):
    """The data do not support a fit; the message is one line with the reason."""


class UnitError(FitError):
    """The unit or the sign of a recording seems wrong, probably in all recordings of the same set."""


def require_scipy(what: str = "fitting recordings", extra: str = "fit") -> None:
    """Raise HapticdError if scipy is missing; `what` names the feature that needs it, `extra` the extra with it."""
    try:
        import scipy  # noqa: F401
    except ImportError:
        raise HapticdError(f"{what} needs scipy: {install_command(extra)}") from None


@dataclass(frozen=True, slots=True)
class Estimate:
    """A value and the bounds of its 95 % confidence interval."""

    value: float
    low: float
    high: float

    @classmethod
    def from_error(cls, value: float, error: float, freedom: float) -> Estimate:
        """Return an estimate with a 95 % interval from its standard error and degrees of freedom."""
        reach = student_t(freedom) * error
        return cls(float(value), float(value - reach), float(value + reach))

    def mapped(self, function: Callable[[float], float]) -> Estimate:
        """Return the estimate of `function` of the value; the function must be monotonic within the interval."""
        low, high = sorted((function(self.low), function(self.high)))
        return Estimate(function(self.value), low, high)

    @property
    def excludes_zero(self) -> bool:
        """Whether 0 lies outside of the interval."""
        return self.low > 0 or self.high < 0

    def to_dict(self) -> dict[str, Json]:
        """Return the estimate as a mapping for JSON."""
        return {"value": self.value, "low": self.low, "high": self.high}


@dataclass(frozen=True, slots=True)
class Regression:
    """A linear model, y = sum of coefficients times columns, fitted by least squares."""

    coefficients: tuple[Estimate, ...]
    r_squared: float
    """1 - (residual sum of squares)/(sum of squares about the mean), both weighted; below 0 if a constant fits better
    than the model."""
    correlation: float
    """Unweighted correlation of measured and modelled values; NaN if either is constant."""
    residual: Floats
    """Measured minus modelled values (n,)."""
    freedom: int
    scatter: float
    """Standard deviation of the scatter that the measurement variances do not explain, RMS over the points."""
    squares: float
    """Weighted sum of the squared residuals."""


def student_t(freedom: float, level: float = CONFIDENCE_LEVEL) -> float:
    """Return the half width, in standard errors, of a Student's t interval with `freedom` degrees of freedom."""
    from scipy.special import stdtrit

    return float(stdtrit(freedom, 0.5 + level / 2))


def least_squares(
    columns: Floats, y: Floats, variances: Floats | None = None, scattered: Floats | None = None
) -> Regression:
    """Fit y (n,) by columns (n, k).

    `variances` (n,) are the measurement variances of the points; without them they are equal and unknown. The variances
    of the additional scatter are equal, or in the ratios of `scattered` (n,). Raises FitError if there are not more
    points than columns, or if the columns are linearly dependent.
    """
    count, unknowns = columns.shape
    if count <= unknowns:
        raise FitError(f"{count} points cannot determine {unknowns} coefficients with intervals: needs {unknowns + 1}")
    own = np.ones(count) if variances is None else variances
    ratios = np.ones(count) if scattered is None else scattered / np.mean(scattered)
    scatter = 0.0 if variances is None else _scatter(columns, y, own, ratios)
    weights = 1.0 / (own + scatter * ratios)
    root = np.sqrt(weights)
    weighted = columns * root[:, None]
    norms = np.sqrt(np.sum(weighted**2, axis=0))
    if not (norms > 0).all():
        raise FitError("a column is all zero: its coefficient cannot be determined")
    q, r = np.linalg.qr(weighted / norms)
    if np.abs(np.diag(r)).min() < 1e-9:
        raise FitError("two columns are linearly dependent: their coefficients cannot be separated")
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
    """Fit y = a x; the coefficients are (a,)."""
    return least_squares(x[:, None], y, variances, scattered)


def with_offset(x: Floats, y: Floats, variances: Floats | None = None, scattered: Floats | None = None) -> Regression:
    """Fit y = a x + b; the coefficients are (a, b)."""
    return least_squares(np.column_stack((x, np.ones_like(x))), y, variances, scattered)


def common(values: Floats, variances: Floats | None = None) -> Estimate:
    """Return the weighted mean of values (n,) with these variances. Raises FitError for fewer than two values."""
    return least_squares(np.ones((len(values), 1)), values, variances).coefficients[0]


def f_test_p(squares: float, freedom: int, fuller: float, fuller_freedom: int) -> float:
    """Return the p value of the F test of a model against a fuller one, which has more columns.

    `squares` and `fuller` are the weighted sums of squares of both models, `freedom` and `fuller_freedom` their degrees
    of freedom.
    """
    from scipy.special import fdtrc

    if fuller <= 0:
        return 0.0 if squares > 0 else 1.0
    extra = freedom - fuller_freedom
    return float(fdtrc(extra, fuller_freedom, max(0.0, (squares - fuller) / extra) / (fuller / fuller_freedom)))


def aicc(squares: float, count: int, unknowns: int) -> float:
    """Return Akaike's information criterion, corrected for few points (AICc).

    `squares` is the weighted sum of squares of `count` points, `unknowns` the number of coefficients; the scale of the
    scatter is one more unknown. The result is infinite for too few points.
    """
    known = unknowns + 1
    freedom = count - known - 1
    if freedom < 1:
        return math.inf
    return count * math.log(squares / count) + 2 * known + 2 * known * (known + 1) / freedom


def jackknife_error(without: Floats) -> Floats:
    """Return the jackknife standard errors (...) from the estimates (n, ...) without each of n points or groups."""
    count = len(without)
    return np.asarray(np.sqrt((count - 1) / count * np.sum((without - without.mean(axis=0)) ** 2, axis=0)))


def well_conditioned(columns: Floats, limit: float = 100.0) -> bool:
    """Return whether the condition number of the columns, each scaled to norm 1, is below `limit`."""
    norms = np.linalg.norm(columns, axis=0)
    return bool((norms > 0).all()) and float(np.linalg.cond(columns / norms)) < limit


def _correlation(one: Floats, other: Floats) -> float:
    one, other = one - one.mean(), other - other.mean()
    norm = math.sqrt(float(np.sum(one**2)) * float(np.sum(other**2)))
    return float(np.sum(one * other)) / norm if norm > 0 else math.nan


def rank_correlation(one: Floats, other: Floats) -> float:
    """Return Spearman's rank correlation of two quantities (n,); equal values have their mean rank. 0 if undefined."""

    def ranks(values: Floats) -> Floats:
        ordered = np.sort(values)
        return np.asarray(np.searchsorted(ordered, values) + np.searchsorted(ordered, values, side="right"), float)

    found = _correlation(ranks(one), ranks(other))
    return found if math.isfinite(found) else 0.0


def _scatter(columns: Floats, y: Floats, own: Floats, ratios: Floats) -> float:
    """Return the mean variance of the additional scatter. `own` are the points' measurement variances."""
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
    """A linear model, y = sum of coefficients times columns, fitted without the influence of outliers."""

    coefficients: tuple[Estimate, ...]
    correlation: float
    """Correlation of measured and modelled values, without the outliers."""
    outliers: tuple[int, ...]
    """Indices of the points without weight."""


def robust(columns: Floats, y: Floats, shifts: Floats | None = None, grows: bool = True) -> Robust:
    """Fit y (n,) by columns (n, k) with Tukey's bisquare M-estimate, started from Huber's.

    The scale of the errors is equal for all points, or, with `grows`, a + b |modelled y|, with a and b from the
    absolute residuals. Intervals are from Huber's (1981) sandwich estimate with residuals enlarged for their leverage
    (MacKinnon and White, 1985), so that wrong scales do not invalidate the intervals. `shifts` (m, n) are the changes
    of y by one standard deviation of each of m systematic errors. Raises FitError if there are not more points than
    columns.
    """
    count, unknowns = columns.shape
    if count <= unknowns:
        raise FitError(f"{count} points cannot determine {unknowns} coefficients with intervals: needs {unknowns + 1}")
    scale = np.full(count, _spread(y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0], count, unknowns))
    weight = np.ones(count)
    values = np.zeros(unknowns)
    for bisquare in (False, True):
        for _ in range(MAX_REWEIGHTING_ROUNDS):
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
    """Return the standard deviation of residuals from their median magnitude, corrected for the number of unknowns."""
    usual = 1.4826 * float(np.median(np.abs(off))) * math.sqrt(count / (count - unknowns))
    return usual or float(np.sqrt(np.mean(off**2))) or 1.0


def _scales(off: Floats, modelled: Floats, unknowns: int) -> Floats:
    """Return the scale a + b |modelled| of every point's error (n,).

    a and b are at least 0, and no scale is below 0.2 times the median scale.
    """
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
