"""Models of textures that were identified at one rate, as models for the servo's."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np

from hapticd.base.lattice import Reflection, with_poles
from hapticd.rendering.filter_design import (
    COARSE_RULE,
    MAX_ORDER,
    Array,
    ComplexArray,
    panel_nodes,
    pole_mesh,
    poles_of,
    power_at,
)

CLOSE_DB: Final = 0.5
"""A resampled model is close enough when its spectrum is within this of the model's, wherever that is within
RANGE_DB of its peak."""
RANGE_DB: Final = 30.0
_FLOOR: Final = 1e-7
"""White power added before a prediction filter is computed, as a fraction: the recursion then never breaks down."""
_SKIRT: Final = 12.0
"""Beyond the band of a model that is shown at a higher rate, power falls with this power of the frequency at least,"""
_LEAK: Final = 0.05
"""and so steeply that no more than this fraction of the power lies there."""
_PLACED: Final = 4
"""Up to so many poles (or pairs) of such a model are placed directly, and the fit is gone over so many times."""
_ROUNDS: Final = 6
_STALLED: Final = 0.95
"""A round that leaves more than this fraction of the error is the last one."""


class Resampled(NamedTuple):
    """A model at another rate."""

    reflection: Reflection
    kept: float
    """The fraction of the model's power within the band that both rates carry."""
    error_db: float
    """How far the spectrum is from the model's, at most, within that band and RANGE_DB of the peak."""


@lru_cache(maxsize=1024)
def resampled(model: Reflection, from_rate_hz: float, to_rate_hz: float) -> Resampled:
    """An all-pole model identified at one rate, as an all-pole model for another.

    The model's spectrum in that band gives the autocorrelation at the lags of the new rate, and Levinson and Durbin's
    recursion the reflection coefficients. The smallest order up to MAX_ORDER is taken that stays within CLOSE_DB of the
    model's spectrum in the band (both of unit power) wherever that is within RANGE_DB of its peak; else the best.

    At a higher rate the model says nothing beyond its band. There power falls steeply from the band's edge. Where the
    fit to that is not close enough, it is gone over: the power beyond the band, any of which will do, follows the last
    fit as far as it stays below the edge's; and because 32 lags of the new rate may be too short to resolve the
    model's poles, its sharpest poles p are placed directly, at p^(from/to), and the recursion fits the rest. (All
    poles placed and no fit would keep the resonances and lose the levels between them.)
    """
    if from_rate_hz == to_rate_hz:
        return Resampled(model, 1.0, 0.0)
    ratio = from_rate_hz / to_rate_hz
    # Angles of the new rate, as far as the band goes; poles are where the model has them.
    poles = poles_of(model)
    band = min(math.pi, math.pi / ratio)
    own, own_weight = pole_mesh(poles, band, MAX_ORDER, COARSE_RULE)
    angle, weight = own * ratio, own_weight * ratio
    power = power_at(model, None, own)
    # Upward it is all of it; poles all but on the circle would make the integral say otherwise.
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
        if best.error_db <= CLOSE_DB:
            break
    assert best is not None
    shown, error_db = best.realised(), best.error_db
    if error_db > CLOSE_DB:  # it is reported, so it is sought between the nodes of the fit, too
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
    """The largest error in dB at twice the nodes; `wanted` and `fitted` are the two powers at the nodes `angle`."""
    peak = int(np.argmax(wanted))
    own, _ = pole_mesh(poles, band, MAX_ORDER)
    power, there = power_at(model, None, own), power_at(shown, None, own * ratio)
    power *= wanted[peak] / float(power_at(model, None, angle[peak : peak + 1] / ratio)[0])
    there *= fitted[peak] / float(power_at(shown, None, angle[peak : peak + 1])[0])
    heard = power >= power.max() * 10 ** (-RANGE_DB / 10)
    return float(np.abs(10 * np.log10(there[heard] / power[heard])).max())


@dataclass(frozen=True, slots=True)
class _Fit:
    """Poles placed directly, times a prediction filter; its largest error in dB, and its power at the nodes."""

    error_db: float
    placed: list[complex]
    reflection: Reflection
    power: Array

    def realised(self) -> Reflection:
        return with_poles(self.reflection, self.placed) if self.placed else self.reflection


@dataclass(frozen=True, slots=True)
class _Nodes:
    """Where a fit is made, with what all fits there have in common."""

    weight: Array
    delay: ComplexArray
    """z^-1 at each node."""
    half: ComplexArray
    """z^(1/2) at each node."""
    cosines: Array
    """[lags][nodes]: what gives the autocorrelation."""

    @classmethod
    def at(cls, angle: Array, weight: Array) -> "_Nodes":
        delay = np.exp(-1j * angle)
        cosines = np.empty((MAX_ORDER + 1, len(angle)))
        turned = np.ones_like(delay)
        cosines[0] = 1.0
        for lag in range(1, MAX_ORDER + 1):
            turned *= delay
            cosines[lag] = turned.real
        return cls(weight, delay, np.exp(0.5j * angle), cosines)


def _fit(power: Array, target: Array, nodes: _Nodes, placed: list[complex]) -> _Fit:
    """The all-pole fit to `target` at these nodes, of the smallest order that is close to `power` (at the first of
    them: those within the band), else of the order that is closest."""
    direct = np.ones_like(target)
    for pole in placed:
        direct /= np.abs((1 - pole * nodes.delay) * (1 if pole.imag == 0 else 1 - pole.conjugate() * nodes.delay)) ** 2
    room = MAX_ORDER - _order_of(placed)
    correlation = nodes.cosines[: room + 1] @ (nodes.weight * (target / direct))
    reflection = _predicted(correlation)
    heard = np.flatnonzero(power >= power.max() * 10 ** (-RANGE_DB / 10))
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
        if error <= CLOSE_DB:
            break
    assert best is not None
    error, n, fitted = best
    return _Fit(error, placed, reflection[:n], direct * fitted)


def _fits_beyond(power: Array, angle: Array, weight: Array, poles: ComplexArray, ratio: float) -> Iterator[_Fit]:
    """Fits at a rate beyond the model's, the plain one first."""
    edge = math.pi * ratio
    # Panels that grow with the distance from the edge, where the skirt is steep.
    count = math.ceil(20 * math.log(1 / ratio)) + 1
    beyond, beyond_weight = panel_nodes(np.geomspace(edge, math.pi, count + 1), COARSE_RULE)
    inside = len(angle)
    nodes = _Nodes.at(np.concatenate((angle, beyond)), np.concatenate((weight, beyond_weight)))
    fall = max(_SKIRT, 1 + power[-1] * edge / (_LEAK * math.pi))
    skirt = power[-1] * (edge / beyond) ** fall
    # A pole on the negative real axis has no counterpart at another rate; one that rings for a million ticks has no
    # reflection coefficients that are safely below 1.
    upper = [complex(p) ** ratio for p in poles if p.imag > 0 or (p.imag == 0 and p.real > 0)]
    sharpest = sorted((p for p in upper if abs(p) < 1 - 1e-6), key=lambda p: (-abs(p), p.imag))
    for count in range(min(_PLACED, len(sharpest)) + 1):
        placed = sharpest[:count]
        target = np.concatenate((power, skirt))
        before = math.inf
        for _ in range(_ROUNDS):
            fit = _fit(power, target, nodes, placed)
            yield fit
            if fit.error_db > _STALLED * before:
                break
            before = fit.error_db
            target[inside:] = np.minimum(fit.power[inside:], power[-1])


def _order_of(poles: Iterable[complex]) -> int:
    return sum(1 if p.imag == 0 else 2 for p in poles)


def _predicted(r: Array) -> Reflection:
    """Reflection coefficients of the best predictor of noise with this autocorrelation (Levinson and Durbin)."""
    r[0] *= 1 + _FLOOR
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
    """1 over the power of the all-pole filters of k_1 .. k_n for n = 0, 1, .. p, up to a factor.

    On the circle B_m = z^-m times the conjugate of A_m. So with G_m = z^(m/2) A_m and H = z^(1/2) G_(m-1) the step
    A_m = A_(m-1) + k_m z^-1 B_(m-1) is G_m = H + k_m conj(H): its real part is (1 + k_m) times that of H, its imaginary
    part (1 - k_m) times.
    """
    turned = np.ones_like(half)
    yield np.ones(half.shape)
    for k in reflection:
        turned *= half
        turned.real *= 1 + k
        turned.imag *= 1 - k
        yield np.asarray(turned.real**2 + turned.imag**2, dtype=np.float64)
