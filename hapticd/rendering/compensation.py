"""Compensation: the forces of a strike that make handle and hand accelerate as the material's mode says.

A force F_k, held from tick k to the next, accelerates the device (m + m_h) x'' + (b + b_h) x' + k x = F by

    X(s) = s^2 / ((m + m_h) s^2 + (b + b_h) s + k) * (1 - exp(-s T))/s * sum_k F_k exp(-s k T),      s = 2 pi i f.

The target is the spectrum of exp(-B t) sin(w t), w / ((s + B)^2 + w^2). Its part at the pole p = -B + i w is displayed
with the right amplitude and phase if F_k = Im(C exp(p k T)),

    C = ((m + m_h) + (b + b_h)/p + k/p^2) * p T / (1 - exp(-p T)).

The device, which was at rest, also answers with a transient. `compensation: full` therefore adds a tail, a second
decaying pole, and finds both complex amplitudes by least squares over the band in which the error is reported. At the
onset it may also correct the first HD_KICKS samples one by one; such a correction is called a kick.

A surface in contact acts on the handle, too. Its stiffness and damping, sampled and held like every force, are added to
those of the device. The actuator delays all these forces by its lag.

A link that is slower than the servo samples the force of a strike at any time within its frame T. Then gains and errors
are those over all onsets within a frame, and no sample is corrected: the core knows ticks, not the frames of a link.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from typing import Final, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from hapticd.base.core import MAX_CORRECTED_SAMPLES
from hapticd.config.actuator import Actuator
from hapticd.config.dynamics import Dynamics
from hapticd.config.modes import Mode

ERROR_BAND_LOW_HZ: Final = 30.0
"""Lower end of the band in which the displayed error is reported. Intended movements of the hand lie below it."""
ERROR_BAND_RATE_FRACTION: Final = 0.4
"""Upper end of the band in which the displayed error is reported, as a fraction of the rate."""
MAX_STRIKE_FORCE_RATIO: Final = 2.0
"""Largest force of a strike, in units of (m + m_h) A with the mode's amplitude A. Larger forces are scaled down."""
MAX_TAIL_EXTENSION_S: Final = 0.05
"""Longest time by which a tail (the second pole of a strike's force) may outlast its mode."""
MIN_TAIL_ERROR_REDUCTION: Final = 0.005
"""A tail, which costs a tick as much time as a mode, must lower the displayed error by more than this to be used."""
MIN_KICK_RATE_FRACTION: Final = 0.05
"""Lowest frequency, as a fraction of the rate, of modes with kicks (corrections of single samples at the onset). First
samples of slower modes are small."""
MIN_KICK_ERROR_REDUCTION: Final = 0.01
"""Kicks (corrections at the onset) must lower the displayed error, RMS over _ONSET_FRACTIONS, by more than this."""

_ONSET_FRACTIONS: Final = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Onsets of the strike for which kicks are designed, in periods before its first tick."""
_ONSETS_IN_FRAME: Final = (0.1, 0.3, 0.5, 0.7, 0.9)
"""Onsets of a strike that a slow link samples, in frames before the first sample: the middles of fifths of a frame."""
_MODE_TIME_CONSTANTS: Final = 5.0
"""A mode ends five time constants after its last strike."""
_MIN_INDEPENDENCE: Final = 1e-10
"""Columns of length 1 are dependent if one of them is nearer than this to a combination of the others."""
_PEAK_GRID_SAMPLES: Final = 512
"""Number of times at which the force of a strike is computed to find its peak."""

_Complex: TypeAlias = npt.NDArray[np.complex128]
_Floats: TypeAlias = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Load:
    """What acts on a strike besides handle and hand: the surface along its direction, the actuator and the link."""

    stiffness_n_per_m: float = 0.0
    damping_n_s_per_m: float = 0.0
    age_s: float = 0.0
    """Time from the measurement of a position until the surface's force for that position acts."""
    actuator: Actuator | None = None
    slow_link: bool = False
    """Whether a link that is slower than the servo samples the force."""

    @property
    def free(self) -> Load:
        """The load without the surface: the lag of the actuator, and the link."""
        return Load(actuator=self.actuator, slow_link=self.slow_link)

    @property
    def onsets(self) -> tuple[float, ...]:
        """Onsets of a strike, in periods before its first sample, over which its displayed error is the RMS."""
        return _ONSETS_IN_FRAME if self.slow_link else (0.0,)

    def lag(self, s: _Complex) -> _Complex:
        """Return the transfer function of the actuator at the complex frequencies `s`."""
        return np.ones_like(s) if self.actuator is None else self.actuator.response(s)

    def surface(self, s: _Complex, period_s: float) -> _Complex:
        """Return the dynamic stiffness of the surface, -force/position in N/m, at the complex frequencies `s`.

        The position is sampled, damping uses the difference over a period, and the force is held for a period.
        """
        if self.stiffness_n_per_m == 0.0 and self.damping_n_s_per_m == 0.0:
            return np.zeros_like(s)
        difference = -np.expm1(-s * period_s) / period_s
        sampled = self.stiffness_n_per_m + self.damping_n_s_per_m * difference
        return np.asarray(sampled * difference / s * np.exp(-s * self.age_s) * self.lag(s), np.complex128)


NO_LOAD: Final = Load()
"""Load without a surface, and with an actuator without lag."""


@dataclass(frozen=True, slots=True)
class Ringing:
    """The signal Im(gain exp(pole t)) for 0 <= t <= end_s, and 0 afterwards."""

    pole: complex
    gain: complex

    @property
    def end_s(self) -> float:
        """Duration of the signal: five time constants, as for every mode."""
        return _MODE_TIME_CONSTANTS / -self.pole.real


@dataclass(frozen=True, slots=True)
class Shape:
    """Waveform of the force of a strike that begins at a tick, in units of (m + m_h) A with the mode's amplitude A."""

    mode: Ringing
    tail: Ringing | None
    peak: float
    """Upper bound of the magnitude of the samples, for any onset between two ticks."""
    peak_time_s: float
    error: float
    """Displayed error in the band: RMS of (handle's acceleration - mode), divided by the RMS of the mode. Through a
    slow link it is the RMS over all onsets."""
    limited: bool
    """Whether the force was scaled down because its peak exceeded MAX_STRIKE_FORCE_RATIO."""
    kicks: tuple[tuple[float, float], ...] = ()
    """Pair (c, d) for each of the first samples: c + d x is added if the onset is x periods before the first sample."""
    second_tail: Ringing | None = None
    """A further tail, of taps that stay in contact (hapticd.rendering.kept_contact)."""

    @property
    def parts(self) -> tuple[Ringing, ...]:
        """Mode and tails."""
        return tuple(part for part in (self.mode, self.tail, self.second_tail) if part is not None)


def pole_of(mode: Mode) -> complex:
    """Return the pole -B + i w of a mode, in 1/s."""
    return complex(-mode.decay_rate_per_s, mode.angular_frequency_rad_per_s)


def hold_gain(pole: complex, period_s: float) -> complex:
    """Return p T / (1 - exp(-p T)) for the pole p, the gain that compensates the hold of a force for a period T."""
    turned = cmath.exp(pole * period_s)  # at most 1, whereas exp(-p T) may overflow
    return pole * period_s * turned / (turned - 1)


def pole_gain(mode: Mode, dynamics: Dynamics, period_s: float, load: Load = NO_LOAD) -> complex:
    """Return the gain C/(m + m_h) that compensates handle, hand and `load` at the pole of a mode (see the module)."""
    p = pole_of(mode)
    at = np.array([p], np.complex128)
    with np.errstate(over="ignore", invalid="ignore"):
        surface = complex(load.surface(at, period_s)[0])
    # For a mode that ends within a tick the surface overflows and is left out.
    stiffness = dynamics.grip_stiffness_n_per_m + (surface if cmath.isfinite(surface) else 0.0)
    device = 1 + (dynamics.damping_n_s_per_m / p + stiffness / p**2) / dynamics.mass_kg
    return device * hold_gain(p, period_s) / complex(load.lag(at)[0])


class _Grid:
    """Frequencies that sample the error band of one mode, with cached spectra of sampled decaying signals.

    `weight` is the square root of the quadrature weights, so the norm of a weighted spectrum is its RMS over the band.
    """

    def __init__(self, mode: Mode, rate_hz: float) -> None:
        high = ERROR_BAND_RATE_FRACTION * rate_hz
        low = min(ERROR_BAND_LOW_HZ, mode.frequency_hz / 2, high / 2)
        # Linear steps resolve the cut end of a mode, geometric steps the device, `near` the peak of a slow decay.
        width = mode.decay_rate_per_s / (2 * math.pi)
        reach = math.asinh(high / width)
        near = mode.frequency_hz + width * np.sinh(np.linspace(-reach, reach, 201))
        parts = (np.linspace(low, high, 301), np.geomspace(low, high, 201), near[(near > low) & (near < high)])
        frequency = np.unique(np.concatenate(parts))
        step = np.diff(frequency)
        quadrature = np.zeros(len(frequency))
        quadrature[:-1] += step / 2
        quadrature[1:] += step / 2
        self.weight: _Floats = np.sqrt(quadrature)
        self.s: _Complex = np.asarray(2j * np.pi * frequency, np.complex128)
        self.period_s = 1 / rate_hz
        p = pole_of(mode)
        self.target: _Complex = self.weight * p.imag / ((self.s - p) * (self.s - p.conjugate()))
        self.target_norm = float(np.linalg.norm(self.target))
        self._pairs: dict[tuple[complex, int], tuple[_Complex, _Complex]] = {}
        self._below: dict[complex, _Complex] = {}

    @cached_property
    def kick_spectra(self) -> list[_Complex]:
        """Spectra exp(-s k T) of kicks of size 1, one for each sample k that may get a kick."""
        return [np.exp(-self.s * k * self.period_s) for k in range(MAX_CORRECTED_SAMPLES)]

    def targets(self, onsets: tuple[float, ...]) -> list[_Complex]:
        """Return weighted spectra of the mode for these onsets, in periods before the first sample, which is time 0."""
        return [self.target * np.exp(self.s * onset * self.period_s) for onset in onsets]

    def response(self, dynamics: Dynamics, load: Load) -> _Complex:
        """Return the weighted response of the device's acceleration to sampled forces in units of (m + m_h)."""
        stiffness, damping = dynamics.grip_stiffness_n_per_m, dynamics.damping_n_s_per_m
        device = (dynamics.mass_kg * self.s + damping) * self.s + stiffness
        hold = (1 - np.exp(-self.s * self.period_s)) / self.s
        if load != NO_LOAD:
            device = device + load.surface(self.s, self.period_s)
            hold = hold * load.lag(self.s)
        return np.asarray(self.weight * (dynamics.mass_kg * self.s**2 / device * hold), np.complex128)

    def count(self, pole: complex, onset: float) -> int:
        """Return the number of ticks in five time constants of `pole`; the first is `onset` periods after the onset."""
        first_s = onset * self.period_s
        return math.floor((_MODE_TIME_CONSTANTS / -pole.real - first_s) / self.period_s + 1e-9) + 1

    def pair(self, pole: complex, count: int) -> tuple[_Complex, _Complex]:
        """Return the spectra of Im(exp(p t)) and Re(exp(p t)) for the pole p, sampled at `count` ticks."""
        found = self._pairs.get((pole, count))
        if found is None:
            one, other = self._sum(pole, count), self._sum(pole.conjugate(), count)
            found = self._pairs[pole, count] = (one - other) / 2j, (one + other) / 2
        return found

    def _sum(self, pole: complex, count: int) -> _Complex:
        """Return the sum of exp((p - s) k T) over the ticks k < count, for the pole p at each frequency s."""
        step = (pole - self.s) * self.period_s
        below = self._below.get(pole)
        if below is None:
            below = self._below[pole] = np.asarray(np.expm1(step), np.complex128)
        return np.asarray(np.expm1(count * step) / below, np.complex128)


@lru_cache(maxsize=4)
def _grid(mode: Mode, rate_hz: float) -> _Grid:
    """Return the grid of a mode, cached because shapes of a mode are computed for several loads in a row."""
    return _Grid(mode, rate_hz)


class _Band:
    """Acceleration of one device for a struck mode and tails to try, with the first tick as time 0.

    All weighted spectra lie in a space of few dimensions. Accelerations are vectors of coordinates in an orthonormal
    basis of that space, which preserves norms and least squares. Onsets differ only in target and number of ticks.
    """

    def __init__(
        self,
        mode: Mode,
        dynamics: Dynamics,
        rate_hz: float,
        load: Load,
        tails: Sequence[complex] = (),
        with_kicks: bool = False,
    ) -> None:
        """Compute the basis of the spectra. `with_kicks` includes kicks, and the onsets for which they are designed."""
        grid = self._grid = _grid(mode, rate_hz)
        self._mode, self._dynamics, self._load = mode, dynamics, load
        self._pole = pole_of(mode)
        response = grid.response(dynamics, load)
        self._onsets = _ONSET_FRACTIONS if with_kicks else load.onsets
        self._decays: dict[tuple[complex, int], int] = {}
        spectra: list[_Complex] = []
        for pole in (self._pole, *tails):
            for count in sorted({grid.count(pole, onset) for onset in self._onsets}):
                self._decays[pole, count] = len(spectra)
                spectra += [response * each for each in grid.pair(pole, count)]
        self._kicks = len(spectra)
        if with_kicks:
            spectra += [response * each for each in grid.kick_spectra]
        self._targets = len(spectra)
        spectra += grid.targets(self._onsets)
        matrix = np.array(spectra)
        stacked = np.concatenate((matrix.real, matrix.imag), axis=1).T
        self._base: _Floats = np.asarray(np.linalg.qr(stacked, mode="r"), np.float64)

    def target(self, onset: float = 0.0) -> _Floats:
        """Return the wanted acceleration, that of the mode, for an onset `onset` periods before the first tick."""
        return np.asarray(self._base[:, self._targets + self._onsets.index(onset)], np.float64)

    def columns(self, poles: Sequence[complex], onset: float = 0.0) -> list[_Floats]:
        """Return the accelerations for the forces Im(exp(p t)) and Re(exp(p t)), for each pole p.

        The ticks end five time constants after the onset, which is `onset` periods before the first tick.
        """
        found = []
        for pole in poles:
            at = self._decays[pole, self._grid.count(pole, onset)]
            begun = cmath.exp(pole * onset * self._grid.period_s)
            sine, cosine = self._base[:, at], self._base[:, at + 1]
            found += [begun.real * sine + begun.imag * cosine, begun.real * cosine - begun.imag * sine]
        return found

    def error(self, columns: list[_Floats], gains: _Floats, onset: float = 0.0) -> float:
        """Return the displayed error of a force whose poles have `gains`: real part, imaginary part, for each pole."""
        return float(np.linalg.norm(gains @ np.array(columns) - self.target(onset))) / self._grid.target_norm

    def shape(self, poles: Sequence[complex], gains: _Floats) -> Shape:
        """Return the force's shape with these poles and gains, scaled down to MAX_STRIKE_FORCE_RATIO if necessary."""
        ringing = [Ringing(pole, complex(*gains[2 * i : 2 * i + 2])) for i, pole in enumerate(poles)]
        peak, peak_time_s = _peak(ringing)
        limited = peak > MAX_STRIKE_FORCE_RATIO
        if limited:
            factor = MAX_STRIKE_FORCE_RATIO / peak
            ringing = [Ringing(each.pole, factor * each.gain) for each in ringing]
            gains, peak = factor * gains, MAX_STRIKE_FORCE_RATIO
        mode, tail, second_tail = (*ringing, None, None)[:3]
        assert mode is not None
        error = self.error_over(self._load.onsets, ringing)
        return Shape(mode, tail, peak, peak_time_s, error, limited, second_tail=second_tail)

    def alone(self, gain: complex) -> Shape:
        """Return the shape of the force Im(gain exp(p t)) with the mode's pole p, in units of (m + m_h) A."""
        return self.shape([self._pole], np.array([gain.real, gain.imag]))

    def by_hold_gain(self) -> Shape:
        """Return the force's shape with the mode's pole alone, and the gain that compensates hold and actuator."""
        lag = complex(self._load.lag(np.array([self._pole], np.complex128))[0])
        return self.alone(hold_gain(self._pole, self._grid.period_s) / lag)

    def by_pole_gain(self) -> Shape:
        """Return the force's shape with the mode's pole alone, and the gain that compensates the device (pole_gain)."""
        return self.alone(pole_gain(self._mode, self._dynamics, self._grid.period_s, self._load))

    def plain(self) -> Shape:
        """Return the shape without a tail, from by_hold_gain or by_pole_gain, that has the smaller displayed error."""
        return min(self.by_hold_gain(), self.by_pole_gain(), key=lambda shape: shape.error)

    def with_tail(self, tail: complex) -> Shape:
        """Return the force's shape with the mode's pole and the pole `tail`, both gains from one least-squares fit."""
        poles = [self._pole, tail]
        columns = np.vstack([np.array(self.columns(poles, onset)).T for onset in self._load.onsets])
        target = np.concatenate([self.target(onset) for onset in self._load.onsets])
        return self.shape(poles, np.asarray(np.linalg.lstsq(columns, target, rcond=None)[0], np.float64))

    def with_kicks(self, tail: complex, kicks: _Floats | None = None) -> tuple[Shape, float]:
        """Return the force's shape with mode, tail and kicks, and its displayed error, RMS over _ONSET_FRACTIONS.

        One least-squares fit over these onsets gives the gains of mode and tail, and the kicks unless they are given.
        """
        poles = [self._pole, tail]
        decays = [np.array(self.columns(poles, onset)).T for onset in _ONSET_FRACTIONS]
        # Two columns for each of the first samples: c (factor 1) and d (factor `onset`).
        units = [self._base[:, self._kicks + k] for k in range(MAX_CORRECTED_SAMPLES)]
        kicked = [np.array([scale * each for each in units for scale in (1.0, onset)]).T for onset in _ONSET_FRACTIONS]
        target = np.concatenate([self.target(onset) for onset in _ONSET_FRACTIONS])
        columns = [np.hstack(pair) for pair in zip(decays, kicked, strict=True)]
        if kicks is None:
            found: _Floats = np.asarray(np.linalg.lstsq(np.vstack(columns), target, rcond=None)[0], np.float64)
        else:
            fixed = np.concatenate([each @ kicks for each in kicked])
            own = np.linalg.lstsq(np.vstack(decays), target - fixed, rcond=None)[0]
            found = np.concatenate((own, kicks))
        shape = self.shape(poles, found[:4])
        kicked_pairs = tuple((float(c), float(d)) for c, d in found[4:].reshape(-1, 2))
        peak = shape.peak + _largest_kick(kicked_pairs)
        errors = [self.error(list(each.T), found, onset) for each, onset in zip(columns, _ONSET_FRACTIONS, strict=True)]
        shape = replace(shape, peak=peak, error=errors[0], limited=peak > MAX_STRIKE_FORCE_RATIO, kicks=kicked_pairs)
        return shape, root_mean_square(errors)

    def bounded(self, shape: Shape, rows: _Floats, bounds: _Floats) -> Shape | None:
        """Return the shape with the poles and kicks of `shape` that has the least displayed error within bounds.

        The gains satisfy rows @ gains <= bounds. Returns None if no gains do.
        """
        poles = [part.pole for part in shape.parts]
        columns = [np.array(self.columns(poles, onset)).T for onset in self._onsets]
        targets = [self.target(onset) - self._kicked(shape, onset) for onset in self._onsets]
        gains = bounded_least_squares(np.vstack(columns), np.concatenate(targets), rows, bounds)
        if gains is None:
            return None
        found = self.shape(poles, gains)
        if not shape.kicks:
            return found
        error = float(np.linalg.norm(columns[0] @ gains - targets[0])) / self._grid.target_norm
        peak = found.peak + _largest_kick(shape.kicks)
        return replace(found, peak=peak, error=error, kicks=shape.kicks)

    def _kicked(self, shape: Shape, onset: float) -> _Floats:
        """Return the acceleration by the kicks of a shape."""
        kicks = [(c + d * onset) * self._base[:, self._kicks + k] for k, (c, d) in enumerate(shape.kicks)]
        return np.asarray(np.sum(kicks, axis=0), np.float64)

    def error_over(self, onsets: tuple[float, ...], parts: Sequence[Ringing]) -> float:
        """Return the displayed error of a force that has these parts and no kicks, RMS over the onsets."""
        poles = [part.pole for part in parts]
        gains = np.array([x for part in parts for x in (part.gain.real, part.gain.imag)])
        return root_mean_square([self.error(self.columns(poles, onset), gains, onset) for onset in onsets])


def bounded_least_squares(columns: _Floats, target: _Floats, rows: _Floats, bounds: _Floats) -> _Floats | None:
    """Return the x with rows @ x <= bounds that has the least |columns @ x - target|.

    Returns None if there is none, or if the columns are dependent: the sampled mode is too short.

    With columns = Q R this is the least z = R x - Q' target with rows R^-1 z <= bounds - rows R^-1 Q' target, and that
    is a least-squares problem with non-negative unknowns (Lawson and Hanson 1974, chapter 23).
    """
    scale = np.linalg.norm(columns, axis=0)
    if not scale.all():
        return None
    base, triangle = np.linalg.qr(columns / scale)
    if np.abs(np.diag(triangle)).min() < _MIN_INDEPENDENCE:
        return None
    inverse = np.linalg.inv(triangle)
    free = base.T @ target
    limits, excess = rows / scale @ inverse, rows / scale @ inverse @ free - bounds
    if (excess <= 0.0).all():
        return np.asarray(inverse @ free / scale, np.float64)
    size = np.linalg.norm(limits, axis=1)
    limits, excess = limits / size[:, None], excess / size
    longest = float(np.abs(excess).max())
    stacked = np.vstack((-limits.T, excess / longest))
    residual = stacked @ _non_negative(stacked) - np.eye(len(stacked))[-1]
    if abs(residual[-1]) < 1e-12:
        return None
    return np.asarray(inverse @ (free - longest * residual[:-1] / residual[-1]) / scale, np.float64)


def _non_negative(columns: _Floats) -> _Floats:
    """Return the x >= 0 with the least |columns @ x - e|, where e is the last unit vector (Lawson and Hanson)."""
    target = np.eye(len(columns))[-1]
    x, used = np.zeros(columns.shape[1]), np.zeros(columns.shape[1], bool)
    for _ in range(3 * columns.shape[1]):
        slope = columns.T @ (target - columns @ x)
        slope[used] = 0.0
        if not slope.max() > 1e-12:
            break
        used[slope.argmax()] = True
        while True:
            tried = np.zeros_like(x)
            tried[used] = np.linalg.lstsq(columns[:, used], target, rcond=None)[0]
            falling = used & (tried <= 0.0)
            if not falling.any():
                break
            x += float((x[falling] / (x[falling] - tried[falling])).min()) * (tried - x)
            used &= x > 1e-15
            x[~used] = 0.0
        x = tried
    return x


@lru_cache(maxsize=8)
def _band(
    mode: Mode, dynamics: Dynamics, rate_hz: float, load: Load, tails: tuple[complex, ...], with_kicks: bool
) -> _Band:
    """Return a band, cached because several shapes with the same poles are designed in a row."""
    return _Band(mode, dynamics, rate_hz, load, tails, with_kicks)


def _largest_kick(kicks: tuple[tuple[float, float], ...]) -> float:
    """Return the largest magnitude of the kicks, for any onset in the period before the first sample."""
    return max(max(abs(c), abs(c + d)) for c, d in kicks)


def root_mean_square(errors: Sequence[float]) -> float:
    """Return the root of the mean of the squares."""
    return math.sqrt(sum(error**2 for error in errors) / len(errors))


def _peak(sounding: Sequence[Ringing]) -> tuple[float, float]:
    """Return an upper bound of the magnitude of the sum of signals over all times, and the time of the largest sample.

    Between two samples at a distance h, a function exceeds the larger one by at most h^2/8 times its largest curvature.
    """
    highest, where, begin = 0.0, 0.0, 0.0
    for end in sorted({each.end_s for each in sounding}):
        here = [each for each in sounding if each.end_s >= end]
        time = np.linspace(begin, end, _PEAK_GRID_SAMPLES)
        sounds = ((each.gain * np.exp(each.pole * time)).imag for each in here)
        value = np.abs(sum(sounds, np.zeros(_PEAK_GRID_SAMPLES)))
        curvature = sum(abs(each.gain) * abs(each.pole) ** 2 for each in here)
        sampled = float(value.max())
        bound = min(sampled + (time[1] - time[0]) ** 2 / 8 * curvature, sum(abs(each.gain) for each in here))
        if bound > highest:
            highest, where = bound, float(time[value.argmax()])
        begin = end
    return highest, where


def _tails(mode: Mode, rate_hz: float) -> list[complex]:
    """Return the poles of the tails (second decaying part of a strike's force) to try.

    A slow tail compensates the transient of the hand's spring and damper, a fast one that of the first held samples.
    """
    slow = _MODE_TIME_CONSTANTS / (_MODE_TIME_CONSTANTS / mode.decay_rate_per_s + MAX_TAIL_EXTENSION_S)
    highest = 2 * math.pi * ERROR_BAND_RATE_FRACTION * rate_hz
    return [complex(-slow, min(slow / 2, highest)), complex(-3 * mode.decay_rate_per_s, highest)]


def pole_shape(mode: Mode, dynamics: Dynamics, rate_hz: float, gain: complex, load: Load = NO_LOAD) -> Shape:
    """Return the force's shape with the mode's pole alone, with this gain in units of (m + m_h)."""
    return _Band(mode, dynamics, rate_hz, load).alone(gain)


def part_shown(mode: Mode, dynamics: Dynamics, rate_hz: float, shape: Shape, load: Load = NO_LOAD) -> complex:
    """Return the complex fraction, ideally 1, of a mode in the handle's acceleration in the band, for this shape."""
    grid = _grid(mode, rate_hz)
    struck = np.zeros_like(grid.target)
    for ringing in shape.parts:
        one, other = grid.pair(ringing.pole, grid.count(ringing.pole, 0.0))
        struck = struck + ringing.gain.real * one + ringing.gain.imag * other
    for spectrum, (kick, _) in zip(grid.kick_spectra, shape.kicks, strict=False):
        struck = struck + kick * spectrum
    return complex(np.vdot(grid.target, grid.response(dynamics, load) * struck)) / grid.target_norm**2


@lru_cache(maxsize=4096)
def shape_of(
    mode: Mode, dynamics: Dynamics, rate_hz: float, compensation: Literal["mass", "full"], load: Load = NO_LOAD
) -> Shape:
    """Return the force's shape for a strike of a mode whose frequency is at most 0.4 of the rate.

    `rate_hz` is how often the force changes at the device. `compensation: full` takes some milliseconds.
    """
    if compensation == "mass":
        return _Band(mode, dynamics, rate_hz, load).by_hold_gain()
    tails = _tails(mode, rate_hz)
    long = 1 / mode.decay_rate_per_s >= 2 * MAX_CORRECTED_SAMPLES / rate_hz / _MODE_TIME_CONSTANTS
    kickable = long and mode.frequency_hz >= MIN_KICK_RATE_FRACTION * rate_hz and not load.slow_link
    band = _Band(mode, dynamics, rate_hz, load, tails, kickable)
    plain, best = band.plain(), min(map(band.with_tail, tails), key=lambda shape: shape.error)
    best = best if best.error < plain.error - MIN_TAIL_ERROR_REDUCTION else plain
    if not kickable:
        return best
    kicked, kicked_error = band.with_kicks(tails[0])
    if kicked.limited or kicked_error >= band.error_over(_ONSET_FRACTIONS, best.parts) - MIN_KICK_ERROR_REDUCTION:
        return best
    return kicked


@lru_cache(maxsize=4096)
def shapes_of(
    mode: Mode,
    dynamics: Dynamics,
    rate_hz: float,
    compensation: Literal["mass", "full"],
    load: Load,
    best_in_contact: bool,
) -> tuple[Shape, Shape]:
    """Return two shapes of a strike's force, with the same poles: without a surface, and against that of `load`.

    With `best_in_contact`, the poles are those with the smallest error against the surface, otherwise without it. Gains
    are linear in the stiffness of the surface, so the core interpolates linearly between the two shapes.
    """
    if compensation == "mass" or load == load.free:
        chosen = shape_of(mode, dynamics, rate_hz, compensation, load)
        return chosen, chosen
    first, second = (load, load.free) if best_in_contact else (load.free, load)
    chosen = shape_of(mode, dynamics, rate_hz, compensation, first)
    other = with_poles_of(chosen, mode, dynamics, rate_hz, second)
    return (other, chosen) if best_in_contact else (chosen, other)


def with_poles_of(chosen: Shape, mode: Mode, dynamics: Dynamics, rate_hz: float, load: Load) -> Shape:
    """Return the shape with the poles and kicks of `chosen` that has the least displayed error against `load`."""
    tail = () if chosen.tail is None else (chosen.tail.pole,)
    band = _Band(mode, dynamics, rate_hz, load, tail, bool(chosen.kicks))
    if not tail:
        return band.plain()
    if chosen.kicks:
        return band.with_kicks(*tail, np.array(chosen.kicks).ravel())[0]
    return band.with_tail(*tail)


def bounded_shape(
    mode: Mode, dynamics: Dynamics, rate_hz: float, load: Load, shape: Shape, rows: _Floats, bounds: _Floats
) -> Shape | None:
    """Return the shape with the poles and kicks of `shape` whose gains have the least displayed error against `load`.

    The gains satisfy rows @ gains <= bounds; they are real and imaginary part of the mode's gain, then of the tail's.
    Returns None if no gains satisfy that.
    """
    tails = tuple(part.pole for part in shape.parts[1:])
    return _band(mode, dynamics, rate_hz, load, tails, bool(shape.kicks)).bounded(shape, rows, bounds)


def tuned_shapes(
    modes: Sequence[Mode],
    dynamics: Dynamics,
    rate_hz: float,
    compensation: Literal["mass", "full"],
    load: Load,
    best_in_contact: bool,
) -> list[tuple[Shape, Shape]]:
    """Return both shapes of a strike (shapes_of) for each of `modes`, which change gradually from one to the next.

    No shape has kicks. Either no shape has a tail, or all tails have the same pole.
    """
    if compensation == "mass":
        plain = [shape_of(mode, dynamics, rate_hz, compensation, load) for mode in modes]
        return [(shape, shape) for shape in plain]
    tails = _tails(modes[len(modes) // 2], rate_hz)
    loads = (load, load.free) if best_in_contact else (load.free, load)
    first, second = ([_Band(mode, dynamics, rate_hz, each, tails) for mode in modes] for each in loads)
    # Designs with each of the two tails, and without a tail with either of two gains.
    designs: list[Callable[[_Band], Shape]] = [
        *(partial(_Band.with_tail, tail=tail) for tail in tails),
        _Band.by_hold_gain,
        _Band.by_pole_gain,
    ]
    found = [[design(band) for band in first] for design in designs]
    errors = [sum(shape.error for shape in shapes) / len(modes) for shapes in found]
    tailed, plainer = min((0, 1), key=errors.__getitem__), min((2, 3), key=errors.__getitem__)
    best = tailed if errors[tailed] < errors[plainer] - MIN_TAIL_ERROR_REDUCTION else plainer
    others = [designs[best](band) for band in second]
    return list(zip(others, found[best], strict=True) if best_in_contact else zip(found[best], others, strict=True))


def peak_between(one: Shape, other: Shape) -> float:
    """Return the peak of the force half way between two shapes of strikes, divided by the mean of their peaks.

    The shape half way has the means of the gains and of the modes' poles.
    """
    sounding = [Ringing((one.mode.pole + other.mode.pole) / 2, (one.mode.gain + other.mode.gain) / 2)]
    if one.tail is not None and other.tail is not None:
        sounding.append(Ringing(one.tail.pole, (one.tail.gain + other.tail.gain) / 2))
    return _peak(sounding)[0] / ((one.peak + other.peak) / 2)
