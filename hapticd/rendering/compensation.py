"""What is struck for a mode, so that handle and hand accelerate as the library says.

A force F held from tick to tick accelerates the device (m + m_h) x'' + (b + b_h) x' + k x = F by

    X(s) = s^2 / ((m + m_h) s^2 + (b + b_h) s + k) * (1 - exp(-s T))/s * sum_k F_k exp(-s k T),      s = 2 pi i f.

Wanted is the spectrum of exp(-B t) sin(w t), w / ((s + B)^2 + w^2). The pole p = -B + i w alone is displayed with the
right amplitude and phase where F_k = Im(C exp(p k T)),

    C = ((m + m_h) + (b + b_h)/p + k/p^2) * p T / (1 - exp(-p T)),

but a device that was at rest answers with a transient, too. `full` adds a tail, a second decaying pole, and chooses
both complex amplitudes by least squares over the band in which the error is reported.

A surface that is touched meanwhile acts on the handle, too: what it does to a motion, held and lagging as every force,
is part of the device. So is the lag of the actuator, by which every force goes.
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

from hapticd.base.core import MAX_CORRECTED_SAMPLES as _CORE_KICKS
from hapticd.config.actuator import Actuator
from hapticd.config.dynamics import Dynamics
from hapticd.config.modes import Mode

LOW_HZ: Final = 30.0
"""The error is reported from here on; below, the hand's own motion is."""
HIGH: Final = 0.4
"""It is reported up to this fraction of the rate."""
LARGEST: Final = 2.0
"""No strike is given a force of more than this times (m + m_h) A."""
TAIL_S: Final = 0.05
"""A tail ends at most this much later than its mode."""
WORTH: Final = 0.005
"""A tail that lowers the error by less than this is left away: it costs an active mode."""

KICKS: Final = _CORE_KICKS
"""So many samples after an onset may be corrected one by one, by what is known of its place between two ticks."""
KICKED: Final = 0.05
"""Modes from this part of the rate on are: of others the first samples hold little."""
KICKS_WORTH: Final = 0.01
"""They are left away where they lower the error over all onsets by less than this."""

_ONSETS: Final = (0.0, 0.25, 0.5, 0.75, 1.0)
_TIME_CONSTANTS: Final = 5.0
_PEAK_SAMPLES: Final = 512

_Complex: TypeAlias = npt.NDArray[np.complex128]
_Floats: TypeAlias = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Load:
    """What a strike meets beside handle and hand: the surface along its direction, and the actuator."""

    stiffness_n_per_m: float = 0.0
    damping_n_s_per_m: float = 0.0
    age_s: float = 0.0
    """Between a position and the surface's force that answers it."""
    actuator: Actuator | None = None

    @property
    def free(self) -> Load:
        """The same where nothing is touched."""
        return Load(actuator=self.actuator)

    def lag(self, s: _Complex) -> _Complex:
        """What the actuator makes of a force."""
        return np.ones_like(s) if self.actuator is None else self.actuator.response(s)

    def surface(self, s: _Complex, period_s: float) -> _Complex:
        """Force of the surface over minus the position, N/m: sampled, damping by differences, held for a period."""
        if self.stiffness_n_per_m == 0.0 and self.damping_n_s_per_m == 0.0:
            return np.zeros_like(s)
        turned = -np.expm1(-s * period_s) / period_s
        sampled = self.stiffness_n_per_m + self.damping_n_s_per_m * turned
        return np.asarray(sampled * turned / s * np.exp(-s * self.age_s) * self.lag(s), np.complex128)


NOTHING: Final = Load()


@dataclass(frozen=True, slots=True)
class Ringing:
    """Im(gain exp(pole t)) for 0 <= t <= end_s, then nothing."""

    pole: complex
    gain: complex

    @property
    def end_s(self) -> float:
        """Five time constants, as of every mode."""
        return _TIME_CONSTANTS / -self.pole.real


@dataclass(frozen=True, slots=True)
class Shape:
    """The force of a strike, in units of (m + m_h) A, that begins at a tick."""

    mode: Ringing
    tail: Ringing | None
    peak: float
    """No sample of it is larger, wherever the onset lies between two ticks."""
    peak_time_s: float
    error: float
    """Displayed error: RMS of what the handle's acceleration differs by, over the RMS of the mode, in the band."""
    limited: bool
    """It would have to be larger than LARGEST, and was scaled back to that."""
    kicks: tuple[tuple[float, float], ...] = ()
    """Added to the first samples, one each: (c, d) is c + d x, the onset x of a period before the first of them."""


def pole_of(mode: Mode) -> complex:
    """-B + i w."""
    return complex(-mode.decay_rate_per_s, mode.angular_frequency_rad_per_s)


def hold_gain(pole: complex, period_s: float) -> complex:
    """p T / (1 - exp(-p T)): what makes up for a force that is held for a period."""
    turned = cmath.exp(pole * period_s)  # at most 1, where exp(-p T) may be beyond all numbers
    return pole * period_s * turned / (turned - 1)


def pole_gain(mode: Mode, dynamics: Dynamics, period_s: float, load: Load = NOTHING) -> complex:
    """C of the equation above, over (m + m_h)."""
    p = pole_of(mode)
    at = np.array([p], np.complex128)
    with np.errstate(over="ignore", invalid="ignore"):
        met = complex(load.surface(at, period_s)[0])
    # A mode that is over within a tick meets nothing.
    stiffness = dynamics.grip_stiffness_n_per_m + (met if cmath.isfinite(met) else 0.0)
    device = 1 + (dynamics.damping_n_s_per_m / p + stiffness / p**2) / dynamics.mass_kg
    return device * hold_gain(p, period_s) / complex(load.lag(at)[0])


class _Grid:
    """The band of one mode, sampled; `weight` is the square root of the quadrature's. Sums of ticks are kept."""

    def __init__(self, mode: Mode, rate_hz: float) -> None:
        high = HIGH * rate_hz
        low = min(LOW_HZ, mode.frequency_hz / 2, high / 2)
        # Even steps see the ends of what was cut, even ratios the device, and the rest a mode that hardly decays.
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
        self.wanted: _Complex = self.weight * p.imag / ((self.s - p) * (self.s - p.conjugate()))
        self.wanted_norm = float(np.linalg.norm(self.wanted))
        self._pairs: dict[tuple[complex, int], tuple[_Complex, _Complex]] = {}
        self._below: dict[complex, _Complex] = {}

    @cached_property
    def late(self) -> list[_Complex]:
        """exp(-s k T) of the first samples."""
        return [np.exp(-self.s * k * self.period_s) for k in range(KICKS)]

    @cached_property
    def early(self) -> list[_Complex]:
        """What is wanted, for each of the onsets, as seen from the first tick."""
        return [self.wanted * np.exp(self.s * part * self.period_s) for part in _ONSETS]

    def response(self, dynamics: Dynamics, load: Load) -> _Complex:
        """The acceleration of the device for what is struck, weighted."""
        stiffness, damping = dynamics.grip_stiffness_n_per_m, dynamics.damping_n_s_per_m
        device = (dynamics.mass_kg * self.s + damping) * self.s + stiffness
        hold = (1 - np.exp(-self.s * self.period_s)) / self.s
        if load != NOTHING:
            device = device + load.surface(self.s, self.period_s)
            hold = hold * load.lag(self.s)
        return np.asarray(self.weight * (dynamics.mass_kg * self.s**2 / device * hold), np.complex128)

    def count(self, pole: complex, part: float) -> int:
        """Of the ticks up to five time constants, the first of them `part` of a period after the onset."""
        late_s = part * self.period_s
        return math.floor((_TIME_CONSTANTS / -pole.real - late_s) / self.period_s + 1e-9) + 1

    def pair(self, pole: complex, count: int) -> tuple[_Complex, _Complex]:
        """The spectra of Im(exp(p t)) and of Re(exp(p t)) at so many ticks."""
        found = self._pairs.get((pole, count))
        if found is None:
            one, other = self._sum(pole, count), self._sum(pole.conjugate(), count)
            found = self._pairs[pole, count] = (one - other) / 2j, (one + other) / 2
        return found

    def _sum(self, pole: complex, count: int) -> _Complex:
        """Of exp((p - s) k T) over k < count."""
        step = (pole - self.s) * self.period_s
        below = self._below.get(pole)
        if below is None:
            below = self._below[pole] = np.asarray(np.expm1(step), np.complex128)
        return np.asarray(np.expm1(count * step) / below, np.complex128)


@lru_cache(maxsize=4)
def _grid(mode: Mode, rate_hz: float) -> _Grid:
    """A mode is designed for several loads, one after the other."""
    return _Grid(mode, rate_hz)


class _Band:
    """What a mode and some tails, when they are struck, accelerate one device by, seen from their first tick.

    All of it, weighted, lies in a space of few dimensions: vectors are coordinates in an orthonormal base of it, in
    which least squares and norms are what they are over the whole band. From the first tick all onsets see the same
    but for the place of what is wanted and for how many ticks there are.
    """

    def __init__(
        self,
        mode: Mode,
        dynamics: Dynamics,
        rate_hz: float,
        load: Load,
        tails: Sequence[complex] = (),
        attacked: bool = False,
    ) -> None:
        """`attacked`: onsets are anywhere between two ticks, and kicks too."""
        grid = self._grid = _grid(mode, rate_hz)
        self._made_for = mode, dynamics, load
        self._pole = pole_of(mode)
        response = grid.response(dynamics, load)
        self._parts = _ONSETS if attacked else _ONSETS[:1]
        self._rung: dict[tuple[complex, int], int] = {}
        spectra: list[_Complex] = []
        for pole in (self._pole, *tails):
            for count in sorted({grid.count(pole, part) for part in self._parts}):
                self._rung[pole, count] = len(spectra)
                spectra += [response * each for each in grid.pair(pole, count)]
        self._kicks = len(spectra)
        if attacked:
            spectra += [response * each for each in grid.late]
        self._wanted = len(spectra)
        spectra += [grid.wanted] if not attacked else grid.early
        whole = np.array(spectra)
        stacked = np.concatenate((whole.real, whole.imag), axis=1).T
        self._base: _Floats = np.asarray(np.linalg.qr(stacked, mode="r"), np.float64)

    def wanted(self, part: float = 0.0) -> _Floats:
        """The acceleration of the mode, for an onset `part` of a period before the first tick."""
        return np.asarray(self._base[:, self._wanted + self._parts.index(part)], np.float64)

    def columns(self, poles: Sequence[complex], part: float = 0.0) -> list[_Floats]:
        """The acceleration for Im(exp(p t)) and for Re(exp(p t)) of each pole, of the ticks up to five time constants,
        the first of them `part` of a period after the onset."""
        found = []
        for pole in poles:
            at = self._rung[pole, self._grid.count(pole, part)]
            begun = cmath.exp(pole * part * self._grid.period_s)
            sine, cosine = self._base[:, at], self._base[:, at + 1]
            found += [begun.real * sine + begun.imag * cosine, begun.real * cosine - begun.imag * sine]
        return found

    def error(self, columns: list[_Floats], gains: _Floats, part: float = 0.0) -> float:
        """Of these gains, Re and Im of each pole in turn."""
        return float(np.linalg.norm(gains @ np.array(columns) - self.wanted(part))) / self._grid.wanted_norm

    def shape(self, poles: Sequence[complex], gains: _Floats) -> Shape:
        """Of these gains, scaled back to LARGEST."""
        ringing = [Ringing(pole, complex(*gains[2 * i : 2 * i + 2])) for i, pole in enumerate(poles)]
        mode, tail = ringing[0], ringing[1] if len(ringing) > 1 else None
        peak, peak_time_s = _peak(mode, tail)
        limited = peak > LARGEST
        if limited:
            factor = LARGEST / peak
            mode = Ringing(mode.pole, factor * mode.gain)
            tail = None if tail is None else Ringing(tail.pole, factor * tail.gain)
            gains, peak = factor * gains, LARGEST
        return Shape(mode, tail, peak, peak_time_s, self.error(self.columns(poles), gains), limited)

    def alone(self, gain: complex) -> Shape:
        """The mode's pole alone, with this gain."""
        return self.shape([self._pole], np.array([gain.real, gain.imag]))

    def by_hold_gain(self) -> Shape:
        """The mode's pole alone, with the gain that makes up for hold and actuator."""
        _, _, load = self._made_for
        lag = complex(load.lag(np.array([self._pole], np.complex128))[0])
        return self.alone(hold_gain(self._pole, self._grid.period_s) / lag)

    def by_pole_gain(self) -> Shape:
        """The mode's pole alone, with the gain C."""
        mode, dynamics, load = self._made_for
        return self.alone(pole_gain(mode, dynamics, self._grid.period_s, load))

    def plain(self) -> Shape:
        """Of the mode's pole alone, what leaves less."""
        return min(self.by_hold_gain(), self.by_pole_gain(), key=lambda shape: shape.error)

    def tailed(self, tail: complex) -> Shape:
        """Gain and tail together, by least squares."""
        poles = [self._pole, tail]
        gains = np.linalg.lstsq(np.array(self.columns(poles)).T, self.wanted(), rcond=None)[0]
        return self.shape(poles, np.asarray(gains, np.float64))

    def attacked(self, tail: complex, kicks: _Floats | None = None) -> tuple[Shape, float]:
        """Gain, tail and kicks together, by least squares over onsets anywhere between two ticks, and the displayed
        error over them, RMS. With `kicks` given, only gain and tail."""
        poles = [self._pole, tail]
        rung = [np.array(self.columns(poles, part)).T for part in _ONSETS]
        # For 1 and for `part` in each of the first samples alone.
        late = [self._base[:, self._kicks + k] for k in range(KICKS)]
        kicked = [np.array([scale * each for each in late for scale in (1.0, part)]).T for part in _ONSETS]
        wanted = np.concatenate([self.wanted(part) for part in _ONSETS])
        whole = [np.hstack(pair) for pair in zip(rung, kicked, strict=True)]
        if kicks is None:
            found: _Floats = np.asarray(np.linalg.lstsq(np.vstack(whole), wanted, rcond=None)[0], np.float64)
        else:
            fixed = np.concatenate([each @ kicks for each in kicked])
            own = np.linalg.lstsq(np.vstack(rung), wanted - fixed, rcond=None)[0]
            found = np.concatenate((own, kicks))
        shape = self.shape(poles, found[:4])
        pairs = found[4:].reshape(-1, 2)
        peak = shape.peak + float(max(np.abs(pairs[:, 0]).max(), np.abs(pairs.sum(1)).max()))
        errors = [self.error(list(each.T), found, part) for each, part in zip(whole, _ONSETS, strict=True)]
        kicked_pairs = tuple((float(c), float(d)) for c, d in pairs)
        shape = replace(shape, peak=peak, error=errors[0], limited=peak > LARGEST, kicks=kicked_pairs)
        return shape, _root_mean_square(errors)

    def anywhere(self, shape: Shape) -> float:
        """The displayed error of a shape without kicks over the same onsets, RMS."""
        sounding = [shape.mode] if shape.tail is None else [shape.mode, shape.tail]
        poles = [each.pole for each in sounding]
        gains = np.array([x for each in sounding for x in (each.gain.real, each.gain.imag)])
        return _root_mean_square([self.error(self.columns(poles, part), gains, part) for part in _ONSETS])


def _root_mean_square(errors: list[float]) -> float:
    return math.sqrt(sum(error**2 for error in errors) / len(errors))


def _peak(mode: Ringing, tail: Ringing | None) -> tuple[float, float]:
    """A bound of the magnitude over all times, and where it is nearly reached.

    Between samples h apart, a function is at most h^2/8 times its largest curvature above them.
    """
    sounding = [mode] if tail is None else [mode, tail]
    highest, where, begin = 0.0, 0.0, 0.0
    for end in sorted({each.end_s for each in sounding}):
        here = [each for each in sounding if each.end_s >= end]
        time = np.linspace(begin, end, _PEAK_SAMPLES)
        sounds = ((each.gain * np.exp(each.pole * time)).imag for each in here)
        value = np.abs(sum(sounds, np.zeros(_PEAK_SAMPLES)))
        curvature = sum(abs(each.gain) * abs(each.pole) ** 2 for each in here)
        least = float(value.max())
        bound = min(least + (time[1] - time[0]) ** 2 / 8 * curvature, sum(abs(each.gain) for each in here))
        if bound > highest:
            highest, where = bound, float(time[value.argmax()])
        begin = end
    return highest, where


def _tails(mode: Mode, rate_hz: float) -> list[complex]:
    """Poles of the tails that are tried: slow and long for what the hand's spring and damper leave, and as fast as the
    band for what the first held samples leave."""
    slow = _TIME_CONSTANTS / (_TIME_CONSTANTS / mode.decay_rate_per_s + TAIL_S)
    highest = 2 * math.pi * HIGH * rate_hz
    return [complex(-slow, min(slow / 2, highest)), complex(-3 * mode.decay_rate_per_s, highest)]


def pole_shape(mode: Mode, dynamics: Dynamics, rate_hz: float, gain: complex, load: Load = NOTHING) -> Shape:
    """The mode's pole alone, with this gain in units of (m + m_h)."""
    return _Band(mode, dynamics, rate_hz, load).alone(gain)


def part_shown(mode: Mode, dynamics: Dynamics, rate_hz: float, shape: Shape, load: Load = NOTHING) -> complex:
    """How much of the waveform the handle's acceleration contains, in the band: 1 where it is all of it. `shape` begins
    at a tick."""
    grid = _grid(mode, rate_hz)
    struck = np.zeros_like(grid.wanted)
    for ringing in (shape.mode, shape.tail):
        if ringing is not None:
            one, other = grid.pair(ringing.pole, grid.count(ringing.pole, 0.0))
            struck = struck + ringing.gain.real * one + ringing.gain.imag * other
    for late, (kick, _) in zip(grid.late, shape.kicks, strict=False):
        struck = struck + kick * late
    return complex(np.vdot(grid.wanted, grid.response(dynamics, load) * struck)) / grid.wanted_norm**2


@lru_cache(maxsize=4096)
def shape_of(
    mode: Mode, dynamics: Dynamics, rate_hz: float, compensation: Literal["mass", "full"], load: Load = NOTHING
) -> Shape:
    """What is struck for a mode that the rate can carry; `rate_hz` is how often the force changes at the device.

    Deterministic. `full` takes a few milliseconds, once.
    """
    if compensation == "mass":
        return _Band(mode, dynamics, rate_hz, load).by_hold_gain()
    tails = _tails(mode, rate_hz)
    long = 1 / mode.decay_rate_per_s >= 2 * KICKS / rate_hz / _TIME_CONSTANTS
    attacked = long and mode.frequency_hz >= KICKED * rate_hz
    band = _Band(mode, dynamics, rate_hz, load, tails, attacked)
    plain, best = band.plain(), min(map(band.tailed, tails), key=lambda shape: shape.error)
    best = best if best.error < plain.error - WORTH else plain
    if not attacked:
        return best
    kicked, anywhere = band.attacked(tails[0])
    return kicked if not kicked.limited and anywhere < band.anywhere(best) - KICKS_WORTH else best


@lru_cache(maxsize=4096)
def shapes_of(
    mode: Mode, dynamics: Dynamics, rate_hz: float, compensation: Literal["mass", "full"], load: Load, own: bool
) -> tuple[Shape, Shape]:
    """What is struck where nothing is touched, and against the surface of `load`, with the same poles: those that are
    best against the surface where it is the mode's `own`, else those that are best without.

    C is linear in the stiffness that is met: in between, and somewhat beyond, straight lines do for both.
    """
    if compensation == "mass" or load == load.free:
        chosen = shape_of(mode, dynamics, rate_hz, compensation, load)
        return chosen, chosen
    first, second = (load, load.free) if own else (load.free, load)
    chosen = shape_of(mode, dynamics, rate_hz, compensation, first)
    tail = () if chosen.tail is None else (chosen.tail.pole,)
    band = _Band(mode, dynamics, rate_hz, second, tail, bool(chosen.kicks))
    if not tail:
        other = band.plain()
    elif chosen.kicks:
        other = band.attacked(*tail, np.array(chosen.kicks).ravel())[0]
    else:
        other = band.tailed(*tail)
    return (other, chosen) if own else (chosen, other)


def tuned_shapes(
    modes: Sequence[Mode],
    dynamics: Dynamics,
    rate_hz: float,
    compensation: Literal["mass", "full"],
    load: Load,
    own: bool,
) -> list[tuple[Shape, Shape]]:
    """As shapes_of, of modes that change steadily from one to the next.

    All have the poles of the same tail, or none has one, and none has kicks: so gains change steadily, too.
    """
    if compensation == "mass":
        plain = [shape_of(mode, dynamics, rate_hz, compensation, load) for mode in modes]
        return [(shape, shape) for shape in plain]
    tails = _tails(modes[len(modes) // 2], rate_hz)
    loads = (load, load.free) if own else (load.free, load)
    first, second = ([_Band(mode, dynamics, rate_hz, each, tails) for mode in modes] for each in loads)
    # Each of two tails, or none.
    ways: list[Callable[[_Band], Shape]] = [
        *(partial(_Band.tailed, tail=tail) for tail in tails),
        _Band.by_hold_gain,
        _Band.by_pole_gain,
    ]
    found = [[way(band) for band in first] for way in ways]
    errors = [sum(shape.error for shape in shapes) / len(modes) for shapes in found]
    tailed, plainer = min((0, 1), key=errors.__getitem__), min((2, 3), key=errors.__getitem__)
    best = tailed if errors[tailed] < errors[plainer] - WORTH else plainer
    others = [ways[best](band) for band in second]
    return list(zip(others, found[best], strict=True) if own else zip(found[best], others, strict=True))


def peak_between(one: Shape, other: Shape) -> float:
    """The peak of what lies half way between two shapes, at the pole half way between theirs, over that of the straight
    line between their peaks."""
    mode = Ringing((one.mode.pole + other.mode.pole) / 2, (one.mode.gain + other.mode.gain) / 2)
    tail = None
    if one.tail is not None and other.tail is not None:
        tail = Ringing(one.tail.pole, (one.tail.gain + other.tail.gain) / 2)
    return _peak(mode, tail)[0] / ((one.peak + other.peak) / 2)
