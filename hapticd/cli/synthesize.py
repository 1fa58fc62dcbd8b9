"""`hapticd fit synthesize`: synthetic recordings with known parameters, to test what a fit can resolve."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final, Literal, TypeVar

import click

from hapticd.base import wording
from hapticd.base.errors import HapticdError, known_names, quoted
from hapticd.base.files import check_new, write_atomically
from hapticd.cli import names
from hapticd.cli.common import (
    Finite,
    config_option,
    json_option,
    note,
    options,
    output_option,
    overwrite_option,
    print_json,
)

if TYPE_CHECKING:
    from hapticd.config.materials import Material
    from hapticd.fit.recording import Recording
    from hapticd.fit.synthesize import Stylus

_F = TypeVar("_F", bound=Callable[..., Any])
_Truth = dict[str, float]
"""The parameters that a fit of synthetic recordings should find, by name."""
RECORDING_SUFFIX: Final = ".npz"
MATERIAL_BY_KIND: Final = {"tap": "wood", "grooves": "comb", "texture": "sandpaper_100", "puncture": "cellophane"}
"""The kinds of recordings, each with its default material."""
# Defaults of --speed, --force and --duration.
TAP_SPEEDS_M_PER_S: Final = (0.08, 0.11, 0.14, 0.17, 0.2, 0.23, 0.26, 0.29, 0.32, 0.35)
PUNCTURE_SPEEDS_M_PER_S: Final = (0.03, 0.05, 0.08, 0.12)
STROKE_SPEEDS_M_PER_S: Final = (0.05, 0.12)
STROKE_FORCES_N: Final = (0.5, 1.5)
STROKE_DURATION_S_BY_KIND: Final = {"grooves": 1.0, "texture": 10.0}


def _number(
    flag: str, name: str, low: float, high: float, unit: str, text: str, default: float | None = None
) -> Callable[[_F], _F]:
    return click.option(
        flag, name, type=Finite(low, high), metavar=unit, default=default, show_default=default is not None, help=text
    )


def _count(flag: str, low: int, high: int | None, default: int, text: str) -> Callable[[_F], _F]:
    return click.option(flag, type=click.IntRange(low, high), default=default, show_default=True, help=text)


def _several(flag: str, name: str, high: float, unit: str, text: str) -> Callable[[_F], _F]:
    return click.option(flag, name, type=Finite(1e-4, high), multiple=True, metavar=unit, help=text)


_stylus_options: Final = options(
    _number("--rate", "rate_hz", 100.0, 1e6, "HZ", "Samples per second.", 25_000.0),
    _number("--noise", "noise_rms", 0.0, 10.0, "PART", "Noise RMS, as a fraction of the peak acceleration.", 0.02),
    _number("--mounting", "mounting_hz", 1.0, 1e6, "HZ", "Resonance frequency of the sensor on its mounting."),
    _number("--mounting-damping", "mounting_damping", 1e-4, 0.999, "PART", "Damping ratio of that resonance.", 0.05),
    _number("--filter", "filter_hz", 1.0, 1e6, "HZ", "Corner frequency of a Butterworth low-pass filter."),
    _count("--filter-order", 1, 8, 2, "Order of the filter."),
    _number("--full-scale", "full_scale_m_per_s2", 1e-3, 1e9, "M/S^2", "Acceleration at which the sensor clips."),
    _number("--tremor", "tremor_m_per_s2", 0.0, 1e3, "M/S^2", "Amplitude of the hand's tremor.", 0.0),
    _number("--drift", "drift_m_per_s3", -1e3, 1e3, "M/S^3", "Drift of the acceleration.", 0.0),
    _number("--position-step", "position_step_m", 0.0, 1.0, "M", "Resolution of the positions; 0: exact.", 0.0),
    _count("--seed", 0, None, 1, "Random seed of noise, tremor and scatter."),
)
"""Options of the synthetic stylus: sensor, filter, hand and noise."""


@click.command("synthesize", short_help="Synthesize recordings with known parameters.")
@click.argument("kind", type=click.Choice(list(MATERIAL_BY_KIND)), metavar="KIND")
@output_option("File of the recording; several recordings are numbered.", f"FILE{RECORDING_SUFFIX}", required=True)
@click.option(
    "--material",
    "name",
    metavar="NAME",
    shell_complete=names.shipped_materials,
    help="Material of the library or of a file given with -c [default: wood, comb, sandpaper_100 or cellophane].",
)
@config_option
@_several("--speed", "speeds", 10.0, "M/S", "Speed of a tap, stroke or puncture; may be repeated.")
@_several("--force", "forces", 100.0, "N", "Normal force of a stroke; may be repeated.")
@_number(
    "--duration", "duration_s", 0.05, 600.0, "S", "Duration of a stroke [default: 1 s of grooves, 10 s of texture]."
)
@_stylus_options
@overwrite_option
@json_option
def synthesize_command(
    kind: Literal["tap", "grooves", "texture", "puncture"],
    output: str,
    name: str | None,
    configs: tuple[str, ...],
    speeds: tuple[float, ...],
    forces: tuple[float, ...],
    duration_s: float | None,
    full_scale_m_per_s2: float | None,
    overwrite: bool,
    as_json: bool,
    **stylus: Any,
) -> None:
    """Synthesize recordings of a material by a stylus, and print the parameters that a fit should find.

    KIND is tap (all speeds in one recording), grooves, texture or puncture (a separate recording for each stroke or
    puncture). With several --speed and --force there is a stroke for each pair; without them there are ten taps, four
    strokes or four punctures. A fit of the recordings shows what can be resolved with this rate, noise and sensor.
    """
    from hapticd.config.configuration import config_of
    from hapticd.config.schema import unit_of
    from hapticd.fit.recording import npz_of
    from hapticd.fit.synthesize import Stylus

    if os.path.splitext(output)[1].lower() != RECORDING_SUFFIX:
        raise HapticdError(f"{output}: must end in {RECORDING_SUFFIX}")
    if kind not in STROKE_DURATION_S_BY_KIND and (forces or duration_s is not None):
        raise click.UsageError("--force and --duration need KIND grooves or texture")
    materials: Mapping[str, Material] = config_of(configs).materials
    name = name or MATERIAL_BY_KIND[kind]
    if name not in materials:
        known = known_names(name, materials)
        raise HapticdError(f"unknown material {quoted(name)}; {known}; -c FILE adds other materials")
    made = Stylus(**stylus, full_scale_m_per_s2=math.inf if full_scale_m_per_s2 is None else full_scale_m_per_s2)
    try:
        if kind == "tap":
            recordings, truth = _taps(materials[name], made, speeds or TAP_SPEEDS_M_PER_S)
        elif kind == "puncture":
            recordings, truth = _punctures(materials[name], made, speeds or PUNCTURE_SPEEDS_M_PER_S)
        else:
            pairs = [(speed, force) for speed in speeds or STROKE_SPEEDS_M_PER_S for force in forces or STROKE_FORCES_N]
            recordings, truth = _strokes(
                kind, materials[name], made, pairs, duration_s or STROKE_DURATION_S_BY_KIND[kind]
            )
    except ValueError as error:
        raise HapticdError(f"cannot synthesize recordings of {quoted(name)}: {error}") from None
    targets = _targets(output, len(recordings))
    for target in targets:
        check_new(target, overwrite)
    for target, recording in zip(targets, recordings, strict=True):
        write_atomically(target, npz_of(recording), overwrite)
    if as_json:
        print_json({"kind": kind, "material": name, "truth": truth, "files": targets})
        return
    for key, value in truth.items():
        click.echo(f"{key}: {value:.6g} {unit_of(key) or ''}".rstrip())
    if not truth:
        note(f"the parameters of {name} are its autoregressive models")
    note(f"{wording.count(len(targets), 'recording')} of {name}: {', '.join(targets)}")


def _taps(material: Material, stylus: Stylus, speeds: Sequence[float]) -> tuple[list[Recording], _Truth]:
    from hapticd.fit.synthesize import taps

    tap = material.tap
    if tap is None:
        raise ValueError("the material has no tap")
    if tap.second is not None:
        raise ValueError("its tap has two modes, synthetic taps have one")
    if tap.waveform is not None:
        raise ValueError("its tap is a waveform, synthetic taps are modes")
    recording, truth = taps(tap, speeds, stylus)
    slope = {"slope_per_s": truth.slope_per_s, "first_peak_slope_per_s": truth.slope_per_s * truth.mode.peak}
    return [recording], slope | _values(truth.mode, "frequency_hz", "decay_time_s")


def _strokes(
    kind: Literal["grooves", "texture"],
    material: Material,
    stylus: Stylus,
    pairs: Sequence[tuple[float, float]],
    duration_s: float,
) -> tuple[list[Recording], _Truth]:
    """Return a recording of a stroke for each pair of speed and force, and the parameters that a fit should find."""
    from hapticd.config.texture import Autoregressive, Grooves
    from hapticd.fit.synthesize import Hand, grooves, texture

    coarse, hand = material.texture, Hand(duration_s=duration_s)
    if kind == "grooves" and isinstance(coarse, Grooves) and coarse.frequency_table is not None:
        raise ValueError("the frequency of its grooves depends on speed and force, which the fit does not support")
    stroke = grooves if kind == "grooves" else texture
    made = zip(pairs, _seeded(stylus, len(pairs)), strict=True)
    found = [stroke(material, *pair, each, hand) for pair, each in made]
    if isinstance(coarse, Autoregressive):
        return found, {}  # the parameters are the models of the material
    gains = _values(coarse, "velocity_gain_per_s", "force_gain_m_per_s2_per_n")
    if kind == "texture":
        return found, _values(coarse, "peak_hz", "mean_hz") | gains
    return found, _values(coarse, "spacing_m") | _values(material.groove_mode, "frequency_hz", "decay_time_s") | gains


def _punctures(material: Material, stylus: Stylus, speeds: Sequence[float]) -> tuple[list[Recording], _Truth]:
    from hapticd.fit.synthesize import puncture

    made = zip(speeds, _seeded(stylus, len(speeds)), strict=True)
    found = [puncture(material, speed, each) for speed, each in made]
    rupture = material.rupture
    assert rupture is not None  # puncture() raises ValueError without it
    depth_m, stiffness = rupture.rupture_depth_m, material.stiffness_n_per_m
    truth = {"stiffness_n_per_m": stiffness, "depth_m": depth_m, "force_n": stiffness * depth_m}
    truth |= _values(rupture, "amplitude_m_per_s2")
    return found, truth | _values(rupture.mode, "frequency_hz", "decay_rate_per_s")


def _values(owner: object, *names: str) -> _Truth:
    return {name: getattr(owner, name) for name in names}


def _seeded(stylus: Stylus, count: int) -> list[Stylus]:
    """Return a stylus with a different seed for each of `count` recordings.

    With up to 1000 recordings, no seed also occurs with another --seed.
    """
    return [replace(stylus, seed=1000 * stylus.seed + index) for index in range(count)]


def _targets(output: str, count: int) -> list[str]:
    """Return the names of `count` files: `output` for one file, else `output` with -1, -2 and so on before .npz."""
    if count == 1:
        return [output]
    stem, ending = os.path.splitext(output)
    return [f"{stem}-{index + 1:0{len(str(count))}d}{ending}" for index in range(count)]
