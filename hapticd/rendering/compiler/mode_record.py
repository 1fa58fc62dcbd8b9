"""The record of a mode in the table: its recursion at the rate, and the force of a strike."""

from __future__ import annotations

import cmath
from typing import Final, TypeAlias

from hapticd.base.core import MAX_CORRECTED_SAMPLES
from hapticd.config.modes import Mode
from hapticd.rendering.compensation import Ringing, Shape
from hapticd.rendering.device_output import Output
from hapticd.rendering.displayability import NO_SURFACE, Touched, displayed_mode, struck_shapes

Effect: TypeAlias = tuple[int, float, float]
"""Effect that a device plays in place of a mode: id, ratio of its largest level to the coefficient, duration in s."""

_NO_TAIL: Final[tuple[float, ...]] = (0.0,) * 7
"""Values of the tail's members of `struct hd_mode` for a mode without a tail."""
_NO_FREE: Final[tuple[float, ...]] = (0.0,) * 6
"""Values of the members of `struct hd_mode` for strikes without a surface, if the mode is not compensated."""
_NO_KICKS: Final[tuple[list[float], int, int]] = ([0.0] * (2 * MAX_CORRECTED_SAMPLES), 0, 0)
"""Values of the members `kicks` of `struct hd_mode` for a mode without kicks (corrections of single samples)."""


def mode_record(
    mode: Mode,
    amplitude_per_unit: float,
    coefficient_per_unit: float,
    output: Output,
    effect: Effect | None = None,
    touched: Touched = NO_SURFACE,
) -> tuple[float | list[float], ...]:
    """Return the members of a mode's record, in the order of `struct hd_mode`.

    For each unit of excitation, `amplitude_per_unit` (m/s^2) is reported, and `coefficient_per_unit` (m/s^2) sets the
    force. The compensation is designed for the surface `touched`; a strike adapts it to the surface in contact.
    """
    shown, factor = displayed_mode(mode, output)
    decay, omega = mode.decay_rate_per_s, mode.angular_frequency_rad_per_s
    uncompensated_force = output.effective_mass_kg * coefficient_per_unit
    force = 0.0
    shapes: tuple[Shape, Shape] | None = None
    if shown is not None:
        omega = shown.angular_frequency_rad_per_s
        force = uncompensated_force * factor
        shapes = struck_shapes(shown, output, touched)
    period = 1.0 / output.rate_hz
    rotor = cmath.exp(complex(-decay * period, omega * period))
    played = mode if shown is None else shown
    peak, peak_time_s, gain, tail = played.peak, played.peak_time_s, complex(1.0), _NO_TAIL
    free, kicks = _NO_FREE, _NO_KICKS
    if shapes is not None:
        assert output.dynamics is not None
        untouched, shape = shapes
        force = output.dynamics.mass_kg * coefficient_per_unit * factor
        peak, peak_time_s, gain = shape.peak, shape.peak_time_s, shape.mode.gain
        tail = _NO_TAIL if shape.tail is None else _tail_record(shape.tail, period)
        other, its_tail = untouched.mode.gain, 0j if untouched.tail is None else untouched.tail.gain
        if shape.kicks:
            kicks = ([number for pair in shape.kicks for number in pair], len(shape.kicks), 0)
        free = (touched.design_n_per_m, untouched.peak, other.real, other.imag, its_tail.real, its_tail.imag)
    return (
        rotor.real,
        rotor.imag,
        decay,
        omega,
        5.0 / decay,
        peak,
        peak_time_s,
        amplitude_per_unit,
        force,
        gain.real,
        gain.imag,
        *tail,
        *free,
        *kicks,
        *((0, 0, 0.0, 0.0, 0.0) if effect is None else (effect[0], 0, uncompensated_force, effect[1], effect[2])),
    )


def _tail_record(tail: Ringing, period_s: float) -> tuple[float, ...]:
    rotor = cmath.exp(tail.pole * period_s)
    decay, omega = -tail.pole.real, tail.pole.imag
    return rotor.real, rotor.imag, decay, omega, tail.end_s, tail.gain.real, tail.gain.imag
