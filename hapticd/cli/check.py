"""`hapticd check`: what of a configuration can be shown, before anything moves."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import click

from hapticd.base import wording
from hapticd.cli.common import config_option, json_option, note, print_json
from hapticd.rendering.stability_text import stability_words

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from hapticd.analysis.check import Report

_NUMBER: Final = 9
"""As wide as 1,234,567."""


@click.command("check", short_help="Check what can be displayed, and what may oscillate.")
@config_option
@json_option
def check_command(configs: tuple[str, ...], as_json: bool) -> int:
    """Check which materials and surfaces can be displayed with this device, rate and grip. Nothing moves,
    and no daemon is needed.

    The exit code is 0 if all of the scene can be displayed as written and nothing of it oscillates, otherwise 1. If the
    stability is unknown, as of a joystick without device.handle, or not proved, this is printed and does not count.
    """
    from hapticd.analysis.check import check
    from hapticd.config.configuration import config_of

    report = check(config_of(configs))
    if as_json:
        print_json(report.to_dict())
    else:
        from rich.console import Console

        _print(report, Console(highlight=False, soft_wrap=True))
    if report.faults == 0:
        return 0
    things = "one thing" if report.faults == 1 else f"{report.faults} things"
    note(f"{things} of the scene cannot be displayed as written, or may oscillate")
    return 1


def _print(report: Report, console: Console) -> None:
    from hapticd.rendering.rearm import words as rearm_words

    output, stability = report.output, report.stability
    link = "" if output.link_rate_hz is None else f", forces carried at {wording.si(output.link_rate_hz, 'Hz')}"
    console.print(f"device: {report.device}; servo at {wording.si(output.rate_hz, 'Hz')}{link}", markup=False)
    if stability.assumed is not None:
        told, timing = stability.assumed.dynamics, stability.assumed.timing
        console.print(
            f"handle: {told.handle_mass_kg:g} kg, {told.handle_damping_n_s_per_m:g} N s/m, {told.friction_n:g} N dry; "
            f"hand: {told.grip_mass_kg:g} kg, {told.grip_damping_n_s_per_m:g} N s/m, "
            f"{told.grip_stiffness_n_per_m:g} N/m; positions {1e3 * timing.delay_s:.4g} ms old, forces held for "
            f"{1e3 * timing.period_s:.4g} ms, encoder step {1e6 * stability.assumed.encoder_step_m:g} um",
            markup=False,
        )
    table = _table("Materials")
    columns = [("", "left"), ("in the scene", "left"), ("N/m", "right"), ("sounds", "left"), ("error", "right")]
    fitted = any(material.verdict for material in report.materials)
    if fitted:
        columns.append(("fit", "left"))
    for name, justify in columns:
        table.add_column(name, justify="right" if justify == "right" else "left")
    for material in sorted(report.materials, key=lambda material: not material.used):
        sounds = []
        for sound in material.sounds:
            shown = "silent" if sound.shown_hz is None else f"lowered to {sound.shown_hz:.4g} Hz"
            as_it_is = sound.shown_hz == sound.frequency_hz
            sounds.append(f"{sound.use} {sound.frequency_hz:.4g} Hz" + ("" if as_it_is else f": {shown}"))
        used = "yes" if material.used else ""
        errors = ["" if sound.error is None else f"{100 * sound.error:.0f} %" for sound in material.sounds]
        stiffness = f"{material.stiffness_n_per_m:g}"
        cells = [material.name, used, stiffness, ", ".join(sounds) or "none", ", ".join(filter(None, errors))]
        fits = ", ".join(f"{kind} {quality}" for kind, quality in material.verdict.items())
        table.add_row(*cells, *([fits] if fitted else []))
    console.print(table)
    if output.dynamics is not None:
        console.print(
            "error: RMS of the difference between the handle's acceleration and the library's, over the library's RMS, "
            "from 30 Hz to 0.4 of the rate, with "
            f"compensation: {output.compensation}"
        )
    again = rearm_words(output.rearm_m, report.encoder_step_m, output.rate_hz)
    if again is not None:
        console.print(again, markup=False)
    if stability.sets:
        console.print(_sets(report))
        left = stability.sets - len(stability.worst)
        if left > 0:
            console.print(
                f"shown are those with the least margin of {stability.sets} sets, {stability.unsafe} of them not safe"
            )
    for what, text in stability_words(stability.to_dict()):
        if what == "unsafe":  # among the problems below
            continue
        console.print(f"{what}: {text}", markup=False)
    for problem in (*report.refused, *report.undisplayable, *report.warnings, *stability.problems(), *report.notes):
        console.print(str(problem), markup=False)
    if report.faults == 0:
        console.print("all of the scene can be shown", markup=False)


def _table(title: str) -> Table:
    """As narrow as it can be: on 80 columns lists give way, and no number or word is cut off."""
    from rich import box
    from rich.table import Table

    return Table(title=title, title_justify="left", box=box.SIMPLE, show_edge=False, padding=(0, 1, 0, 0))


def _sets(report: Report) -> Table:
    table = _table("What can be touched together")
    table.add_column("objects", overflow="fold")
    for name in ("N/m", "safe in any hand up to", "stable in this hand up to", "margin"):
        table.add_column(name, justify="right", min_width=_NUMBER)
    table.add_column("verdict", no_wrap=True)
    table.add_column("by", no_wrap=True)
    for margin in report.stability.worst:
        more = f" and {len(margin.objects) - 4} more" if len(margin.objects) > 4 else ""
        held = margin.held_limit_n_per_m
        table.add_row(
            ", ".join(margin.objects[:4]) + more,
            wording.number(margin.stiffness_n_per_m),
            wording.number(margin.limit_n_per_m),
            "any" if held == float("inf") else wording.number(held),
            "" if margin.margin == float("inf") else f"{margin.margin:.3g}",
            margin.verdict,
            margin.limited_by,
        )
    return table
