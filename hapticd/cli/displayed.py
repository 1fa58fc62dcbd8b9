"""`hapticd check` computes what a device can display; `calibrate` measures the handle, `verify` the vibrations."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final, Literal

import click

from hapticd.base import wording
from hapticd.base.errors import HapticdError
from hapticd.base.files import check_new, write_atomically
from hapticd.base.yaml_text import yaml_text
from hapticd.cli import names
from hapticd.cli.common import (
    Finite,
    config_option,
    json_option,
    note,
    output_option,
    overwrite_option,
    print_json,
    print_table,
    status_line,
)
from hapticd.rendering.stability_text import stability_words

if TYPE_CHECKING:
    from hapticd.analysis.check import Checked, Report
    from hapticd.config.configuration import Config
    from hapticd.rendering.stability import Margin

DEFAULT_DRIVE_FORCE_N: Final = 1.0
"""Largest force of `hapticd calibrate` by default, in N."""
TAKE_HOLD_PAUSE_S: Final = 5.0
"""Pause of `hapticd calibrate --yes`, in s: time for the user to take the handle."""
_ACCELEROMETER_HELP: Final = (
    "Recording of an accelerometer on the handle, .npz or .csv with time_s and acceleration_m_per_s2"
)
_LET_GO_TEXT: Final = "Let go of the handle in the middle of its travel."
_TAKE_HOLD_TEXT: Final = "Hold the handle in the middle of its travel as it will be used."


@click.command("check", short_help="Check what can be displayed and what may oscillate.")
@click.argument("files", nargs=-1, metavar="[FILE]...", shell_complete=names.scenes)
@config_option
@click.option("--offline", is_flag=True, help="Accept that the joystick of the configuration is not connected.")
@json_option
def check_command(files: tuple[str, ...], configs: tuple[str, ...], offline: bool, as_json: bool) -> int:
    """Check which materials and surfaces can be displayed with this device, rate and grip.

    FILEs override the configuration, as materials and a scene do. Nothing moves, and no daemon is needed. The exit code
    is 0 if all of the scene can be displayed as written and nothing may oscillate, otherwise 1. Unknown stability, as
    of a joystick without device.handle, and stability that is not proved are reported, and do not change the exit code.
    """
    from hapticd.analysis.check import check
    from hapticd.config.configuration import config_of

    config = config_of((*configs, *files))
    report = check(config, offline=offline)
    if as_json:
        print_json(report.to_dict())
    else:
        _print(report, config.device.kind != "replay")
    if report.faults:
        note(f"{wording.count(report.faults, 'thing')} of the scene cannot be displayed as written, or may oscillate")
    return 1 if report.faults else 0


def _print(report: Report, measurable: bool) -> None:
    from hapticd.rendering.compensation import ERROR_BAND_LOW_HZ, ERROR_BAND_RATE_FRACTION
    from hapticd.rendering.rearm import rearm_text

    output, stability = report.output, report.stability
    link = "" if output.link_rate_hz is None else f", forces carried at {wording.si(output.link_rate_hz, 'Hz')}"
    click.echo(f"device: {report.device}; servo at {wording.si(output.rate_hz, 'Hz')}{link}")
    if stability.assumed is not None:
        dynamics, timing = stability.assumed.dynamics, stability.assumed.timing
        click.echo(
            f"handle: {dynamics.handle_mass_kg:g} kg, {dynamics.handle_damping_n_s_per_m:g} N s/m, "
            f"{dynamics.friction_n:g} N dry friction; "
            f"hand: {dynamics.grip_mass_kg:g} kg, {dynamics.grip_damping_n_s_per_m:g} N s/m, "
            f"{dynamics.grip_stiffness_n_per_m:g} N/m; positions {1e3 * timing.delay_s:.4g} ms old, forces held for "
            f"{1e3 * timing.period_s:.4g} ms, encoder step {1e6 * stability.assumed.encoder_step_m:g} um"
        )
    columns = ["", "in the scene", ">N/m", "sounds", ">error"]
    columns += ["fit"] if any(material.verdict for material in report.materials) else []
    materials = sorted(report.materials, key=lambda material: not material.used)
    rows = [_material_row(material)[: len(columns)] for material in materials]
    print_table(columns, rows, "Materials", wrapped="sounds")
    if output.dynamics is not None:
        band = f"from {ERROR_BAND_LOW_HZ:g} to {ERROR_BAND_RATE_FRACTION * output.carried_hz:g} Hz"
        sent = ", sent at any time within a frame of the link" if output.slow_link else ""
        click.echo(
            "error: RMS of the difference between the handle's acceleration and the library's, over the library's RMS, "
            f"{band}{sent}, with compensation: {output.compensation}"
        )
    again = rearm_text(output.rearm_m, report.encoder_step_m, output.rate_hz, measurable)
    if again is not None:
        click.echo(again)
    if stability.sets:
        numbers = [">N/m", ">safe in any hand below", ">stable in this hand below", ">margin"]
        columns = ["objects", *numbers, "verdict", "by"]
        print_table(columns, map(_set_row, stability.worst), "What can be touched together", wrapped="objects")
        if stability.sets > len(stability.worst):
            shown = f"shown: {len(stability.worst)} of {stability.sets} sets, those with the least margins"
            click.echo(f"{shown}; {stability.unsafe} of all sets are not safe")
    for what, text in stability_words(stability.to_dict()):
        if what != "unsafe":  # these are among the problems below
            click.echo(f"{what}: {text}")
    for problem in (*report.refused, *report.undisplayable, *report.warnings, *stability.problems(), *report.notes):
        click.echo(str(problem))
    if report.faults == 0:
        click.echo("all of the scene can be displayed")


def _material_row(material: Checked) -> tuple[str, ...]:
    sounds, errors = [], []
    for sound in material.sounds:
        shown = ": silent" if sound.shown_hz is None else f": lowered to {sound.shown_hz:.4g} Hz"
        as_it_is = sound.shown_hz == sound.frequency_hz
        sounds.append(f"{sound.use} {sound.frequency_hz:.4g} Hz{'' if as_it_is else shown}")
        if sound.error is not None:
            errors.append(f"{100 * sound.error:.0f} %")
    fits = ", ".join(f"{kind} {quality}" for kind, quality in material.verdict.items())
    used, stiffness = "yes" if material.used else "", f"{material.stiffness_n_per_m:g}"
    return material.name, used, stiffness, ", ".join(sounds) or "none", ", ".join(errors), fits


def _set_row(margin: Margin) -> tuple[str, ...]:
    more = f" and {len(margin.objects) - 4} more" if len(margin.objects) > 4 else ""
    held = margin.held_limit_n_per_m
    return (
        ", ".join(margin.objects[:4]) + more,
        wording.number(margin.stiffness_n_per_m),
        wording.number(margin.limit_n_per_m),
        "any" if held == float("inf") else wording.number(held),
        "" if margin.margin == float("inf") else f"{margin.margin:.3g}",
        margin.verdict,
        margin.limited_by,
    )


@click.command("calibrate", short_help="Measure the handle and the grip on it.")
@config_option
@output_option("File for the device section, in addition to the output.")
@overwrite_option
@click.option("--plot", type=click.Path(), metavar="FILE.png", help="Plot of response and fit; needs matplotlib.")
@click.option("--accelerometer", type=click.Path(), metavar="FILE", help=f"{_ACCELEROMETER_HELP}.")
@click.option("--axis", type=click.Choice(["x", "y"]), default="x", show_default=True, help="Axis to drive.")
@click.option(
    "--force-n",
    type=Finite(min=0.05),
    default=DEFAULT_DRIVE_FORCE_N,
    show_default=True,
    metavar="N",
    help="Largest force, limited to max_force_n of the device.",
)
@click.option("--yes", is_flag=True, help="Do not ask; take the handle within 5 s after the first drive.")
@json_option
def calibrate_command(
    configs: tuple[str, ...],
    output: str | None,
    overwrite: bool,
    plot: str | None,
    accelerometer: str | None,
    axis: Literal["x", "y"],
    force_n: float,
    yes: bool,
    as_json: bool,
) -> None:
    """Measure mass, damping and dry friction of the handle, and mass, damping and stiffness of the hand on it.

    Weak bursts drive the handle along one axis: half a minute released, then half a minute held as it will be used.
    Their frequencies rise from a few hertz until the motion is less than an encoder step. The parameters of the hand
    are the difference of the two measurements. The command fails if the handle leaves the middle third of its travel.
    Ctrl-C sets the force to zero.
    """
    from hapticd.analysis.calibration import handle
    from hapticd.analysis.calibration.accelerometer import check_name

    # Checked before the drives, which take a minute.
    for target in (output, plot):
        if target is not None:
            check_new(target, overwrite)
    if plot is not None:
        handle.check_picture(plot)
    if accelerometer is not None:
        check_name(accelerometer)
    config = _driven_config(configs)
    asks = config.device.kind != "sim" and not yes

    def ask(held: bool) -> None:
        if asks:
            drive = f"It will move for half a minute with up to {force_n:g} N. Ready?"
            click.confirm(f"{_TAKE_HOLD_TEXT if held else _LET_GO_TEXT} {drive}", abort=True, err=True)
        elif held and config.device.kind != "sim":
            time.sleep(TAKE_HOLD_PAUSE_S)

    try:
        with status_line() as show:
            found = handle.calibrate(config, axis, force_n, ask, show, wide=accelerometer is not None)
    except KeyboardInterrupt:
        note("interrupted; the force is zero, nothing was written")
        raise
    if accelerometer is not None:
        _ask_for(accelerometer, asks)
        found = handle.with_accelerometer(found, accelerometer)
    section = found.section()
    if as_json:
        print_json({**found.to_dict(), **section})
    else:
        # Without -o stdout is for the section, and the table goes to stderr.
        table_on_stderr = output is None
        rows = [
            (name, f"{each.value:.4g}", f"{each.low:.4g} to {each.high:.4g}", unit) for name, each, unit in found.rows()
        ]
        title = f"{found.kind}, axis {found.axis}"
        print_table(("", ">value", ">95 % bounds", "unit"), rows, title, stderr=table_on_stderr)
        for line in found.notes():
            click.echo(line, err=table_on_stderr)
        if table_on_stderr:
            click.echo(yaml_text(section))
    if output is not None:
        write_atomically(output, yaml_text(section) + "\n", overwrite)
    if plot is not None:
        write_atomically(plot, handle.picture(found, plot), overwrite)


def _driven_config(configs: tuple[str, ...]) -> Config:
    """Return the configuration of a device that is to be driven. Raises HapticdError for a recording."""
    from hapticd.config.configuration import config_of

    config = config_of(configs)
    if config.device.kind == "replay":
        raise HapticdError("device.kind replay: forces do not move a recording; give the configuration of the joystick")
    return config


def _ask_for(recording: str, asks: bool) -> None:
    if asks:
        click.confirm(f"Stop the accelerometer. Is its recording in {recording}?", abort=True, err=True)


@click.command("verify", short_help="Measure how well materials are displayed.")
@config_option
@click.option(
    "--recording", type=click.Path(), metavar="FILE", help=f"{_ACCELEROMETER_HELP}; required for a real device."
)
@click.option(
    "--scale",
    type=Finite(-1e6, 1e6),
    default=1.0,
    show_default=True,
    metavar="FACTOR",
    help="Factor for the accelerations of the recording.",
)
@click.option(
    "--speed", type=Finite(min=1e-3, max=5), default=0.1, show_default=True, metavar="M_PER_S", help="Speed of a tap."
)
@click.option("--axis", type=click.Choice(["x", "y"]), default="y", show_default=True, help="Axis of the strikes.")
@click.option("--yes", is_flag=True, help="Begin without asking.")
@json_option
def verify_command(
    configs: tuple[str, ...],
    recording: str | None,
    scale: float,
    speed: float,
    axis: Literal["x", "y"],
    yes: bool,
    as_json: bool,
) -> None:
    """Measure the error of the handle's acceleration for each tap, groove and rupture of the materials.

    Taps and grooves are played as for --speed, grooves with a normal force of 1 N. The error is the RMS of measured
    minus nominal acceleration, divided by the RMS of the nominal one, from 30 Hz to 0.4 of the rate of servo or link,
    whichever is lower.

    With the simulated joystick the motion is known exactly, and each tap is also measured on a wall of its material. A
    real device needs an accelerometer that records meanwhile. Hold the handle as it will be used. Strikes follow each
    other every half second.
    """
    from hapticd.analysis.calibration import verify
    from hapticd.analysis.calibration.accelerometer import load_recording
    from hapticd.rendering.displayability import preload_notes

    config = _driven_config(configs)
    simulated = config.device.kind == "sim"
    if not simulated and recording is None:
        raise HapticdError("a real device needs an accelerometer on its handle: give --recording FILE")
    if not simulated and not yes:
        click.confirm("Hold the handle, and start the accelerometer. Ready?", abort=True, err=True)
    strikes = verify.strikes_of(config.materials, speed)
    try:
        played = verify.play(config, strikes, axis)
    except KeyboardInterrupt:
        note("interrupted; the force is zero")
        raise
    if recording is None:
        verdicts = [*verify.from_simulation(config, played), *verify.compare_on_walls(config, speed, axis)]
    else:
        _ask_for(recording, not simulated and not yes)
        verdicts = verify.from_recording(played, load_recording(recording, scale))
    if as_json:
        print_json([verdict.to_dict() for verdict in verdicts])
        return
    rows = [
        (
            each.strike.material,
            each.strike.use,
            f"{each.strike.mode.frequency_hz:.4g}",
            "silent" if each.displayed_hz is None else f"{each.displayed_hz:.4g}",
            f"{each.strike.coefficient_m_per_s2:.3g}",
            f"{each.force_n:.2f}",
            f"{each.strength:.3f}",
            f"{100 * each.error:.1f} %",
        )
        for each in verdicts
    ]
    print_table(("material", "use", ">Hz", ">shown Hz", ">m/s²", ">N", ">strength", ">error"), rows)
    for problem in preload_notes(config.materials, played.output, speed) if recording is None else ():
        click.echo(str(problem))
