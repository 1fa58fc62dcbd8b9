"""Filters for coloured noise: from a peak and a mean frequency, or from models identified in recordings.

A filter is a normalised lattice with reflection coefficients k_1 .. k_p and, where it has zeros, ladder taps
v_0 .. v_p (Gray and Markel, "A normalized digital filter structure", IEEE Trans. ASSP, 1975). The conventions:

    A_0 = B_0 = 1,  A_m = A_(m-1) + k_m z^-1 B_(m-1),  B_m = k_m A_(m-1) + z^-1 B_(m-1)
    E_0 = 1,        E_m = E_(m-1) (1 - k_m^2)
    H = sqrt(E_p) / A_p * sum over m of v_m B_m / sqrt(E_m)

so A = A_p = 1 + sum a_i z^-i, and in time x[n] = e[n] - sum a_i x[n-i]. The signals B_m / sqrt(E_m) are orthonormal for
white input of unit power, so the output has unit power when the squares of the taps add up to one. Without taps the
output is v = (1, 0, ..., 0), the all-pole filter. Whatever moves a reflection coefficient within (-1, 1) keeps the
filter stable, which is why blends are linear in them: a convex mean of numbers in (-1, 1) lies in (-1, 1).

Frequencies of the design are angles w in (0, pi), and their map y = 1 - cos w = 2 sin^2(w/2), in which the power of any
filter of order p is a ratio of polynomials of degree p at most.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from hapticd.base.lattice import Reflection, realised, with_poles
from hapticd.base.worker_process import apart

Array: TypeAlias = npt.NDArray[np.float64]
ComplexArray: TypeAlias = npt.NDArray[np.complex128]

MAX_ORDER: Final = 32
"""HD_NOISE_ORDER."""
MAX_LINES: Final = 256
"""Distinct speeds, and distinct forces, of a grid."""

NARROWEST_HZ: Final = 20.0
"""The smallest half-power bandwidth of a designed peak: the RMS of a minute of such noise scatters by 0.8 %."""
CLOSE_DB: Final = 0.5
"""A resampled model is close enough when its spectrum is within this of the model's, wherever that is within
RANGE_DB of its peak."""
RANGE_DB: Final = 30.0

_EDGE: Final = 5e-4
"""Peaks nearer than this fraction of the rate to 0 or to half the rate are moved to it."""
_SHARPEST: Final = 2e-4
"""Half the smallest half-power bandwidth in radians: keeps pole radii at 0.9999 and below."""
_DIP: Final = 0.25
"""1/(1 + this) is the power, over the peak's, that a rival end of the spectrum may have: the peak is 1 dB over it."""
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

_Rule: TypeAlias = tuple[Array, Array]
_FINE: Final[_Rule] = np.polynomial.legendre.leggauss(12)
"""Nodes and weights of a panel."""
_COARSE: Final[_Rule] = np.polynomial.legendre.leggauss(6)
"""Enough for a fit: integrals of a spectrum whose poles are as near as a panel is long are off by 3e-8."""


# ---- Filters and their spectra -------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Filter:
    """A lattice with output of unit power. `taps` (one more than `reflection`, squares adding up to one) weigh the
    orthonormal backward errors; None: the all-pole output. `peak_hz` and `mean_hz` are those of its analytic spectrum:
    where its density is largest, and its power centroid from 0 to half the rate."""

    reflection: Reflection
    taps: tuple[float, ...] | None
    peak_hz: float
    mean_hz: float

    def met(self, peak_hz: float, mean_hz: float, within: float = 0.03) -> bool:
        """Whether the filter has this peak and this mean, each within a fraction of it."""
        return abs(self.peak_hz - peak_hz) <= within * peak_hz and abs(self.mean_hz - mean_hz) <= within * mean_hz


Spectral: TypeAlias = Filter | tuple[Sequence[float], Sequence[float] | None]
"""A filter, or reflection coefficients with taps or None."""


def power_spectrum(source: Spectral, frequency_hz: npt.ArrayLike, rate_hz: float) -> Array:
    """Analytic one-sided density, 1/Hz, at `frequency_hz` (any shape): its integral from 0 to rate/2 is 1."""
    reflection, taps = (source.reflection, source.taps) if isinstance(source, Filter) else source
    angle = 2 * np.pi / rate_hz * np.asarray(frequency_hz, dtype=np.float64)
    return _power(reflection, taps, angle) * (2 / rate_hz)


def power_above(source: Spectral, frequency_hz: float, rate_hz: float) -> float:
    """The fraction of the power above a frequency: the integral of power_spectrum from there to rate/2."""
    reflection, taps = (source.reflection, source.taps) if isinstance(source, Filter) else source
    if frequency_hz >= rate_hz / 2:
        return 0.0
    nodes, weights = _pole_mesh(_poles(reflection), 2 * math.pi * frequency_hz / rate_hz)
    below = float(weights @ _power(reflection, taps, nodes)) / math.pi
    return min(max(1.0 - below, 0.0), 1.0)


def _power(reflection: Sequence[float], taps: Sequence[float] | None, angle: Array) -> Array:
    """|H|^2 at these angles; its mean over 0 .. pi is 1."""
    delay = np.exp(-1j * angle)
    forward = np.ones_like(delay)
    backward = np.ones_like(delay)
    error = 1.0
    ladder = np.full_like(delay, 1.0 if taps is None else taps[0])
    for m, k in enumerate(reflection, 1):
        backward = backward * delay
        forward, backward = forward + k * backward, k * forward + backward
        error *= (1 - k) * (1 + k)
        if taps is not None:
            ladder = ladder + taps[m] / math.sqrt(error) * backward
    power: Array = error * np.abs(ladder / forward) ** 2
    return power


def _mesh(
    poles: Iterable[tuple[float, float]], limit: float = math.pi, panels: int = 1, rule: _Rule = _FINE
) -> tuple[Array, Array]:
    """Nodes and weights on 0 .. limit that integrate a rational spectrum with poles (angle, distance from the circle).

    Composite Gauss-Legendre. Around each pole the panels are graded by factors of two down to the
    pole's distance, so no panel is longer than about its own distance to any pole, and each converges at once."""
    breaks: list[Array] = [np.linspace(0.0, limit, panels + 1)]
    for angle, distance in poles:
        levels = math.ceil(math.log2(limit / distance)) + 1 if distance < limit else 1
        steps: Array = distance * np.exp2(np.arange(levels, dtype=np.float64))
        breaks += [np.array([angle]), angle - steps, angle + steps]
    edges = np.concatenate(breaks)
    return _panels(np.unique(edges[(edges >= 0) & (edges <= limit)]), rule)


def _panels(edges: Array, rule: _Rule) -> tuple[Array, Array]:
    half = np.diff(edges)[:, None] / 2
    nodes = edges[:-1, None] + half * (1 + rule[0])
    return nodes.ravel(), (half * rule[1]).ravel()


def _poles(reflection: Sequence[float]) -> ComplexArray:
    """Eigenvalues of one step of the lattice without input: well-conditioned where roots of A are not."""
    state = np.eye(len(reflection))
    after = np.zeros_like(state)
    forward = np.zeros(len(reflection))
    for m in range(len(reflection), 0, -1):
        k = reflection[m - 1]
        c = math.sqrt((1 - k) * (1 + k))
        if m < len(reflection):
            after[m] = k * forward + c * state[m - 1]
        forward = c * forward - k * state[m - 1]
    after[:1] = forward
    return np.asarray(np.linalg.eigvals(after), dtype=np.complex128)


def _pole_mesh(
    poles: ComplexArray, limit: float = math.pi, panels: int = 1, rule: _Rule = _FINE
) -> tuple[Array, Array]:
    upper = poles[poles.imag >= 0]
    places = zip(np.angle(upper).tolist(), np.maximum(np.abs(1 - np.abs(upper)), 1e-9).tolist(), strict=True)
    return _mesh(places, limit, panels, rule)


def _measured(reflection: Reflection, taps: tuple[float, ...] | None) -> tuple[float, float]:
    """Angles of the peak and of the power centroid."""
    nodes, weights = _pole_mesh(_poles(reflection))
    power = _power(reflection, taps, nodes)
    mean = float(weights @ (nodes * power) / (weights @ power))
    around = np.concatenate(([0.0], nodes, [math.pi]))
    for _ in range(6):
        best = int(np.argmax(_power(reflection, taps, around)))
        low, high = around[max(best - 1, 0)], around[min(best + 1, len(around) - 1)]
        around = np.linspace(low, high, 33)
    return float((low + high) / 2), mean


def peak_of(reflection: Reflection, rate_hz: float) -> float:
    """Where an all-pole model's spectrum is highest, Hz."""
    return _measured(reflection, None)[0] * rate_hz / (2 * math.pi)


# ---- Noise with a given peak and mean ------------------------------------------------------------------------


@lru_cache(maxsize=4096)
@apart
def stochastic_filter(peak_hz: float, mean_hz: float, rate_hz: float) -> Filter:
    """The noise whose density is largest at `peak_hz` and whose power centroid from 0 to rate/2 is `mean_hz`.

    Every shape is P = N/(N + c t^2 M), t = y - y_peak, with polynomials N, M >= 0 in y that are 1 at the peak. P is 1
    at the peak and at most 1 elsewhere, so the peak holds by construction and c alone remains to set the mean:

    - N = M = 1: AR(2);
    - a zero at rate/2 (or, mirrored, at 0), N linear, M = 1: order 2, lowers (raises) the mean;
    - a pair of zeros, N = 1 + n t^2: order 2 over a floor of white noise;
    - that real zero and a real pole as well, M linear: order 3, lowers (raises) the mean down to half of the peak.

    The first shape in this order that has the pair wins; of several solutions the one whose half-power bandwidth is
    nearest to half of the peak frequency. Bounds keep it noise with a peak: bandwidth at least NARROWEST_HZ (or a
    quarter of the peak frequency, whichever is less), and 1 dB of dip before an end of the spectrum that could rival
    the peak. Where no shape has the pair the nearest is given: the peak stays and the mean is the closest that any
    of them has. (Only peaks within 0.0005 of the rate of 0 or of rate/2 move.)

    ValueError unless 0 < peak_hz, mean_hz < rate_hz/2.
    """
    half = rate_hz / 2
    if not (math.isfinite(rate_hz) and 0 < peak_hz < half and 0 < mean_hz < half):
        raise ValueError(f"peak and mean must be between 0 and half the rate, {half:g} Hz")
    peak = min(max(math.pi * peak_hz / half, 2 * math.pi * _EDGE), math.pi - 2 * math.pi * _EDGE)
    mean = math.pi * mean_hz / half
    reflection, taps = _design(peak, mean, math.pi * NARROWEST_HZ / half)
    found_peak, found_mean = _measured(reflection, taps)
    return Filter(reflection, taps, found_peak * half / math.pi, found_mean * half / math.pi)


@dataclass(frozen=True, slots=True)
class _Family:
    """Spectra of one kind. What is left to choose is their size: the distance in y at which the power is halved,
    c = 1/size^2; over a floor, the size is given and the floor's density over the peak's is left."""

    peak: float
    """Its angle."""
    nodes: Array
    weights: Array
    """An integral over 0 .. pi."""
    zero: bool
    """At the angle pi."""
    pole: bool
    floor: float
    """More than 0: a pair of zeros, and a peak of this size."""

    @property
    def y_peak(self) -> float:
        return 2 * math.sin(self.peak / 2) ** 2

    def tilt(self, size: Array) -> Array:
        """M = 1 + tilt t, with the tilt that leaves the end at angle 0 just 1 dB under the peak, if any does."""
        if not self.pole:
            return np.zeros_like(size)
        end = _DIP * 2 / (2 - self.y_peak) * (size / self.y_peak) ** 2
        return (1 - np.minimum(end, 1.0)) / self.y_peak

    def mean(self, size: Array) -> Array:
        """Power centroids (angles) for sizes [n]."""
        t = 2 * np.sin((self.nodes - self.peak) / 2) * np.sin((self.nodes + self.peak) / 2)
        if self.floor:
            square = (t / self.floor) ** 2
            power = (1 + size[:, None] * square) / (1 + square)
        else:
            top = 2 * np.cos(self.nodes / 2) ** 2 / (2 - self.y_peak) if self.zero else np.ones_like(t)
            power = top / (top + (t / size[:, None]) ** 2 * (1 + self.tilt(size)[:, None] * t))
        mean: Array = power @ (self.weights * self.nodes) / (power @ self.weights)
        return mean

    def realised(self, size: float) -> tuple[Reflection, tuple[float, ...] | None]:
        if self.floor:
            zeros = [_inside(complex(self.y_peak, self.floor / math.sqrt(size)))] if size > 0 else []
            return realised([_inside(complex(self.y_peak, self.floor))], zeros)
        # The denominator in units of t = size * s.
        slope = size / (2 - self.y_peak) if self.zero else 0.0
        tilt = float(self.tilt(np.array([size]))[0])
        roots = np.roots([*([tilt * size] if tilt else []), 1.0, -slope, 1.0])
        poles = [_inside(complex(self.y_peak + size * s)) for s in roots if s.imag >= 0]
        return realised(poles, [complex(-1)] if self.zero else [])


def _inside(y: complex) -> complex:
    """The root z within the unit circle of (1 - z)(1 - 1/z) = 2y, upper half for a pair; 1 - z keeps its digits."""
    root = np.sqrt(y * (y - 2))
    z = 1 - min(y + root, y - root, key=lambda distance: abs(1 - distance))
    return complex(z.real, abs(z.imag))


def _design(peak: float, mean: float, narrowest: float) -> tuple[Reflection, tuple[float, ...] | None]:
    """Reflection and taps for a peak and a mean given as angles. `narrowest`: half of the smallest bandwidth."""
    near = min(peak, math.pi - peak)

    def size_of(half_bandwidth: float) -> float:
        """How far y is from its value at the peak, half a bandwidth away from it (cos a - cos b as a product)."""
        return 2 * math.sin(half_bandwidth / 2) * math.sin(near + half_bandwidth / 2)

    least = max(min(narrowest, near / 8), _SHARPEST)
    sharpest, preferred = size_of(least), size_of(near / 4)
    meshes = {
        mirrored: (at, aim, *_mesh([(0.0, least), (at, least), (math.pi, least)]))
        for mirrored, at, aim in ((False, peak, mean), (True, math.pi - peak, math.pi - mean))
    }
    closest: tuple[float, _Family, float, bool] | None = None
    for zero, pole, floor, mirrored in (
        (False, False, 0.0, False),
        (True, False, 0.0, False),
        (True, False, 0.0, True),
        (False, False, preferred, False),
        (True, True, 0.0, False),
        (True, True, 0.0, True),
    ):
        at, aim, nodes, weights = meshes[mirrored]
        family = _Family(at, nodes, weights, zero, pole, floor)
        if floor:
            sizes, wanted = np.linspace(0.0, 1 / (1 + _DIP), 33), 0.0
        else:
            y = family.y_peak
            broadest = y * math.sqrt((2 - y) / (2 * _DIP)) if zero else max(y, 2 - y) / math.sqrt(_DIP)
            sizes, wanted = np.geomspace(sharpest, broadest, 33), preferred
        error = family.mean(sizes) - aim
        hits = np.flatnonzero((np.abs(error[:-1]) < 1e-9) | (error[:-1] * error[1:] < 0))
        if len(hits):
            first = hits[np.argmin(np.abs(np.searchsorted(sizes, wanted) - hits))]
            return _mirror(family.realised(_refined(family, aim, sizes[first], sizes[first + 1])), mirrored)
        best = int(np.argmin(np.abs(error)))
        if closest is None or abs(error[best]) < closest[0]:
            closest = (float(abs(error[best])), family, float(sizes[best]), mirrored)
    assert closest is not None
    return _mirror(closest[1].realised(closest[2]), closest[3])


def _refined(family: _Family, aim: float, low: float, high: float) -> float:
    """The size between two whose mean is `aim`."""
    for _ in range(4):
        sizes = np.linspace(low, high, 9)
        error = family.mean(sizes) - aim
        crossings = np.flatnonzero(error[:-1] * error[1:] < 0)
        if not len(crossings):
            # The very ends, or a mean that does not change at all.
            return float(sizes[np.argmin(np.abs(error))])
        first = crossings[0]
        low, high = float(sizes[first]), float(sizes[first + 1])
    below, above = float(error[first]), float(error[first + 1])
    return low + (high - low) * below / (below - above)


def _mirror(
    design: tuple[Reflection, tuple[float, ...] | None], mirrored: bool
) -> tuple[Reflection, tuple[float, ...] | None]:
    """The filter with z for -z: the spectrum is turned round, 0 for rate/2."""
    if not mirrored:
        return design
    reflection, taps = design
    flipped = tuple(k if m % 2 == 0 else -k for m, k in enumerate(reflection, 1))
    return flipped, None if taps is None else tuple(v if m % 2 == 0 else -v for m, v in enumerate(taps))


# ---- A model at another rate ---------------------------------------------------------------------------------


class Resampled(NamedTuple):
    """A model at another rate."""

    reflection: Reflection
    kept: float
    """The fraction of the model's power within the band that both rates carry."""
    error_db: float
    """How far the spectrum is from the model's, at most, within that band and RANGE_DB of the peak."""


def resampled(reflection: Sequence[float], from_rate_hz: float, to_rate_hz: float, order: int = MAX_ORDER) -> Resampled:
    """An all-pole model identified at one rate, as an all-pole model for another.

    The model's spectrum in that band gives the autocorrelation at the lags of the new rate, and Levinson and Durbin's
    recursion the reflection coefficients. The smallest order up to `order` is taken that stays within CLOSE_DB of the
    model's spectrum in the band (both of unit power) wherever that is within RANGE_DB of its peak; else the best.

    At a higher rate the model says nothing beyond its band. There power falls steeply from the band's edge. Where the
    fit to that is not close enough, it is gone over: the power beyond the band, any of which will do, follows the last
    fit as far as it stays below the edge's; and because 32 lags of the new rate may be too short to resolve the
    model's poles, its sharpest poles p are placed directly, at p^(from/to), and the recursion fits the rest. (All
    poles placed and no fit would keep the resonances and lose the levels between them.)

    ValueError where a coefficient is not within (-1, 1), a rate not positive, or `order` not 1 .. 32.
    """
    model = tuple(float(k) for k in reflection)
    if not all(abs(k) < 1 for k in model):
        raise ValueError("every reflection coefficient must be between -1 and 1")
    if not (0 < from_rate_hz < math.inf and 0 < to_rate_hz < math.inf):
        raise ValueError("rates must be positive")
    if not 1 <= order <= MAX_ORDER:
        raise ValueError(f"the order must be 1 to {MAX_ORDER}")
    return (
        Resampled(model, 1.0, 0.0)
        if from_rate_hz == to_rate_hz
        else _resampled(model, from_rate_hz / to_rate_hz, order)
    )


@lru_cache(maxsize=1024)
@apart
def _resampled(model: Reflection, ratio: float, order: int) -> Resampled:
    # Angles of the new rate, as far as the band goes; poles are where the model has them.
    poles = _poles(model)
    band = min(math.pi, math.pi / ratio)
    own, own_weight = _pole_mesh(poles, band, MAX_ORDER, _COARSE)
    angle, weight = own * ratio, own_weight * ratio
    power = _power(model, None, own)
    # Upward it is all of it; poles all but on the circle would make the integral say otherwise.
    kept = min(float(own_weight @ power) / math.pi, 1.0) if ratio > 1 else 1.0
    power *= math.pi / (weight @ power)
    if ratio > 1:
        fits = iter([_fit(power, power, _Nodes.at(angle, weight, order), [], order)])
    else:
        fits = _fits_beyond(power, angle, weight, poles, ratio, order)
    best = None
    for fit in fits:
        if best is None or fit.error_db < best.error_db:
            best = fit
        if best.error_db <= CLOSE_DB:
            break
    assert best is not None
    shown, error_db = best.realised(), best.error_db
    if error_db > CLOSE_DB:  # it is told, so it is looked for between the nodes of the fit, too
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
    own, _ = _pole_mesh(poles, band, MAX_ORDER)
    power, there = _power(model, None, own), _power(shown, None, own * ratio)
    power *= wanted[peak] / float(_power(model, None, angle[peak : peak + 1] / ratio)[0])
    there *= fitted[peak] / float(_power(shown, None, angle[peak : peak + 1])[0])
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
    def at(cls, angle: Array, weight: Array, order: int) -> "_Nodes":
        delay = np.exp(-1j * angle)
        cosines = np.empty((order + 1, len(angle)))
        turned = np.ones_like(delay)
        cosines[0] = 1.0
        for lag in range(1, order + 1):
            turned *= delay
            cosines[lag] = turned.real
        return cls(weight, delay, np.exp(0.5j * angle), cosines)


def _fit(power: Array, target: Array, nodes: _Nodes, placed: list[complex], order: int) -> _Fit:
    """The all-pole fit to `target` at these nodes, of the smallest order that is close to `power` (at the first of
    them: those within the band), else of the order that is closest."""
    direct = np.ones_like(target)
    for pole in placed:
        direct /= np.abs((1 - pole * nodes.delay) * (1 if pole.imag == 0 else 1 - pole.conjugate() * nodes.delay)) ** 2
    room = order - _order_of(placed)
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


def _fits_beyond(
    power: Array, angle: Array, weight: Array, poles: ComplexArray, ratio: float, order: int
) -> Iterator[_Fit]:
    """Fits at a rate beyond the model's, the plain one first."""
    edge = math.pi * ratio
    # Panels that grow with the distance from the edge, where the skirt is steep.
    count = math.ceil(20 * math.log(1 / ratio)) + 1
    beyond, beyond_weight = _panels(np.geomspace(edge, math.pi, count + 1), _COARSE)
    inside = len(angle)
    nodes = _Nodes.at(np.concatenate((angle, beyond)), np.concatenate((weight, beyond_weight)), order)
    fall = max(_SKIRT, 1 + power[-1] * edge / (_LEAK * math.pi))
    skirt = power[-1] * (edge / beyond) ** fall
    # A pole on the negative real axis has no counterpart at another rate; one that rings for a million ticks has no
    # reflection coefficients that are safely below 1.
    upper = [complex(p) ** ratio for p in poles if p.imag > 0 or (p.imag == 0 and p.real > 0)]
    sharpest = sorted((p for p in upper if abs(p) < 1 - 1e-6), key=lambda p: (-abs(p), p.imag))
    for count in range(min(_PLACED, len(sharpest)) + 1):
        placed = sharpest[:count]
        if _order_of(placed) > order:
            return
        target = np.concatenate((power, skirt))
        before = math.inf
        for _ in range(_ROUNDS):
            fit = _fit(power, target, nodes, placed, order)
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


# ---- Models over speed and force -----------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Model:
    """What noise was identified at one speed and force: an all-pole filter and the RMS of its output."""

    speed_m_per_s: float
    force_n: float
    reflection: Reflection
    rms_m_per_s2: float


@dataclass(frozen=True, slots=True)
class Grid:
    """Rising `speeds` (m/s) and `forces` (N); `nodes` [speeds][forces][1 + order]: RMS (m/s^2), then k_1 .. k_order."""

    speeds: tuple[float, ...]
    forces: tuple[float, ...]
    nodes: Array


def grid(models: Sequence[Model], order: int) -> Grid:
    """The grid on all speeds and forces at which there are models.

    A model is its node, with zeros after its own order (which do not change it). A node without a model is a mean of
    all of them, weighted by the inverse square of their distance (Shepard, 1968) on axes scaled to their ranges: the
    weights are positive and add up to one, so that the RMS stays within what was given and every |k| below 1.

    ValueError: no model, two at one place, more than 256 speeds or forces, a model that is of a higher order, not
    stable, or not finite.
    """
    if not models:
        raise ValueError("there must be at least one model")
    for model in models:
        where = f"the model at {model.speed_m_per_s:g} m/s, {model.force_n:g} N"
        if not all(map(math.isfinite, (model.speed_m_per_s, model.force_n, model.rms_m_per_s2))):
            raise ValueError(f"{where} must be finite")
        if model.rms_m_per_s2 < 0:
            raise ValueError(f"{where} must have an RMS of at least 0")
        if len(model.reflection) > order:
            raise ValueError(f"{where} must be of order {order} at most, is of order {len(model.reflection)}")
        if not all(abs(k) < 1 for k in model.reflection):
            raise ValueError(f"{where} must have reflection coefficients between -1 and 1")
    places = np.array([(model.speed_m_per_s, model.force_n) for model in models])
    speeds, rows = np.unique(places[:, 0], return_inverse=True)
    forces, columns = np.unique(places[:, 1], return_inverse=True)
    for name, axis in (("speeds", speeds), ("forces", forces)):
        if len(axis) > MAX_LINES:
            raise ValueError(f"there may be {MAX_LINES} different {name} at most, there are {len(axis)}")
    given = np.zeros((len(speeds), len(forces)), dtype=np.bool_)
    given[rows, columns] = True
    if np.count_nonzero(given) < len(models):
        raise ValueError("there may be one model at most at a speed and force")
    values = np.zeros((len(models), 1 + order))
    for value, model in zip(values, models, strict=True):
        value[0] = model.rms_m_per_s2
        value[1 : 1 + len(model.reflection)] = model.reflection
    nodes = np.empty((len(speeds), len(forces), 1 + order))
    nodes[rows, columns] = values
    scale = np.array([float(np.ptp(axis)) or 1.0 for axis in (speeds, forces)])
    for row in range(len(speeds)):
        free = np.flatnonzero(~given[row])
        away = (places[:, None] - np.stack(np.broadcast_arrays(speeds[row], forces[free]), axis=-1)) / scale
        distance = np.maximum(np.hypot(away[..., 0], away[..., 1]), np.finfo(np.float64).tiny)
        weights = (distance.min(axis=0) / distance) ** 2
        blends = (weights / weights.sum(axis=0)).T @ values
        # Rounding must not carry a mean past what it is the mean of.
        nodes[row, free] = np.clip(blends, values.min(axis=0), values.max(axis=0))
    return Grid(tuple(speeds.tolist()), tuple(forces.tolist()), nodes)
