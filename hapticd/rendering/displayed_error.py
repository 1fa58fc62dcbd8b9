"""Acceleration of the handle for a force that is held from tick to tick, and its error.

The device is linear (hapticd.config.dynamics): (m + m_h) x'' + (b + b_h) x' + k x = F. Accelerations are means over
the time between two samples: of a device from exact differences of its velocity, of a mode from the integral of its
closed form.

The displayed error is the RMS of the difference from the target, divided by the RMS of the target, both limited to the
error band, 30 Hz to 0.4 of the rate of servo or link, whichever is lower. Both signals begin at the onset. A delay of
link or report shifts the force without changing its shape, so the target is delayed, too.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from hapticd.config.configuration import Compensation
from hapticd.config.dynamics import Dynamics, held_motion
from hapticd.config.modes import Mode
from hapticd.config.waveform import Waveform
from hapticd.rendering.compensation import (
    ERROR_BAND_LOW_HZ,
    ERROR_BAND_RATE_FRACTION,
    NO_LOAD,
    Load,
    pole_of,
    pole_shape,
    root_mean_square,
    shape_of,
)

Floats = npt.NDArray[np.float64]

PARTS_PER_PERIOD: Final = 16
"""Accelerations are computed for this number of parts of a period, to resolve the motion under a held force."""
_SETTLING_TIME_S: Final = 0.05
"""Time after the end of a waveform for which the handle's acceleration is still compared."""


def handle_acceleration(
    force_n: npt.ArrayLike, dynamics: Dynamics, rate_hz: float, finer: int = PARTS_PER_PERIOD
) -> Floats:
    """Return the acceleration of a handle, first at rest, for forces (n,) that are held for 1/rate_hz each.

    The result (n * finer,) in m/s^2 holds means over `finer` equal parts of each period.
    """
    forces = np.asarray(force_n, dtype=np.float64)
    step, step_push = held_motion(dynamics, 1.0 / rate_hz)
    states = np.empty((len(forces), 2))
    now = np.zeros(2)
    for tick, force in enumerate(forces):
        states[tick] = now
        now = step @ now + step_push * force
    part, push = held_motion(dynamics, 1.0 / rate_hz / finer)
    velocity = np.empty((len(forces), finer + 1))
    for index in range(finer + 1):
        velocity[:, index] = states[:, 1]
        states = states @ part.T + forces[:, None] * push
    acceleration: Floats = np.diff(velocity, axis=1).ravel() * (rate_hz * finer)
    return acceleration


def waveform(mode: Mode, count: int, sample_rate_hz: float, since_s: float = 0.0) -> Floats:
    """Return means of a mode's signal exp(-B t) sin(w t) over `count` intervals of 1/sample_rate_hz, (count,).

    The first interval begins at t = `since_s`. The signal is 0 before t = 0.
    """
    edges = np.maximum(since_s + np.arange(count + 1) / sample_rate_hz, 0.0)
    p = pole_of(mode)
    integral: Floats = (np.exp(p * edges) / p).imag
    return np.diff(integral) * sample_rate_hz


def band_lines(
    signal: npt.ArrayLike, sample_rate_hz: float, low_hz: float, high_hz: float
) -> npt.NDArray[np.complex128]:
    """Return the spectral lines of a signal (n,) from `low_hz` to `high_hz`, (lines,).

    The signal is padded with zeros to at least twice its length, and until the lines have a distance of at most 1 Hz.
    """
    one = np.asarray(signal, dtype=np.float64)
    length = 1 << math.ceil(math.log2(max(2 * len(one), sample_rate_hz)))
    frequency = np.fft.rfftfreq(length, 1.0 / sample_rate_hz)
    lines: npt.NDArray[np.complex128] = np.fft.rfft(one, length)[(frequency >= low_hz) & (frequency <= high_hz)]
    return lines


def band_error(
    measured: npt.ArrayLike,
    reference: npt.ArrayLike,
    sample_rate_hz: float,
    low_hz: float = ERROR_BAND_LOW_HZ,
    high_hz: float | None = None,
) -> float:
    """Return RMS(measured - reference) / RMS(reference), both limited to the band from `low_hz` to `high_hz`.

    Both signals are (n,), in the same unit, begin at the onset, and are 0 before and after. `high_hz` is 0.4 of the
    sample rate by default. By Parseval's theorem the squares of spectral lines in the band sum up to its energy.

    Raises ValueError for arrays of other shapes, a band without lines, or a reference without energy in the band.
    """
    one, other = (np.asarray(each, dtype=np.float64) for each in (measured, reference))
    if one.ndim != 1 or one.shape != other.shape or not len(one):
        raise ValueError(f"measured and reference must have equal shapes (n,), have {one.shape} and {other.shape}")
    high = ERROR_BAND_RATE_FRACTION * sample_rate_hz if high_hz is None else high_hz
    wanted = float(np.linalg.norm(band_lines(other, sample_rate_hz, low_hz, high)))
    if not wanted > 0:
        raise ValueError(f"the reference has no energy from {low_hz:g} to {high:g} Hz")
    return float(np.linalg.norm(band_lines(one - other, sample_rate_hz, low_hz, high))) / wanted


def waveform_error(
    waveform: Waveform, dynamics: Dynamics, rate_hz: float, effective_mass_kg: float, load: Load = NO_LOAD
) -> float:
    """Return the displayed error of a tap that plays a waveform, RMS over the onsets of `load`.

    The RMS difference of the handle's acceleration from the waveform is divided by the RMS of the waveform, both in the
    error band. The force is neither compensated nor delayed by the actuator.
    """
    ticks = 1 + math.ceil((waveform.length_s + _SETTLING_TIME_S) * rate_hz)
    middles = (np.arange(ticks * PARTS_PER_PERIOD) + 0.5) / (rate_hz * PARTS_PER_PERIOD)
    errors = []
    for onset in load.onsets:
        # The times begin up to a period before the onset, so that the waveform before its first sample counts, too.
        begin_s = (1.0 - onset) / rate_hz
        force = effective_mass_kg * waveform.curve.at(np.arange(ticks) / rate_hz - begin_s)
        errors.append(
            band_error(
                handle_acceleration(force, dynamics, rate_hz),
                waveform.curve.at(middles - begin_s),
                rate_hz * PARTS_PER_PERIOD,
                ERROR_BAND_LOW_HZ,
                ERROR_BAND_RATE_FRACTION * rate_hz,
            )
        )
    return root_mean_square(errors)


def displayed_error(
    mode: Mode,
    dynamics: Dynamics,
    rate_hz: float,
    compensation: Compensation,
    effective_mass_kg: float | None = None,
    load: Load = NO_LOAD,
) -> float:
    """Return the error of the handle's acceleration, relative to the mode, RMS over the onsets of `load`; 0.1 is 10 %.

    `mode` is displayable: its frequency is at most 0.4 of `rate_hz`, the rate of the servo or of a slower link.
    `effective_mass_kg`, by default the mass of handle and hand, is used if compensation is off. `load` has no surface.
    The spectra are closed forms (compensation.py).
    """
    if compensation != "off":
        return shape_of(mode, dynamics, rate_hz, compensation, load).error
    mass = dynamics.mass_kg if effective_mass_kg is None else effective_mass_kg
    return pole_shape(mode, dynamics, rate_hz, complex(mass / dynamics.mass_kg), load).error
