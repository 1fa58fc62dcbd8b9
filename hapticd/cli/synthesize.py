"""`hapticd fit synthesize`: recordings whose truth is known, to see what a fit can resolve."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, TypeVar

import click

from hapticd.base import wording
from hapticd.base.errors import HapticdError, known_names, quoted
from hapticd.base.files import check_new, write_whole
from hapticd.cli import names
from hapticd.cli.common import (
    Finite,
    config_option,
    json_option,
    note,
    overwrite_option,
    print_json,
)

if TYPE_CHECKING:
    from hapticd.config.materials import Material
    from hapticd.fit.recording import Recording
    from hapticd.fit.synthesize import Stylus

_F = TypeVar("_F", bound=Callable[..., Any])
_Truth = dict[str, float]
ENDING: Final = ".npz"
TAP_SPEEDS: Final = (0.08, 0.11, 0.14, 0.17, 0.2, 0.23, 0.26, 0.29, 0.32, 0.35)
PUNCTURE_SPEEDS: Final = (0.03, 0.05, 0.08, 0.12)
STROKE_SPEEDS: Final = (0.05, 0.12)
STROKE_FORCES: Final = (0.5, 1.5)


@click.group("synthesize", no_args_is_help=False, short_help="Make recordings whose truth is known.")
def synthesize_command() -> None:
    """Make recordings as a stylus would, of a material of the library, and print their truth.

    Fitted again, they show what a fit can resolve with this rate, noise and sensor.
    """


def _stylus_options(command: _F) -> _F:
    """What lies between the surface and the numbers."""
    for option in (
        json_option,
        overwrite_option,
        click.option(
            "--seed",
            type=click.IntRange(min=0),
            default=1,
            show_default=True,
            help="Seed of noise, tremor and scatter.",
        ),
        _number("--position-step", "position_step_m", 0.0, 1.0, "M", "Step of the positions; 0: exact.", 0.0),
        _number("--drift", "drift_m_per_s3", -1e3, 1e3, "M/S^3", "Drift of the acceleration.", 0.0),
        _number("--tremor", "tremor_m_per_s2", 0.0, 1e3, "M/S^2", "Amplitude of the hand's tremor.", 0.0),
        _number("--full-scale", "full_scale_m_per_s2", 1e-3, 1e9, "M/S^2", "The sensor clips larger accelerations."),
        click.option(
            "--filter-order", type=click.IntRange(1, 8), default=2, show_default=True, help="Order of the filter."
        ),
        _number("--filter", "filter_hz", 1.0, 1e6, "HZ", "Corner of a low-pass filter, Butterworth's."),
        _number(
            "--mounting-damping",
            "mounting_damping",
            1e-4,
            0.999,
            "PART",
            "Damping ratio of the mounting; 1: critical.",
            0.05,
        ),
        _number("--mounting", "mounting_hz", 1.0, 1e6, "HZ", "Resonance of the sensor on its mounting."),
        _number(
            "--noise", "noise_rms", 0.0, 10.0, "PART", "RMS of the noise, as a part of the largest acceleration.", 0.02
        ),
        _number("--rate", "rate_hz", 100.0, 1e6, "HZ", "Samples a second.", 25_000.0),
        config_option,
        click.option(
            "-o",
            "--output",
            required=True,
            type=click.Path(),
            metavar=f"FILE{ENDING}",
            help="Write the recording there; several get numbers.",
        ),
    ):
        command = option(command)
    return command


def _number(
    flag: str, name: str, low: float, high: float, unit: str, text: str, default: float | None = None
) -> Callable[[_F], _F]:
    return click.option(
        flag, name, type=Finite(low, high), metavar=unit, default=default, show_default=default is not None, help=text
    )


def _several(flag: str, name: str, high: float, unit: str, text: str, default: Sequence[float]) -> Callable[[_F], _F]:
    shown = " ".join(f"{each:g}" for each in default)
    return click.option(
        flag, name, type=Finite(1e-4, high), multiple=True, metavar=unit, help=f"{text} [default: {shown}]."
    )


def _material_option(default: str) -> Callable[[_F], _F]:
    return click.option(
        "--material",
        "name",
        default=default,
        show_default=True,
        metavar="NAME",
        shell_complete=names.shipped_materials,
        help="A material of the library, or of a file that is given with -c.",
    )


_stroke_options: Final = (
    _several("--speed", "speeds", 5.0, "M/S", "Speed of a stroke; several: a stroke at each", STROKE_SPEEDS),
    _several("--force", "forces", 100.0, "N", "Normal force; several: a stroke at each speed and force", STROKE_FORCES),
)


@synthesize_command.command("tap")
@_material_option("wood")
@_several("--speed", "speeds", 10.0, "M/S", "Speed of a tap; several: one tap each", TAP_SPEEDS)
@_stylus_options
def tap_command(name: str, speeds: tuple[float, ...], **options: Any) -> None:
    """Taps at several speeds, in one recording."""

    def make(material: Material, stylus: Stylus) -> tuple[list[Recording], _Truth]:
        from hapticd.fit.synthesize import taps

        tap = material.tap
        if tap is None:
            raise ValueError("it has no tap")
        if tap.second is not None:
            raise ValueError("synthetic taps ring with one mode, and it has two")
        if tap.waveform is not None:
            raise ValueError("synthetic taps ring, and its tap is a waveform")
        recording, truth = taps(tap, speeds or TAP_SPEEDS, stylus)
        mode = truth.mode
        return [recording], {
            "slope_per_s": truth.slope_per_s,
            "first_peak_slope_per_s": truth.slope_per_s * mode.peak,
            "frequency_hz": mode.frequency_hz,
            "decay_time_s": mode.decay_time_s,
        }

    _run("tap", name, make, **options)


@synthesize_command.command("grooves")
@_material_option("comb")
@_stroke_options[0]
@_stroke_options[1]
@_number("--duration", "duration_s", 0.05, 600.0, "S", "Duration of a stroke.", 1.0)
@_stylus_options
def grooves_command(
    name: str, speeds: tuple[float, ...], forces: tuple[float, ...], duration_s: float, **options: Any
) -> None:
    """Strokes over grooves, each in a recording of its own."""

    def make(material: Material, stylus: Stylus) -> tuple[list[Recording], _Truth]:
        from hapticd.config.texture import Grooves
        from hapticd.fit.synthesize import Hand, grooves

        table = material.texture.frequency_table if isinstance(material.texture, Grooves) else None
        if table is not None:
            raise HapticdError(f"{name}: its frequency follows speed and force; the fit finds grooves of one frequency")
        hand = Hand(duration_s=duration_s)
        found = [grooves(material, *pair, each, hand) for pair, each in _pairs(speeds, forces, stylus)]
        texture, mode = material.texture, material.groove_mode
        assert isinstance(texture, Grooves) and mode is not None  # otherwise there are no strokes of it
        return found, {
            "spacing_m": texture.spacing_m,
            "frequency_hz": mode.frequency_hz,
            "decay_time_s": mode.decay_time_s,
            "velocity_gain_per_s": texture.velocity_gain_per_s,
            "force_gain_m_per_s2_per_n": texture.force_gain_m_per_s2_per_n,
        }

    _run("grooves", name, make, **options)


@synthesize_command.command("texture", short_help="Strokes over sandpaper and the like.")
@_material_option("sandpaper_100")
@_stroke_options[0]
@_stroke_options[1]
@_number("--duration", "duration_s", 0.05, 600.0, "S", "Duration of a stroke.", 10.0)
@_stylus_options
def texture_command(
    name: str, speeds: tuple[float, ...], forces: tuple[float, ...], duration_s: float, **options: Any
) -> None:
    """Strokes over sandpaper and the like, each in a recording of its own."""

    def make(material: Material, stylus: Stylus) -> tuple[list[Recording], _Truth]:
        from hapticd.config.texture import Stochastic
        from hapticd.fit.synthesize import Hand, texture

        hand = Hand(duration_s=duration_s)
        found = [texture(material, *pair, each, hand) for pair, each in _pairs(speeds, forces, stylus)]
        coarse = material.texture
        if not isinstance(coarse, Stochastic):
            return found, {}  # The truth is the models of the material itself.
        return found, {
            "peak_hz": coarse.peak_hz,
            "mean_hz": coarse.mean_hz,
            "velocity_gain_per_s": coarse.velocity_gain_per_s,
            "force_gain_m_per_s2_per_n": coarse.force_gain_m_per_s2_per_n,
        }

    _run("texture", name, make, **options)


@synthesize_command.command("puncture")
@_material_option("cellophane")
@_several("--speed", "speeds", 5.0, "M/S", "Speed of a puncture; several: one each", PUNCTURE_SPEEDS)
@_stylus_options
def puncture_command(name: str, speeds: tuple[float, ...], **options: Any) -> None:
    """Punctures of a membrane, each in a recording of its own."""

    def make(material: Material, stylus: Stylus) -> tuple[list[Recording], _Truth]:
        from hapticd.fit.synthesize import puncture

        chosen = speeds or PUNCTURE_SPEEDS
        found = [
            puncture(material, speed, each) for speed, each in zip(chosen, _others(stylus, len(chosen)), strict=True)
        ]
        rupture = material.rupture
        assert rupture is not None  # otherwise there are no punctures of it
        return found, {
            "stiffness_n_per_m": material.stiffness_n_per_m,
            "depth_m": rupture.rupture_depth_m,
            "force_n": material.stiffness_n_per_m * rupture.rupture_depth_m,
            "amplitude_m_per_s2": rupture.amplitude_m_per_s2,
            "frequency_hz": rupture.mode.frequency_hz,
            "decay_rate_per_s": rupture.mode.decay_rate_per_s,
        }

    _run("puncture", name, make, **options)


def _pairs(
    speeds: Sequence[float], forces: Sequence[float], stylus: Stylus
) -> list[tuple[tuple[float, float], Stylus]]:
    """Each speed with each force, and a stylus of its own chance for it."""
    pairs = [(speed, force) for speed in speeds or STROKE_SPEEDS for force in forces or STROKE_FORCES]
    return list(zip(pairs, _others(stylus, len(pairs)), strict=True))


def _others(stylus: Stylus, count: int) -> list[Stylus]:
    """Of seeds that follow one another far apart, so that two commands with seeds side by side share none."""
    from dataclasses import replace

    return [replace(stylus, seed=1000 * stylus.seed + index) for index in range(count)]


def _run(
    kind: str,
    name: str,
    make: Callable[[Material, Stylus], tuple[list[Recording], _Truth]],
    output: str,
    configs: tuple[str, ...],
    overwrite: bool,
    as_json: bool,
    full_scale_m_per_s2: float | None,
    **stylus: Any,
) -> None:
    from hapticd.config.configuration import config_of
    from hapticd.fit.recording import npz_of
    from hapticd.fit.synthesize import Stylus

    if os.path.splitext(output)[1].lower() != ENDING:
        raise HapticdError(f"{output}: is no recording: must end in {ENDING}")
    materials: Mapping[str, Material] = config_of(configs).materials
    if name not in materials:
        known = known_names(name, materials)
        raise HapticdError(f"unknown material {quoted(name)}; {known}; a material of your own is given with -c FILE")
    made = Stylus(**stylus, full_scale_m_per_s2=math.inf if full_scale_m_per_s2 is None else full_scale_m_per_s2)
    try:
        recordings, truth = make(materials[name], made)
    except ValueError as error:
        raise HapticdError(f"{quoted(name)} cannot be recorded: {error}") from None
    targets = _targets(output, len(recordings))
    for target in targets:
        check_new(target, overwrite)
    for target, recording in zip(targets, recordings, strict=True):
        write_whole(target, npz_of(recording), overwrite)
    if as_json:
        print_json({"kind": kind, "material": name, "truth": truth, "files": targets})
        return
    from hapticd.config.schema import unit_of

    for key, value in truth.items():
        click.echo(f"{key}: {value:.6g} {unit_of(key) or ''}".rstrip())
    if not truth:
        note(f"the truth of {name} is its models")
    note(f"{wording.count(len(targets), 'recording')} of {name}: {', '.join(targets)}")


def _targets(output: str, count: int) -> list[str]:
    """Names of so many files: the one that was given, or that with -1, -2 and so on."""
    if count == 1:
        return [output]
    stem, ending = os.path.splitext(output)
    return [f"{stem}-{index + 1:0{len(str(count))}d}{ending}" for index in range(count)]
