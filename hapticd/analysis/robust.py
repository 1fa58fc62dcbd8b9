"""Robust regression: Tukey's bisquare M-estimate, with intervals that need no right scales."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from hapticd.analysis.statistics import Estimate, FitError, Floats

TUKEY: Final = 4.685
"""Standard deviations from which on a point has no weight: 95 % as good as least squares for normal errors."""
ROUNDS: Final = 60


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
        for _ in range(ROUNDS):
            root = np.sqrt(weight) / scale
            before = values
            values = np.linalg.lstsq(columns * root[:, None], y * root, rcond=None)[0]
            modelled = columns @ values
            off = y - modelled
            if not np.abs(off).max() > 1e-12 * np.abs(y).max():
                break
            scale = _scales(off, np.abs(modelled) if grows else np.ones(count), unknowns)
            size = np.abs(off) / scale
            weight = np.maximum(1 - (size / TUKEY) ** 2, 0) ** 2 if bisquare else 1 / np.maximum(1, size / 1.345)
            if np.abs(values - before).max() < 1e-10 * np.abs(values).max():
                break
    size = off / scale
    inside = np.abs(size) < TUKEY
    weight = np.where(inside, (1 - (size / TUKEY) ** 2) ** 2, 0.0)
    bend = np.where(inside, (1 - (size / TUKEY) ** 2) * (1 - 5 * (size / TUKEY) ** 2), 0.0)
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
    correlation = float(np.corrcoef(modelled[kept], y[kept])[0, 1]) if np.ptp(modelled[kept]) > 0 else math.nan
    freedom = max(1, len(kept) - unknowns)
    return Robust(
        tuple(
            Estimate.from_error(float(value), float(error), freedom)
            for value, error in zip(values, errors, strict=True)
        ),
        correlation,
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
