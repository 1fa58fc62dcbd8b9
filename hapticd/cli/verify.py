"""`hapticd verify`: how far what a device displays is from the library."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import click

from hapticd.base.errors import HapticdError
from hapticd.cli.common import Choice, Finite, config_option, json_option, note, print_json

if TYPE_CHECKING:
    from hapticd.analysis.calibration.verify import Verdict


@click.command("verify", short_help="Measure how materials are displayed.")
@config_option
@click.option(
    "--recording",
    type=click.Path(),
    metavar="FILE",
    help="Recording of an accelerometer on the handle (.npz or .csv: time_s, acceleration_m_per_s2); a real "
    "device needs one.",
)
@click.option(
    "--scale",
    type=Finite(),
    default=1.0,
    show_default=True,
    metavar="FACTOR",
    help="The recording's numbers are multiplied by it.",
)
@click.option(
    "--speed", type=Finite(min=1e-3, max=5), default=0.1, show_default=True, metavar="M_PER_S", help="Speed of a tap."
)
@click.option(
    "--axis", type=Choice(["x", "y"]), default="y", show_default=True, help="Axis along which materials are struck."
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
    if not simulated:
        if recording is None:
            raise HapticdError("a real device is verified by an accelerometer on its handle: give --recording FILE")
        if not yes:
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
        if not simulated and not yes:
            click.confirm(f"Stop the accelerometer. Is its recording in {recording}?", abort=True, err=True)
        verdicts = verify.from_recording(played, load_recording(recording, scale))
    if as_json:
        print_json([verdict.to_dict() for verdict in verdicts])
    else:
        _table(verdicts)


def _table(verdicts: list[Verdict]) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table

    # As narrow as it can be: on 80 columns no number may be cut off.
    table = Table(box=box.SIMPLE, show_edge=False, padding=(0, 1, 0, 0))
    for head in ("material", "use", "Hz", "shown Hz", "m/s²", "N", "strength", "error"):
        table.add_column(head, justify="left" if head in ("material", "use") else "right", no_wrap=True)
    for each in verdicts:
        strike = each.strike
        table.add_row(
            strike.material,
            strike.use,
            f"{strike.mode.frequency_hz:.4g}",
            "silent" if each.displayed_hz is None else f"{each.displayed_hz:.4g}",
            f"{strike.coefficient_m_per_s2:.3g}",
            f"{each.force_n:.2f}",
            f"{each.strength:.3f}",
            f"{100 * each.error:.1f} %",
        )
    Console(soft_wrap=True).print(table)
