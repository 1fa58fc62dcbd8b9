"""`hapticd calibrate`: what handle and grip are."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Literal

import click

from hapticd.base.files import check_new, write_whole
from hapticd.base.yaml_text import yaml_text
from hapticd.cli.common import (
    Choice,
    Finite,
    config_option,
    json_option,
    note,
    overwrite_option,
    print_json,
)

if TYPE_CHECKING:
    from hapticd.analysis.calibration.handle import Calibration

DEFAULT_FORCE_N = 1.0
TAKE_HOLD_S = 5.0
"""To take the handle, where nobody is asked."""


@click.command("calibrate", short_help="Measure handle and grip.")
@config_option
@click.option("-o", "--output", type=click.Path(), metavar="FILE", help="Write the device section there, too.")
@overwrite_option
@click.option("--plot", type=click.Path(), metavar="FILE.png", help="Draw response and fit (needs matplotlib).")
@click.option(
    "--accelerometer",
    type=click.Path(),
    metavar="FILE",
    help="Recording of an accelerometer on the handle (.npz or .csv: time_s, acceleration_m_per_s2).",
)
@click.option("--axis", type=Choice(["x", "y"]), default="x", show_default=True, help="The axis that is driven.")
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
    simulated = config.device.kind == "sim"

    def ask(held: bool) -> None:
        if simulated:
            return
        if yes:
            time.sleep(TAKE_HOLD_S if held else 0.0)
            return
        what = "Hold the handle in the middle as it will be used." if held else "Let go of the handle, in the middle."
        click.confirm(f"{what} It will move for half a minute with up to {force_n:g} N. Ready?", abort=True, err=True)

    def recorded() -> None:
        if not simulated and not yes:
            click.confirm(f"Stop the accelerometer. Is its recording in {accelerometer}?", abort=True, err=True)

    try:
        with _progress() as progress:
            found = handle.calibrate(config, axis, force_n, ask, progress, wide=accelerometer is not None)
    except KeyboardInterrupt:
        note("interrupted; the force is zero, nothing was written")
        raise
    if accelerometer is not None:
        recorded()
        found = handle.with_accelerometer(found, accelerometer)
    section = found.section()
    if as_json:
        print_json({**found.to_dict(), **section})
    else:
        # The section is what is read on, where it goes to no file: then the table is beside it.
        _table(found, beside=output is None)
        if output is None:
            click.echo(yaml_text(section))
    if output is not None:
        write_whole(output, yaml_text(section) + "\n", overwrite)
    if plot is not None:
        write_whole(plot, handle.picture(found, plot), overwrite)


@contextmanager
def _progress() -> Iterator[Callable[[str], None]]:
    """What is being done, in one line on a terminal."""
    if not sys.stderr.isatty():
        yield lambda text: None
        return
    from rich.console import Console

    with Console(stderr=True).status("calibrating") as status:
        # A question needs the line for itself.
        def show(text: str) -> None:
            if text:
                status.start()
                status.update(text)
            else:
                status.stop()

        yield show


def _table(found: Calibration, beside: bool) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(title=f"{found.kind}, axis {found.axis}")
    for head in ("", "value", "95 % bounds", "unit"):
        table.add_column(head, justify="left" if head in ("", "unit") else "right")
    for name, estimate, unit in found.rows():
        table.add_row(name, f"{estimate.value:.4g}", f"{estimate.low:.4g} to {estimate.high:.4g}", unit)
    console = Console(stderr=beside, soft_wrap=True)
    console.print(table)
    for line in found.notes():
        console.print(line, markup=False, highlight=False)
