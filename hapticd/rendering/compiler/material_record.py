"""The record of a material in the table, and its arrays in the table's `numbers`."""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt

from hapticd.base.core import KEPT_TAP_GAINS, MAX_CORRECTED_SAMPLES, CData, Texture, ffi
from hapticd.config.materials import Material
from hapticd.config.modes import Mode
from hapticd.config.texture import FrequencyTable, Grooves
from hapticd.config.waveform import Waveform
from hapticd.rendering.compensation import Ringing
from hapticd.rendering.compiler.mode_record import Effect, mode_record
from hapticd.rendering.compiler.mode_tables import tabled_grooves, tabled_tap
from hapticd.rendering.device_output import Output
from hapticd.rendering.displayability import Touched, displayed_mode, displayed_wave_rate, kept_of, touched_by

Numbers: TypeAlias = dict[str, npt.NDArray[np.float64]]
"""A material's arrays for the table's `numbers`, by the member of the record that holds an array's first index."""

_DEFAULT_AIM: Final = (1.0, 0.0)
"""Aim (AimedKeys.aim) of a tap or a rupture without a direction, along the normal; also the core's default."""
_SIGNED_MEMBERS: Final = (
    *("gain_re", "gain_im", "tail_re", "tail_im"),
    *("free_gain_re", "free_gain_im", "free_tail_re", "free_tail_im"),
)
"""Members of `struct hd_mode` that change sign if the mode's amplitude does."""


def struck_modes(material: Material) -> Iterator[Mode]:
    """Yield the modes of a material that a device may play as effects: those of tap and rupture."""
    if material.tap is not None and material.tap.one_mode is not None:
        yield material.tap.one_mode
    if material.rupture is not None:
        yield material.rupture.mode


def material_record(
    material: Material, noise_index: int, output: Output, effects: Mapping[Mode, Effect | None] = MappingProxyType({})
) -> tuple[CData, Numbers]:
    """Return a material's record, a `struct hd_material *` without the indices of its arrays, and these arrays.

    `noise_index` is the index of the material's noise, if any. `effects` are effects that a device plays, by mode.
    """
    record, numbers = ffi.new("struct hd_material *"), Numbers()
    record.stiffness_n_per_m = material.stiffness_n_per_m
    record.damping_n_s_per_m = material.damping_n_s_per_m
    if material.tap is not None:
        _put_tap(record, numbers, material, output, effects)
    if material.rupture is not None:
        amplitude, mode = material.rupture.amplitude_m_per_s2, material.rupture.mode
        record.rupture = mode_record(mode, amplitude, amplitude, output, effects.get(mode))
        record.rupture_depth_m = material.rupture.rupture_depth_m
        record.heals = material.rupture.heals
        if material.rupture.aim != _DEFAULT_AIM:
            record.rupture_aim = material.rupture.aim
    if material.friction is not None:
        record.friction_coefficient = material.friction.coefficient
        record.friction_stiffness_n_per_m = material.friction.stiffness_n_per_m
    texture = material.texture
    if isinstance(texture, Grooves):
        record.spacing_m = texture.spacing_m
        record.width_m = texture.width_m
        if texture.display == "vibration":
            record.texture = Texture.STRIKES
            record.velocity_gain_per_s = texture.velocity_gain_per_s
            record.force_gain_m_per_s2_per_n = texture.force_gain_m_per_s2_per_n
            _put_groove_mode(record, numbers, material, texture.frequency_table, output)
        elif texture.display == "geometry":
            record.texture = Texture.GEOMETRY
            record.depth_m = texture.depth_m
        else:
            record.texture = Texture.DRAG
            record.drag_n_s_per_m = texture.damping_n_s_per_m
    elif texture is not None:
        record.texture = Texture.NOISE
        record.noise = noise_index
    return record, numbers


def _put_tap(
    record: CData, numbers: Numbers, material: Material, output: Output, effects: Mapping[Mode, Effect | None]
) -> None:
    tap, slope = material.tap, 1.0
    assert tap is not None
    tabled, touched = tabled_tap(material, output), touched_by(material, "tap")
    if tap.attack_slope_per_s is not None:
        slope = tap.attack_slope_per_s
    elif tap.amplitudes is not None:  # the points are values of A
        record.tap_count, numbers["tap_first"] = len(tap.amplitudes), np.array(tap.amplitudes).T.ravel()
    # With a table, the tick finds the mode and its first peak.
    coefficient = tap.coefficient(slope) if tabled is None else slope
    if tap.aim != _DEFAULT_AIM:
        record.tap_aim = tap.aim
    if tap.waveform is not None:
        _put_waveform(record, tap.waveform, slope, coefficient, output)
        numbers["wave_first"] = tap.waveform.curve.numbers()
    elif tabled is not None:
        assert tap.mode_table is not None
        record.tap = mode_record(tabled.base, slope, coefficient, output, touched=touched)
        record.mode_count, record.mode_nodes = len(tap.mode_table.speeds_m_per_s), len(tabled.nodes)
        record.mode_by_peak = tap.attack == "first_peak"
        tabled.complete(record, record.tap, output)
        numbers["mode_first"] = tabled.numbers
    elif tap.ringing is not None:
        mode = tap.ringing
        record.tap = mode_record(mode, slope, coefficient, output, effects.get(mode), touched)
    if tap.second is not None:
        ratio = tap.second.ratio
        record.second = mode_record(tap.second.mode, 0.0, abs(ratio) * coefficient, output, touched=touched)
        if ratio < 0:
            for index in range(2 * MAX_CORRECTED_SAMPLES):
                record.second.kicks[index] = -record.second.kicks[index]
            for key in _SIGNED_MEMBERS:
                setattr(record.second, key, -getattr(record.second, key))
    _put_kept(record, numbers, output, touched)


def _put_kept(record: CData, numbers: Numbers, output: Output, touched: Touched) -> None:
    """Set the members of a material's record for a compensated tap that stays in contact, with a second tail."""
    kept = kept_of(output, touched)
    if kept is None:
        return
    pole, gains, shapes = 0j, [], zip(kept.full, kept.kept, strict=True)
    members = (record.tap, record.second)
    for index, (mode, push) in enumerate(touched.pushes):
        found = (0j,) * 4
        if displayed_mode(mode, output)[0] is not None:
            full, shape = next(shapes)
            _, tail, second_tail = shape.parts
            found = (shape.mode.gain, tail.gain, second_tail.gain, full.parts[2].gain)
            pole = second_tail.pole
            members[index].peak = max(full.peak, shape.peak)
        sign = math.copysign(1.0, push * touched.pushes[0][1])
        gains += [sign * part for gain in found for part in (gain.real, gain.imag)]
    gains += [0.0] * (2 * KEPT_TAP_GAINS - len(gains))
    rotor = cmath.exp(pole / output.rate_hz)
    end_s = Ringing(pole, 0j).end_s
    tail_numbers = (rotor.real, rotor.imag, -pole.real, pole.imag, end_s)
    record.kept_count, record.kept_step_s = len(kept.kept_depth_s), kept.step_s
    numbers["kept_first"] = np.concatenate((tail_numbers, gains, kept.kept_depth_s, kept.full_depth_s))


def _put_waveform(record: CData, waveform: Waveform, slope: float, coefficient: float, output: Output) -> None:
    """Set the members of a material's record for a tap that plays a waveform."""
    rate_hz = displayed_wave_rate(waveform, output)
    shown_hz = waveform.rate_hz if rate_hz is None else rate_hz
    tap, slowed = record.tap, waveform.rate_hz / shown_hz
    tap.end_s = waveform.length_s * slowed
    tap.peak, tap.peak_time_s = waveform.curve.peak, waveform.curve.peak_time_s * slowed
    tap.amplitude_per_unit = slope
    tap.force_per_unit = 0.0 if rate_hz is None else output.effective_mass_kg * coefficient
    tap.gain_re = 1.0
    record.wave_rate_hz, record.wave_count = shown_hz, len(waveform.samples)


def _put_groove_mode(
    record: CData, numbers: Numbers, material: Material, table: FrequencyTable | None, output: Output
) -> None:
    mode, tabled = material.groove_mode, tabled_grooves(material, output)
    assert mode is not None
    record.groove = mode_record(mode if tabled is None else tabled.base, 1.0, 1.0, output)
    if tabled is not None and table is not None:
        record.tune_speeds, record.tune_forces = len(table.speeds_m_per_s), len(table.forces_n)
        record.tune_nodes = len(tabled.nodes)
        tabled.complete(record, record.groove, output)
        numbers["tune_first"] = tabled.numbers
