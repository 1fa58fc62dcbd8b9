"""Textures that were identified at one rate, as models for the servo's rate."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np

from hapticd.base.lattice import Reflection, with_poles
from hapticd.config.texture import MAX_ORDER
from hapticd.rendering.filter_design import (
    COARSE_RULE,
    Array,
    ComplexArray,
    panel_nodes,
    pole_mesh,
    poles_of,
    power_at,
)

MAX_RESAMPLING_ERROR_DB: Final = 0.5
"""A resampled model is accepted if its spectrum has at most this error within COMPARED_RANGE_DB of the peak."""
COMPARED_RANGE_DB: Final = 30.0
"""Range below its peak in which the spectrum of a model is compared."""
_WHITE_NOISE_FRACTION: Final = 1e-7
"""White noise added to the autocorrelation against rounding errors, as a fraction of the power."""
_MIN_SKIRT_EXPONENT: Final = 12.0
"""Smallest n with which power falls as 1/f^n beyond the band of a model that is shown at a higher rate."""
_MAX_SKIRT_POWER_FRACTION: Final = 0.05
"""Largest fraction of the power that may lie beyond the band of a model that is shown at a higher rate."""
_MAX_PLACED_POLES: Final = 4
"""Largest number of the model's poles (or pairs) that are converted to the new rate directly, not fitted."""
_MAX_REFINEMENTS: Final = 6
"""Largest number of fits with the same placed (directly converted) poles."""
_STALLED_ERROR_RATIO: Final = 0.95
"""Refinement ends when a fit's error is more than this fraction of the previous one."""


class Resampled(NamedTuple):
    """An all-pole model of a texture that was converted to another rate."""

    reflection: Reflection
    kept: float
    """Fraction of the model's power in the band that both rates carry."""
    error_db: float
    """Largest error of the spectrum in that band, down to COMPARED_RANGE_DB below the peak."""


@lru_cache(maxsize=1024)
def resampled(model: Reflection, from_rate_hz: float, to_rate_hz: float) -> Resampled:
    """Return an all-pole model that was identified at one rate as an all-pole model for another.

    The spectrum in the common band gives the autocorrelation at the lags of the new rate, and from it the
    Levinson-Durbin recursion gives the reflection coefficients. The result has the smallest order up to MAX_ORDER
    whose spectrum (both of unit power) is within MAX_RESAMPLING_ERROR_DB of the model's in the band, down to
    COMPARED_RANGE_DB below its peak. If no order reaches that, the one with the smallest error is used.

    At a higher rate the model is undefined beyond its band. There the target falls steeply from the band's edge. If
    that fit is not accepted, it is refined in two ways. The power beyond the band, which is arbitrary, follows the last
    fit, but stays below the power at the edge. And the model's sharpest poles p are placed directly, at p^(from/to),
    while the recursion fits the rest: 32 lags of the new rate may be too short to resolve these poles.
    """
    if from_rate_hz == to_rate_hz:
        return Resampled(model, 1.0, 0.0)
    ratio = from_rate_hz / to_rate_hz
    # `own` are angles of the model's rate up to the common band's edge, `angle` the same at the new rate.
    poles = poles_of(model)
    band = min(math.pi, math.pi / ratio)
    own, own_weight = pole_mesh(poles, band, MAX_ORDER, COARSE_RULE)
    angle, weight = own * ratio, own_weight * ratio
    power = power_at(model, None, own)
    # At a higher rate all power is kept; with poles almost on the circle the integral is inexact.
    kept = min(float(own_weight @ power) / math.pi, 1.0) if ratio > 1 else 1.0
    power *= math.pi / (weight @ power)
    if ratio > 1:
        fits = iter([_fit(power, power, _Nodes.at(angle, weight), [])])
    else:
        fits = _fits_beyond(power, angle, weight, poles, ratio)
    best = None
    for fit in fits:
        if best is None or fit.error_db < best.error_db:
            best = fit
        if best.error_db <= MAX_RESAMPLING_ERROR_DB:
            break
    assert best is not None
    shown, error_db = best.realised(), best.error_db
    if error_db > MAX_RESAMPLING_ERROR_DB:  # reported, so the error between the nodes counts, too
        error_db = max(
            error_db, _error_between(model, shown, poles, band, ratio, power, best.power[: len(power)], angle)
        )
    return Resampled(shown, kept, error_db)


def _error_between(
    model: Reflection,
    shown: Reflection,
    poles: ComplexArray,
    band: float,
    ratio: float,
    wanted: Array,
    fitted: Array,
    angle: Array,
) -> float:
    """Return the largest error of the fitted spectrum in dB at twice the number of nodes.

    `wanted` and `fitted` are the powers of model and fit at the nodes `angle`.
    """
    peak = int(np.argmax(wanted))
    own, _ = pole_mesh(poles, band, MAX_ORDER)
    power, there = power_at(model, None, own), power_at(shown, None, own * ratio)
    power *= wanted[peak] / float(power_at(model, None, angle[peak : peak + 1] / ratio)[0])
    there *= fitted[peak] / float(power_at(shown, None, angle[peak : peak + 1])[0])
    heard = power >= power.max() * 10 ** (-COMPARED_RANGE_DB / 10)
    return float(np.abs(10 * np.log10(there[heard] / power[heard])).max())


@dataclass(frozen=True, slots=True)
class _Fit:
    """An all-pole filter, the product of placed poles and a fitted rest, with its largest error and power at nodes."""

    error_db: float
    placed: list[complex]
    reflection: Reflection
    power: Array

    def realised(self) -> Reflection:
        """Return the reflection coefficients of the fit, placed poles included."""
        return with_poles(self.reflection, self.placed) if self.placed else self.reflection


@dataclass(frozen=True, slots=True)
class _Nodes:
    """Nodes of a fit, with values that all fits at these nodes share."""

    weight: Array
    delay: ComplexArray
    """z^-1 at each node."""
    half: ComplexArray
    """z^(1/2) at each node."""
    cosines: Array
    """Matrix [lags][nodes] that maps the weighted power to the autocorrelation."""

    @classmethod
    def at(cls, angle: Array, weight: Array) -> "_Nodes":
        """Compute the values that fits share, for nodes at these angles with these quadrature weights."""
        delay = np.exp(-1j * angle)
        cosines = np.empty((MAX_ORDER + 1, len(angle)))
        turned = np.ones_like(delay)
        cosines[0] = 1.0
        for lag in range(1, MAX_ORDER + 1):
            turned *= delay
            cosines[lag] = turned.real
        return cls(weight, delay, np.exp(0.5j * angle), cosines)


def _fit(power: Array, target: Array, nodes: _Nodes, placed: list[complex]) -> _Fit:
    """Return an all-pole fit to the power `target` at the nodes: of the smallest order whose error is small enough.

    If there is none, return that with the smallest error. The error is judged against `power`, the model's power at
    the first nodes, those within the band.
    """
    direct = np.ones_like(target)
    for pole in placed:
        direct /= np.abs((1 - pole * nodes.delay) * (1 if pole.imag == 0 else 1 - pole.conjugate() * nodes.delay)) ** 2
    room = MAX_ORDER - sum(1 if pole.imag == 0 else 2 for pole in placed)
    correlation = nodes.cosines[: room + 1] @ (nodes.weight * (target / direct))
    reflection = _predicted(correlation)
    heard = np.flatnonzero(power >= power.max() * 10 ** (-COMPARED_RANGE_DB / 10))
    wanted = power[heard] / direct[heard]
    weight = nodes.weight * direct
    best: tuple[float, int, Array] | None = None
    for n, inverse in enumerate(_prefix_inverses(reflection, nodes.half)):
        shape = 1 / inverse
        level = math.pi / float(weight @ shape)
        off = inverse[heard]
        off *= wanted
        error = 10 * math.log10(max(level / float(off.min()), float(off.max()) / level))
        if best is None or error < best[0]:
            shape *= level
            best = error, n, shape
        if error <= MAX_RESAMPLING_ERROR_DB:
            break
    assert best is not None
    error, n, fitted = best
    return _Fit(error, placed, reflection[:n], direct * fitted)


def _fits_beyond(power: Array, angle: Array, weight: Array, poles: ComplexArray, ratio: float) -> Iterator[_Fit]:
    """Yield fits at a rate higher than the model's, first the one without placed (directly converted) poles."""
    edge = math.pi * ratio
    # Panels that grow with the distance from the edge, where the skirt is steep.
    count = math.ceil(20 * math.log(1 / ratio)) + 1
    beyond, beyond_weight = panel_nodes(np.geomspace(edge, math.pi, count + 1), COARSE_RULE)
    inside = len(angle)
    nodes = _Nodes.at(np.concatenate((angle, beyond)), np.concatenate((weight, beyond_weight)))
    fall = max(_MIN_SKIRT_EXPONENT, 1 + power[-1] * edge / (_MAX_SKIRT_POWER_FRACTION * math.pi))
    skirt = power[-1] * (edge / beyond) ** fall
    # A pole on the negative real axis has no counterpart at another rate; one that rings for a million ticks has no
    # reflection coefficients that are safely below 1.
    upper = [complex(p) ** ratio for p in poles if p.imag > 0 or (p.imag == 0 and p.real > 0)]
    sharpest = sorted((p for p in upper if abs(p) < 1 - 1e-6), key=lambda p: (-abs(p), p.imag))
    for count in range(min(_MAX_PLACED_POLES, len(sharpest)) + 1):
        placed = sharpest[:count]
        target = np.concatenate((power, skirt))
        before = math.inf
        for _ in range(_MAX_REFINEMENTS):
            fit = _fit(power, target, nodes, placed)
            yield fit
            if fit.error_db > _STALLED_ERROR_RATIO * before:
                break
            before = fit.error_db
            target[inside:] = np.minimum(fit.power[inside:], power[-1])


def _predicted(r: Array) -> Reflection:
    """Return the reflection coefficients of the best predictor of noise with this autocorrelation (Levinson-Durbin)."""
    r[0] *= 1 + _WHITE_NOISE_FRACTION
    error = float(r[0])
    polynomial = np.zeros(len(r))
    polynomial[0] = 1.0
    reflection: list[float] = []
    for m in range(1, len(r)):
        k = -float(polynomial[:m] @ r[m:0:-1]) / error
        reflection.append(k)
        polynomial[: m + 1] += k * polynomial[m::-1]
        error *= (1 - k) * (1 + k)
    return tuple(reflection)


def _prefix_inverses(reflection: Sequence[float], half: ComplexArray) -> Iterator[Array]:
    """Yield 1/power of the all-pole filters with reflection k_1 .. k_n for n = 0, 1, .. p, up to a factor.

    On the unit circle, B_m is z^-m times the conjugate of A_m (filter_design explains both). With G_m = z^(m/2) A_m and
    H = z^(1/2) G_(m-1), the step A_m = A_(m-1) + k_m z^-1 B_(m-1) becomes G_m = H + k_m conj(H): the real part of H
    times (1 + k_m), and its imaginary part times (1 - k_m).
    """
    turned = np.ones_like(half)
    yield np.ones(half.shape)
    for k in reflection:
        turned *= half
        turned.real *= 1 + k
        turned.imag *= 1 - k
        yield np.asarray(turned.real**2 + turned.imag**2, dtype=np.float64)
