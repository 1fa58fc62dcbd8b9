"""What the handle's acceleration is, of a force that is held from tick to tick, and how far it is from what was wanted.

The device is linear (hapticd.config.dynamics): (m + m_h) x'' + (b + b_h) x' + k x = F. Accelerations are means over
the time between two samples: of a device, the difference of its velocities, which is exact; of a mode, the integral of
its closed form.

The displayed error is the RMS of the difference over the RMS of what was wanted, both limited to a band, 30 Hz to 0.4
of the rate. It begins at the onset. A link or a report that comes late delays the force and changes none of its shape:
who measures takes the time at which the force begins at the device as the onset.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from hapticd.config.actuator import Actuator
from hapticd.config.configuration import Compensation
from hapticd.config.dynamics import Dynamics, held_motion
from hapticd.config.modes import Mode
from hapticd.config.waveform import Waveform
from hapticd.rendering.compensation import (
    ERROR_BAND_RATE_FRACTION,
    ERROR_BAND_LOW_HZ,
    Load,
    pole_of,
    pole_shape,
    shape_of,
)

Floats = npt.NDArray[np.float64]

FINER: Final = 16
"""A period is cut into so many parts, to see what a held force does within it."""
_SETTLED_S: Final = 0.05
"""So long the handle is observed after a waveform has ended."""


def handle_acceleration(force_n: npt.ArrayLike, dynamics: Dynamics, rate_hz: float, finer: int = FINER) -> Floats:
    """Acceleration of a handle that was at rest, m/s^2, of forces (n,) held for 1/rate_hz each.

    (n * finer,): means over each of `finer` equal parts of a period.
    """
    forces = np.asarray(force_n, dtype=np.float64)
    whole, pushed = held_motion(dynamics, 1.0 / rate_hz)
    states = np.empty((len(forces), 2))
    now = np.zeros(2)
    for tick, force in enumerate(forces):
        states[tick] = now
        now = whole @ now + pushed * force
    part, push = held_motion(dynamics, 1.0 / rate_hz / finer)
    velocity = np.empty((len(forces), finer + 1))
    for index in range(finer + 1):
        velocity[:, index] = states[:, 1]
        states = states @ part.T + forces[:, None] * push
    acceleration: Floats = np.diff(velocity, axis=1).ravel() * (rate_hz * finer)
    return acceleration


def waveform(mode: Mode, count: int, sample_rate_hz: float, since_s: float = 0.0) -> Floats:
    """exp(-B t) sin(w t), as means over the `count` times between samples, (count,); the first begins at t = since_s.

    Nothing sounds before t = 0.
    """
    edges = np.maximum(since_s + np.arange(count + 1) / sample_rate_hz, 0.0)
    p = pole_of(mode)
    integral: Floats = (np.exp(p * edges) / p).imag
    return np.diff(integral) * sample_rate_hz


def band_lines(
    signal: npt.ArrayLike, sample_rate_hz: float, low_hz: float, high_hz: float
) -> npt.NDArray[np.complex128]:
    """The lines of a signal (n,) from low_hz to high_hz, (lines,): padded with zeros to twice its length, and until the
    lines are 1 Hz apart at most, it goes through the FFT."""
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
    """RMS of (measured - reference) over RMS of reference, both limited to low_hz to high_hz.

    Both are (n,), in the same unit, and begin at the onset; nothing is taken to be there before and after. `high_hz` is
    by default 0.4 of the sample rate. The band is cut in the spectrum: by Parseval the squares of its lines
    (band_lines) are the energy. No filter rings, none has a phase.

    Raises ValueError for arrays of other shapes, a band without lines, and a reference without energy in it.
    """
    one, other = (np.asarray(each, dtype=np.float64) for each in (measured, reference))
    if one.ndim != 1 or one.shape != other.shape or not len(one):
        raise ValueError(f"measured and reference must have one shape (n,), have {one.shape} and {other.shape}")
    high = ERROR_BAND_RATE_FRACTION * sample_rate_hz if high_hz is None else high_hz
    wanted = float(np.linalg.norm(band_lines(other, sample_rate_hz, low_hz, high)))
    if not wanted > 0:
        raise ValueError(f"the reference has no energy from {low_hz:g} to {high:g} Hz")
    return float(np.linalg.norm(band_lines(one - other, sample_rate_hz, low_hz, high))) / wanted


def waveform_error(waveform: Waveform, dynamics: Dynamics, rate_hz: float, effective_mass_kg: float) -> float:
    """Displayed error of a tap that is a waveform and begins at a tick, as displayed_error has it; nothing is
    compensated for, and the actuator follows at once."""
    ticks = math.ceil((waveform.length_s + _SETTLED_S) * rate_hz)
    force = effective_mass_kg * waveform.curve.at(np.arange(ticks) / rate_hz)
    middles = (np.arange(ticks * FINER) + 0.5) / (rate_hz * FINER)
    moved = handle_acceleration(force, dynamics, rate_hz)
    return band_error(
        moved, waveform.curve.at(middles), rate_hz * FINER, ERROR_BAND_LOW_HZ, ERROR_BAND_RATE_FRACTION * rate_hz
    )


def displayed_error(
    mode: Mode,
    dynamics: Dynamics,
    rate_hz: float,
    compensation: Compensation,
    effective_mass_kg: float | None = None,
    actuator: Actuator | None = None,
) -> float:
    """Displayed error of a strike that begins at a tick; 0.1 is 10 %.

    `mode` is one that the rate carries, as it is displayed (displayability.displayed_mode). `rate_hz` is how often the
    force changes at the device: the servo's rate, or the link's if that is lower. `effective_mass_kg` counts where
    compensation is off; by default it is that of handle and hand. `actuator` is what every force goes by. The spectra
    are closed forms (compensation.py).
    """
    load = Load(actuator=actuator)
    if compensation != "off":
        return shape_of(mode, dynamics, rate_hz, compensation, load).error
    mass = dynamics.mass_kg if effective_mass_kg is None else effective_mass_kg
    return pole_shape(mode, dynamics, rate_hz, complex(mass / dynamics.mass_kg), load).error
