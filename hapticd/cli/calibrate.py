"""`hapticd calibrate` and `hapticd verify`: what handle and grip are, and how far what they display is from the
library."""

from __future__ import annotations

import time
from typing import Final, Literal

import click

from hapticd.base.errors import HapticdError
from hapticd.base.files import check_new, write_whole
from hapticd.base.yaml_text import yaml_text
from hapticd.cli.common import (
    Finite,
    config_option,
    doing,
    json_option,
    note,
    output_option,
    overwrite_option,
    print_json,
    print_table,
)

DEFAULT_FORCE_N: Final = 1.0
TAKE_HOLD_S: Final = 5.0
"""To take the handle, where nobody is asked."""
_ACCELEROMETER: Final = "Recording of an accelerometer on the handle (.npz or .csv: time_s, acceleration_m_per_s2)"
_FREE: Final = "Let go of the handle, in the middle."
_HELD: Final = "Hold the handle in the middle as it will be used."


@click.command("calibrate", short_help="Measure handle and grip.")
@config_option
@output_option("Write the device section there, too.")
@overwrite_option
@click.option("--plot", type=click.Path(), metavar="FILE.png", help="Draw response and fit (needs matplotlib).")
@click.option("--accelerometer", type=click.Path(), metavar="FILE", help=f"{_ACCELEROMETER}.")
@click.option("--axis", type=click.Choice(["x", "y"]), default="x", show_default=True, help="The axis that is driven.")
@click.option(
    "--force-n",
    type=Finite(min=0.05),
    default=DEFAULT_FORCE_N,
    show_default=True,
    metavar="N",
    help="Largest force; never more than the device's max_force_n.",
)
@click.option("--yes", is_flag=True, help="Begin at once: first the handle is free, 5 s later it is held.")
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

    The handle is driven along one axis by weak bursts from a few hertz up to where they move it by less than a step of
    its encoder: half a minute alone, then half a minute held as it will be used. The difference of the two is the hand.
    A handle that leaves the middle third of its travel ends it. Ctrl-C takes the force away.
    """
    from hapticd.analysis.calibration import handle
    from hapticd.analysis.calibration.accelerometer import check_name
    from hapticd.config.configuration import config_of

    # Nobody holds a handle for a minute to hear then that the result has no place to go.
    for target in (output, plot):
        if target is not None:
            check_new(target, overwrite)
    if plot is not None:
        handle.check_picture(plot)
    if accelerometer is not None:
        check_name(accelerometer)
    config = config_of(configs)
    asks = config.device.kind != "sim" and not yes

    def ask(held: bool) -> None:
        if asks:
            drive = f"It will move for half a minute with up to {force_n:g} N. Ready?"
            click.confirm(f"{_HELD if held else _FREE} {drive}", abort=True, err=True)
        elif held and config.device.kind != "sim":
            time.sleep(TAKE_HOLD_S)

    try:
        with doing() as show:
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
        # The section is what is read on, where it goes to no file: then the table is beside it.
        beside = output is None
        rows = [
            (name, f"{each.value:.4g}", f"{each.low:.4g} to {each.high:.4g}", unit) for name, each, unit in found.rows()
        ]
        title = f"{found.kind}, axis {found.axis}"
        print_table(("", ">value", ">95 % bounds", "unit"), rows, title, stderr=beside)
        for line in found.notes():
            click.echo(line, err=beside)
        if beside:
            click.echo(yaml_text(section))
    if output is not None:
        write_whole(output, yaml_text(section) + "\n", overwrite)
    if plot is not None:
        write_whole(plot, handle.picture(found, plot), overwrite)


def _ask_for(recording: str, asks: bool) -> None:
    if asks:
        click.confirm(f"Stop the accelerometer. Is its recording in {recording}?", abort=True, err=True)


@click.command("verify", short_help="Measure how materials are displayed.")
@config_option
@click.option("--recording", type=click.Path(), metavar="FILE", help=f"{_ACCELEROMETER}; a real device needs one.")
@click.option(
    "--scale",
    type=Finite(-1e6, 1e6),
    default=1.0,
    show_default=True,
    metavar="FACTOR",
    help="The recording's numbers are multiplied by it.",
)
@click.option(
    "--speed", type=Finite(min=1e-3, max=5), default=0.1, show_default=True, metavar="M_PER_S", help="Speed of a tap."
)
@click.option(
    "--axis",
    type=click.Choice(["x", "y"]),
    default="y",
    show_default=True,
    help="Axis along which materials are struck.",
)
@click.option("--yes", is_flag=True, help="Begin at once, without a question.")
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
    """Strike each material's tap, groove and rupture, and say how far the handle's acceleration is from the library.

    A tap is struck as at --speed, a groove as at that speed under 1 N. The error is the RMS of the difference over the
    RMS of the library's, from 30 Hz to 0.4 of the rate.

    The motion of the simulated handle is known exactly; each tap is also measured on a wall of its material. With a
    real device an accelerometer must record meanwhile; strikes are half a second apart. Hold the handle as it will
    be used.
    """
    from hapticd.analysis.calibration import verify
    from hapticd.analysis.calibration.accelerometer import load_recording
    from hapticd.config.configuration import config_of

    config = config_of(configs)
    simulated = config.device.kind == "sim"
    if not simulated and recording is None:
        raise HapticdError("a real device is verified by an accelerometer on its handle: give --recording FILE")
    if not simulated and not yes:
        click.confirm("Hold the handle, and start the accelerometer. Ready?", abort=True, err=True)
    strikes = verify.strikes_of(config.materials, speed)
    try:
        played = verify.play(config, strikes, axis)
    except KeyboardInterrupt:
        note("interrupted; the force is zero")
        raise
    if recording is None:
        verdicts = [*verify.from_simulation(config, played), *verify.verdicts_on_walls(config, speed, axis)]
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
