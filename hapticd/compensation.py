"""What is struck for a mode, so that handle and hand accelerate as the library says.

A force F held from tick to tick accelerates the device (m + m_h) x'' + (b + b_h) x' + k x = F by

    X(s) = s^2 / ((m + m_h) s^2 + (b + b_h) s + k) * (1 - exp(-s T))/s * sum_k F_k exp(-s k T),      s = 2 pi i f.

Wanted is the spectrum of exp(-B t) sin(w t), w / ((s + B)^2 + w^2). The pole p = -B + i w alone is displayed with the
right amplitude and phase where F_k = Im(C exp(p k T)),

    C = ((m + m_h) + (b + b_h)/p + k/p^2) * p T / (1 - exp(-p T)),

but a device that was at rest answers with a motion of its own. `full` adds a tail, a second decaying pole, and chooses
both complex amplitudes by least squares over the band in which the error is told.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from hapticd.dynamics import Dynamics
from hapticd.mode import Mode

Compensation: TypeAlias = Literal["off", "mass", "full"]

LOW_HZ: Final = 30.0
"""The error is told from here on; below, the hand's own motion is."""
HIGH: Final = 0.4
"""It is told up to this fraction of the rate."""
LARGEST: Final = 2.0
"""No strike is given a force of more than this times (m + m_h) A."""
TAIL_S: Final = 0.05
"""A tail ends at most this much later than its mode."""
WORTH: Final = 0.005
"""A tail that lowers the error by less than this is left away: it costs a voice."""

_TIME_CONSTANTS: Final = 5.0
_PEAK_SAMPLES: Final = 512

_Complex: TypeAlias = npt.NDArray[np.complex128]
_Floats: TypeAlias = npt.NDArray[np.float64]


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


def pole_of(mode: Mode) -> complex:
    """-B + i w."""
    return complex(-mode.decay_rate_per_s, mode.angular_frequency_rad_per_s)


def hold_gain(pole: complex, period_s: float) -> complex:
    """p T / (1 - exp(-p T)): what makes up for a force that is held for a period."""
    turned = cmath.exp(pole * period_s)  # at most 1, where exp(-p T) may be beyond all numbers
    return pole * period_s * turned / (turned - 1)


def pole_gain(mode: Mode, dynamics: Dynamics, period_s: float) -> complex:
    """C of the equation above, over (m + m_h)."""
    p = pole_of(mode)
    device = 1 + (dynamics.damping_n_s_per_m / p + dynamics.grip_stiffness_n_per_m / p**2) / dynamics.mass_kg
    return device * hold_gain(p, period_s)


class _Band:
    """Spectra of one mode on one device, sampled over the band; `weight` is the square root of the quadrature's."""

    def __init__(self, mode: Mode, dynamics: Dynamics, rate_hz: float) -> None:
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
        self._s: _Complex = np.asarray(2j * np.pi * frequency, np.complex128)
        self._period_s = 1 / rate_hz
        stiffness, damping = dynamics.grip_stiffness_n_per_m, dynamics.damping_n_s_per_m
        device = (dynamics.mass_kg * self._s + damping) * self._s + stiffness
        hold = (1 - np.exp(-self._s * self._period_s)) / self._s
        self._response: _Complex = dynamics.mass_kg * self._s**2 / device * hold
        p = pole_of(mode)
        self.wanted = self._real(p.imag / ((self._s - p) * (self._s - p.conjugate())))
        self.wanted_norm = float(np.linalg.norm(self.wanted))

    def _real(self, spectrum: _Complex) -> _Floats:
        """Weighted, real parts before imaginary ones: what least squares takes."""
        weighted = self.weight * spectrum
        return np.concatenate((weighted.real, weighted.imag))

    def columns(self, pole: complex) -> list[_Floats]:
        """The acceleration for Im(exp(p k T)) and for Re(exp(p k T)), of the ticks up to five time constants."""
        count = math.floor(_TIME_CONSTANTS / -pole.real / self._period_s + 1e-9) + 1
        one, other = (self._sum(each, count) for each in (pole, pole.conjugate()))
        return [self._real(self._response * (one - other) / 2j), self._real(self._response * (one + other) / 2)]

    def _sum(self, pole: complex, count: int) -> _Complex:
        """Of exp((p - s) k T) over k < count."""
        step = (pole - self._s) * self._period_s
        return np.asarray(np.expm1(count * step) / np.expm1(step), np.complex128)

    def error(self, columns: list[_Floats], gains: _Floats) -> float:
        """Of these gains, Re and Im of each pole in turn."""
        return float(np.linalg.norm(np.stack(columns, 1) @ gains - self.wanted)) / self.wanted_norm


def _at(ringing: Ringing, time_s: _Floats) -> _Floats:
    value: _Floats = (ringing.gain * np.exp(ringing.pole * time_s)).imag
    return value


def _peak(mode: Ringing, tail: Ringing | None) -> tuple[float, float]:
    """A bound of the magnitude over all times, and where it is nearly reached.

    Between samples h apart, a function is at most h^2/8 times its largest curvature above them.
    """
    sounding = [mode] if tail is None else [mode, tail]
    highest, where, begin = 0.0, 0.0, 0.0
    for end in sorted({each.end_s for each in sounding}):
        here = [each for each in sounding if each.end_s >= end]
        time = np.linspace(begin, end, _PEAK_SAMPLES)
        value = np.abs(sum((_at(each, time) for each in here), np.zeros(_PEAK_SAMPLES)))
        curvature = sum(abs(each.gain) * abs(each.pole) ** 2 for each in here)
        least = float(value.max())
        bound = min(least + (time[1] - time[0]) ** 2 / 8 * curvature, sum(abs(each.gain) for each in here))
        if bound > highest:
            highest, where = bound, float(time[value.argmax()])
        begin = end
    return highest, where


def _shape(band: _Band, poles: list[complex], columns: list[_Floats], gains: _Floats) -> Shape:
    """Gains as least squares gives them, Re and Im of each pole in turn; scaled back to LARGEST."""
    ringing = [Ringing(pole, complex(*gains[2 * i : 2 * i + 2])) for i, pole in enumerate(poles)]
    mode, tail = ringing[0], ringing[1] if len(ringing) > 1 else None
    peak, peak_time_s = _peak(mode, tail)
    limited = peak > LARGEST
    if limited:
        factor = LARGEST / peak
        mode = Ringing(mode.pole, factor * mode.gain)
        tail = None if tail is None else Ringing(tail.pole, factor * tail.gain)
        gains, peak = factor * gains, LARGEST
    return Shape(mode, tail, peak, peak_time_s, band.error(columns, gains), limited)


def _tails(mode: Mode, rate_hz: float) -> list[complex]:
    """Poles of the tails that are tried: slow and long for what the hand's spring and damper leave, and as fast as the
    band for what the first held samples leave."""
    slow = _TIME_CONSTANTS / (_TIME_CONSTANTS / mode.decay_rate_per_s + TAIL_S)
    highest = 2 * math.pi * HIGH * rate_hz
    return [complex(-slow, min(slow / 2, highest)), complex(-3 * mode.decay_rate_per_s, highest)]


def pole_shape(mode: Mode, dynamics: Dynamics, rate_hz: float, gain: complex) -> Shape:
    """The mode's pole alone, with this gain in units of (m + m_h)."""
    band, p = _Band(mode, dynamics, rate_hz), pole_of(mode)
    return _shape(band, [p], band.columns(p), np.array([gain.real, gain.imag]))


@lru_cache(maxsize=4096)
def shape_of(mode: Mode, dynamics: Dynamics, rate_hz: float, compensation: Literal["mass", "full"]) -> Shape:
    """What is struck for a mode that the rate can carry; `rate_hz` is how often the force changes at the device.

    Deterministic. `full` takes a few milliseconds, once.
    """
    band, p, period_s = _Band(mode, dynamics, rate_hz), pole_of(mode), 1 / rate_hz
    own = band.columns(p)
    gain = hold_gain(p, period_s)
    mass = _shape(band, [p], own, np.array([gain.real, gain.imag]))
    if compensation == "mass":
        return mass
    gain = pole_gain(mode, dynamics, period_s)
    tried = [mass, _shape(band, [p], own, np.array([gain.real, gain.imag]))]
    plain = min(tried, key=lambda shape: shape.error)
    tailed = []
    for pole in _tails(mode, rate_hz):
        columns = own + band.columns(pole)
        gains: _Floats = np.asarray(np.linalg.lstsq(np.stack(columns, 1), band.wanted, rcond=None)[0], np.float64)
        tailed.append(_shape(band, [p, pole], columns, gains))
    best = min(tailed, key=lambda shape: shape.error)
    return best if best.error < plain.error - WORTH else plain
