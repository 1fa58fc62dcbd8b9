"""The record of a material in the table, and the numbers that it has outside its record."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Final

import numpy as np
import numpy.typing as npt

from hapticd.base.core import KICKS, CData, Texture, ffi
from hapticd.config.materials import Material
from hapticd.config.modes import Mode
from hapticd.config.texture import Grooves
from hapticd.config.waveform import Waveform
from hapticd.rendering.compiler.mode_record import Effect, mode_record
from hapticd.rendering.device_output import Output
from hapticd.rendering.displayability import displayed_wave_rate, touched_by, waveform_of
from hapticd.rendering.groove_tuning import tuning_of
from hapticd.rendering.tap_tuning import tap_tuning_of

_ACROSS: Final = (1.0, 0.0)
"""A tap's and a rupture's aim unless another is given, which the core takes for granted."""
_SIGNED: Final = (
    *("gain_re", "gain_im", "tail_re", "tail_im"),
    *("free_gain_re", "free_gain_im", "free_tail_re", "free_tail_im"),
)


def struck_modes(material: Material) -> Iterator[Mode]:
    """The modes that a device may play itself."""
    if material.tap is not None and material.tap.one_mode is not None:
        yield material.tap.one_mode
    if material.rupture is not None:
        yield material.rupture.mode


def _play(record: CData, waveform: Waveform, slope: float, coefficient: float, output: Output) -> None:
    """A tap that plays a waveform."""
    rate_hz = displayed_wave_rate(waveform, output)
    shown_hz = waveform.rate_hz if rate_hz is None else rate_hz
    tap, slowed = record.tap, waveform.rate_hz / shown_hz
    tap.end_s = waveform.length_s * slowed
    tap.peak, tap.peak_time_s = waveform.curve.peak, waveform.curve.peak_time_s * slowed
    tap.amplitude_per_unit = slope
    tap.force_per_unit = 0.0 if rate_hz is None else output.effective_mass_kg * coefficient
    tap.gain_re = 1.0
    record.wave_rate_hz, record.wave_count = shown_hz, len(waveform.samples)


def numbers_of(material: Material, output: Output) -> Iterator[tuple[str, npt.NDArray[np.float64]]]:
    """What a material has in the table's numbers: the member of its record that says where they begin, and they."""
    if material.tap is not None and material.tap.amplitudes is not None:
        yield "tap_first", np.array(material.tap.amplitudes).T.ravel()
    tuning, tap_tuning, waveform = tuning_of(material, output), tap_tuning_of(material, output), waveform_of(material)
    if tuning is not None:
        yield "tune_first", tuning.numbers()
    if tap_tuning is not None:
        yield "mode_first", tap_tuning.numbers()
    if waveform is not None:
        yield "wave_first", waveform.curve.numbers()


def material_record(
    material: Material, noise_index: int, output: Output, effects: Mapping[Mode, Effect | None] = MappingProxyType({})
) -> CData:
    """A `struct hd_material *`, of which only the places of its numbers are missing (`numbers_of`); `noise_index` is
    where its noise is, for a texture that is noise; `effects` are what a device plays itself."""
    record = ffi.new("struct hd_material *")
    record.stiffness_n_per_m = material.stiffness_n_per_m
    record.damping_n_s_per_m = material.damping_n_s_per_m
    touched = touched_by(material, "tap")
    if material.tap is not None:
        mode, slope = material.tap.ringing, material.tap.attack_slope_per_s
        if slope is None:  # the points give A itself
            slope = 1.0
            record.tap_count = len(material.tap.amplitudes or ())
        tuned = tap_tuning_of(material, output)
        # Of a table the tick knows the mode, and what a first peak is of it.
        coefficient = material.tap.coefficient(slope) if tuned is None else slope
        if material.tap.aim != _ACROSS:
            record.tap_aim = material.tap.aim
        if material.tap.waveform is not None:
            _play(record, material.tap.waveform, slope, coefficient, output)
        elif tuned is not None:
            record.tap = mode_record(tuned.base, slope, coefficient, output, touched=touched)
            tuned.complete(record, 1.0 / output.rate_hz)
        elif mode is not None:
            record.tap = mode_record(mode, slope, coefficient, output, effects.get(mode), touched)
        if material.tap.second is not None:
            ratio = material.tap.second.ratio
            record.second = mode_record(
                material.tap.second.mode, 0.0, abs(ratio) * coefficient, output, touched=touched
            )
            if ratio < 0:
                for index in range(2 * KICKS):
                    record.second.kicks[index] = -record.second.kicks[index]
                for key in _SIGNED:
                    setattr(record.second, key, -getattr(record.second, key))
    if material.rupture is not None:
        amplitude, mode = material.rupture.amplitude_m_per_s2, material.rupture.mode
        record.rupture = mode_record(mode, amplitude, amplitude, output, effects.get(mode))
        record.rupture_depth_m = material.rupture.rupture_depth_m
        record.heals = material.rupture.heals
        if material.rupture.aim != _ACROSS:
            record.rupture_aim = material.rupture.aim
    if material.friction is not None:
        record.friction_coefficient = material.friction.coefficient
        record.friction_stiffness_n_per_m = material.friction.stiffness_n_per_m
    texture = material.texture
    if isinstance(texture, Grooves):
        record.spacing_m = texture.spacing_m
        record.width_m = texture.width_m
        if texture.display == "vibration":
            assert material.groove_mode is not None
            record.texture = Texture.STRIKES
            record.velocity_gain_per_s = texture.velocity_gain_per_s
            record.force_gain_m_per_s2_per_n = texture.force_gain_m_per_s2_per_n
            tuning = tuning_of(material, output)
            record.groove = mode_record(material.groove_mode if tuning is None else tuning.base, 1.0, 1.0, output)
            if tuning is not None:
                tuning.complete(record, 1.0 / output.rate_hz)
        elif texture.display == "geometry":
            record.texture = Texture.GEOMETRY
            record.depth_m = texture.depth_m
        else:
            record.texture = Texture.DRAG
            record.drag_n_s_per_m = texture.damping_n_s_per_m
    elif texture is not None:
        record.texture = Texture.NOISE
        record.noise = noise_index
    return record
