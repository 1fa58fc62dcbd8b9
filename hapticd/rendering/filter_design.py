"""Filters for coloured noise: their spectra, and the design of a filter with a given peak and mean frequency.

A filter is a normalised lattice with reflection coefficients k_1 .. k_p and, where it has zeros, ladder taps
v_0 .. v_p (Gray and Markel, "A normalized digital filter structure", IEEE Trans. ASSP, 1975). The conventions:

    A_0 = B_0 = 1,  A_m = A_(m-1) + k_m z^-1 B_(m-1),  B_m = k_m A_(m-1) + z^-1 B_(m-1)
    E_0 = 1,        E_m = E_(m-1) (1 - k_m^2)
    H = sqrt(E_p) / A_p * sum over m of v_m B_m / sqrt(E_m)

so A = A_p = 1 + sum a_i z^-i, and in time x[n] = e[n] - sum a_i x[n-i]. The signals B_m / sqrt(E_m) are orthonormal for
white input of unit power, so the output has unit power when the squares of the taps add up to one. Without taps the
filter is all-pole, with v = (1, 0, ..., 0). A filter is stable if all reflection coefficients are in (-1, 1). Weighted
means of such coefficients are in that interval, too, so filters are blended linearly in these coefficients.

Frequencies of the design are angles w in (0, pi), and their map y = 1 - cos w = 2 sin^2(w/2), in which the power of any
filter of order p is a ratio of polynomials of degree p at most.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt

from hapticd.base.lattice import Reflection, realised

Array: TypeAlias = npt.NDArray[np.float64]
ComplexArray: TypeAlias = npt.NDArray[np.complex128]

MIN_BANDWIDTH_HZ: Final = 20.0
"""Smallest half-power bandwidth of a designed peak: the RMS of a minute of such noise scatters by 0.8 %."""

_EDGE_RATE_FRACTION: Final = 5e-4
"""Peaks are at least this fraction of the rate away from 0 and from half the rate; nearer peaks are moved."""
_MIN_HALF_BANDWIDTH_RAD: Final = 2e-4
"""Half the smallest half-power bandwidth, in radians; it keeps pole radii at 0.9999 and below."""
_END_DIP_RATIO: Final = 0.25
"""At an end of the spectrum, the density is at most 1/(1 + _END_DIP_RATIO) of the peak's, about 1 dB lower."""

_Rule: TypeAlias = tuple[Array, Array]
_FINE_RULE: Final[_Rule] = np.polynomial.legendre.leggauss(12)
"""Gauss-Legendre nodes and weights of a panel (an interval of the integration)."""
COARSE_RULE: Final[_Rule] = np.polynomial.legendre.leggauss(6)
"""Gauss-Legendre nodes and weights for fits. Integrals are accurate to 3e-8 if poles are a panel's length away."""


# ---- Filters and their spectra -------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Filter:
    """A lattice filter with output of unit power.

    `taps` (one more than `reflection`, with squares adding up to one) weight the orthonormal backward errors; None
    selects the all-pole output. `peak_hz` is the frequency of the largest density of the analytic spectrum. `mean_hz`
    is its power centroid from 0 to half the rate.
    """

    reflection: Reflection
    taps: tuple[float, ...] | None
    peak_hz: float
    mean_hz: float

    def met(self, peak_hz: float, mean_hz: float, within: float = 0.03) -> bool:
        """Return whether the filter has this peak and this mean, each to within the relative error `within`."""
        return abs(self.peak_hz - peak_hz) <= within * peak_hz and abs(self.mean_hz - mean_hz) <= within * mean_hz


Spectral: TypeAlias = Filter | tuple[Sequence[float], Sequence[float] | None]
"""A filter, or reflection coefficients with taps or None."""


def power_spectrum(source: Spectral, frequency_hz: npt.ArrayLike, rate_hz: float) -> Array:
    """Return the one-sided power density (1/Hz) at `frequency_hz`, any shape; its integral from 0 to rate/2 is 1."""
    reflection, taps = (source.reflection, source.taps) if isinstance(source, Filter) else source
    angle = 2 * np.pi / rate_hz * np.asarray(frequency_hz, dtype=np.float64)
    return power_at(reflection, taps, angle) * (2 / rate_hz)


def power_above(source: Spectral, frequency_hz: float, rate_hz: float) -> float:
    """Return the fraction of the power above a frequency: the integral of power_spectrum up to rate/2."""
    reflection, taps = (source.reflection, source.taps) if isinstance(source, Filter) else source
    if frequency_hz >= rate_hz / 2:
        return 0.0
    nodes, weights = pole_mesh(poles_of(reflection), 2 * math.pi * frequency_hz / rate_hz)
    below = float(weights @ power_at(reflection, taps, nodes)) / math.pi
    return min(max(1.0 - below, 0.0), 1.0)


def power_at(reflection: Sequence[float], taps: Sequence[float] | None, angle: Array) -> Array:
    """Return the power gain |H|^2 of a lattice filter at these angles; its mean over 0 .. pi is 1."""
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
    poles: Iterable[tuple[float, float]], limit: float = math.pi, panels: int = 1, rule: _Rule = _FINE_RULE
) -> tuple[Array, Array]:
    """Return nodes and weights that integrate a rational spectrum over the angles 0 .. limit.

    The poles are given as (angle, distance from the unit circle). The rule is composite Gauss-Legendre. Towards each
    pole the panels halve in length down to the pole's distance. A panel is at most about as long as its distance to any
    pole, so the rule converges fast.
    """
    breaks: list[Array] = [np.linspace(0.0, limit, panels + 1)]
    for angle, distance in poles:
        levels = math.ceil(math.log2(limit / distance)) + 1 if distance < limit else 1
        steps: Array = distance * np.exp2(np.arange(levels, dtype=np.float64))
        breaks += [np.array([angle]), angle - steps, angle + steps]
    edges = np.concatenate(breaks)
    return panel_nodes(np.unique(edges[(edges >= 0) & (edges <= limit)]), rule)


def panel_nodes(edges: Array, rule: _Rule) -> tuple[Array, Array]:
    """Return the nodes and weights of `rule` on the panels between `edges`."""
    half = np.diff(edges)[:, None] / 2
    nodes = edges[:-1, None] + half * (1 + rule[0])
    return nodes.ravel(), (half * rule[1]).ravel()


def poles_of(reflection: Sequence[float]) -> ComplexArray:
    """Return the poles of a lattice filter, as eigenvalues of the matrix of one step without input.

    These eigenvalues are well-conditioned even if the roots of the polynomial A are not.
    """
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


def pole_mesh(
    poles: ComplexArray, limit: float = math.pi, panels: int = 1, rule: _Rule = _FINE_RULE
) -> tuple[Array, Array]:
    """Return nodes and weights that integrate the spectrum of a filter with these poles over angles 0 .. limit."""
    upper = poles[poles.imag >= 0]
    places = zip(np.angle(upper).tolist(), np.maximum(np.abs(1 - np.abs(upper)), 1e-9).tolist(), strict=True)
    return _mesh(places, limit, panels, rule)


def _peak_and_mean(reflection: Reflection, taps: tuple[float, ...] | None) -> tuple[float, float]:
    """Return the angles of the peak and of the power centroid of a lattice filter's spectrum."""
    nodes, weights = pole_mesh(poles_of(reflection))
    power = power_at(reflection, taps, nodes)
    mean = float(weights @ (nodes * power) / (weights @ power))
    around = np.concatenate(([0.0], nodes, [math.pi]))
    for _ in range(6):
        best = int(np.argmax(power_at(reflection, taps, around)))
        low, high = around[max(best - 1, 0)], around[min(best + 1, len(around) - 1)]
        around = np.linspace(low, high, 33)
    return float((low + high) / 2), mean


def peak_of(reflection: Reflection, rate_hz: float) -> float:
    """Return the frequency (Hz) at which the spectrum of an all-pole model is highest."""
    return _peak_and_mean(reflection, None)[0] * rate_hz / (2 * math.pi)


# ---- Noise with a given peak and mean ------------------------------------------------------------------------


@lru_cache(maxsize=4096)
def stochastic_filter(peak_hz: float, mean_hz: float, rate_hz: float) -> Filter:
    """Return the filter of noise with its largest density at `peak_hz` and its power centroid at `mean_hz`.

    Every shape is P = N/(N + c t^2 M), t = y - y_peak, with polynomials N, M >= 0 in y that are 1 at the peak. P is 1
    at the peak and at most 1 elsewhere, so the peak holds by construction and only c is left to set the mean:

    - N = M = 1: AR(2);
    - a zero at rate/2 (or, mirrored, at 0), N linear, M = 1: order 2, lowers (raises) the mean;
    - a pair of zeros, N = 1 + n t^2: order 2 over a floor of white noise;
    - the same real zero and a real pole, M linear: order 3, lowers (raises) the mean down to half of the peak.

    The first shape in this order that can have both peak and mean is returned; of several solutions, the one whose
    half-power bandwidth is nearest to half of the peak frequency. Two bounds keep the peak distinct. The bandwidth is
    at least MIN_BANDWIDTH_HZ (or a quarter of the peak frequency, whichever is less). At an end of the spectrum that
    could rival the peak, the density is 1 dB lower. If no shape has both, the peak stays, and the shape with the
    nearest mean is returned. Only peaks nearer to 0 or rate/2 than 0.0005 rate move.

    Raises ValueError unless 0 < peak_hz, mean_hz < rate_hz/2.
    """
    half = rate_hz / 2
    if not (math.isfinite(rate_hz) and 0 < peak_hz < half and 0 < mean_hz < half):
        raise ValueError(f"peak and mean must be between 0 and half the rate, {half:g} Hz")
    peak = min(
        max(math.pi * peak_hz / half, 2 * math.pi * _EDGE_RATE_FRACTION), math.pi - 2 * math.pi * _EDGE_RATE_FRACTION
    )
    mean = math.pi * mean_hz / half
    reflection, taps = _design(peak, mean, math.pi * MIN_BANDWIDTH_HZ / half)
    found_peak, found_mean = _peak_and_mean(reflection, taps)
    return Filter(reflection, taps, found_peak * half / math.pi, found_mean * half / math.pi)


@dataclass(frozen=True, slots=True)
class _Family:
    """Spectra of one shape (see stochastic_filter), with the size of the peak as the free parameter.

    The size is the distance in y at which the power is halved, c = 1/size^2. Over a floor of white noise the size is
    fixed, and the free parameter is the ratio of the floor's density to the peak's.
    """

    peak: float
    """Angle of the peak."""
    nodes: Array
    weights: Array
    """Weights of the nodes for integrals over 0 .. pi."""
    zero: bool
    """Whether there is a zero at the angle pi."""
    pole: bool
    """Whether there is a real pole."""
    floor: float
    """The size of the peak over a floor, with a pair of zeros; 0 without a floor."""

    @property
    def y_peak(self) -> float:
        """The peak's position on the axis y = 1 - cos w."""
        return 2 * math.sin(self.peak / 2) ** 2

    def tilt(self, size: Array) -> Array:
        """Return `tilt` of M = 1 + tilt t with a density at angle 0 that is 1 dB below the peak; 0 without a pole."""
        if not self.pole:
            return np.zeros_like(size)
        end = _END_DIP_RATIO * 2 / (2 - self.y_peak) * (size / self.y_peak) ** 2
        return (1 - np.minimum(end, 1.0)) / self.y_peak

    def mean(self, size: Array) -> Array:
        """Return the mean angle, weighted with power, of the spectrum for each peak size; both (n,)."""
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
        """Return reflection coefficients and taps of the spectrum whose peak has this size."""
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
    """Return the upper root z of (1 - z)(1 - 1/z) = 2y in the unit circle; 1 - z is accurate even if small."""
    root = np.sqrt(y * (y - 2))
    z = 1 - min(y + root, y - root, key=lambda distance: abs(1 - distance))
    return complex(z.real, abs(z.imag))


def _design(peak: float, mean: float, narrowest: float) -> tuple[Reflection, tuple[float, ...] | None]:
    """Return reflection coefficients and taps for a peak and a mean frequency, given as angles.

    `narrowest` is half of the smallest bandwidth.
    """
    near = min(peak, math.pi - peak)

    def size_of(half_bandwidth: float) -> float:
        """Return |y - y_peak| at an angle of `half_bandwidth` from the peak, as a product without cancellation."""
        return 2 * math.sin(half_bandwidth / 2) * math.sin(near + half_bandwidth / 2)

    narrowest = max(min(narrowest, near / 8), _MIN_HALF_BANDWIDTH_RAD)
    sharpest, preferred = size_of(narrowest), size_of(near / 4)
    meshes = {
        mirrored: (at, aim, *_mesh([(0.0, narrowest), (at, narrowest), (math.pi, narrowest)]))
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
            sizes, wanted = np.linspace(0.0, 1 / (1 + _END_DIP_RATIO), 33), 0.0
        else:
            y = family.y_peak
            broadest = (
                y * math.sqrt((2 - y) / (2 * _END_DIP_RATIO)) if zero else max(y, 2 - y) / math.sqrt(_END_DIP_RATIO)
            )
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
    """Return the size of the peak, between `low` and `high`, for which the power centroid is `aim`."""
    for _ in range(4):
        sizes = np.linspace(low, high, 9)
        error = family.mean(sizes) - aim
        crossings = np.flatnonzero(error[:-1] * error[1:] < 0)
        if not len(crossings):
            # A root at an end of the interval, or a mean that does not change.
            return float(sizes[np.argmin(np.abs(error))])
        first = crossings[0]
        low, high = float(sizes[first]), float(sizes[first + 1])
    below, above = float(error[first]), float(error[first + 1])
    return low + (high - low) * below / (below - above)


def _mirror(
    design: tuple[Reflection, tuple[float, ...] | None], mirrored: bool
) -> tuple[Reflection, tuple[float, ...] | None]:
    """Return the filter, with z replaced by -z if `mirrored`: the spectrum then has 0 and rate/2 exchanged."""
    if not mirrored:
        return design
    reflection, taps = design
    flipped = tuple(k if m % 2 == 0 else -k for m, k in enumerate(reflection, 1))
    return flipped, None if taps is None else tuple(v if m % 2 == 0 else -v for m, v in enumerate(taps))
