"""`hapticd check`: what of a configuration can be shown, before anything moves."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from hapticd.base import wording
from hapticd.cli.common import config_option, json_option, note, print_json, print_table
from hapticd.rendering.stability_text import stability_words

if TYPE_CHECKING:
    from hapticd.analysis.check import Checked, Report
    from hapticd.rendering.stability import Margin


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
        _print(report)
    if report.faults:
        things = "one thing" if report.faults == 1 else f"{report.faults} things"
        note(f"{things} of the scene cannot be displayed as written, or may oscillate")
    return 1 if report.faults else 0


def _print(report: Report) -> None:
    from hapticd.rendering.rearm import words as rearm_words

    output, stability = report.output, report.stability
    link = "" if output.link_rate_hz is None else f", forces carried at {wording.si(output.link_rate_hz, 'Hz')}"
    click.echo(f"device: {report.device}; servo at {wording.si(output.rate_hz, 'Hz')}{link}")
    if stability.assumed is not None:
        told, timing = stability.assumed.dynamics, stability.assumed.timing
        click.echo(
            f"handle: {told.handle_mass_kg:g} kg, {told.handle_damping_n_s_per_m:g} N s/m, {told.friction_n:g} N dry; "
            f"hand: {told.grip_mass_kg:g} kg, {told.grip_damping_n_s_per_m:g} N s/m, "
            f"{told.grip_stiffness_n_per_m:g} N/m; positions {1e3 * timing.delay_s:.4g} ms old, forces held for "
            f"{1e3 * timing.period_s:.4g} ms, encoder step {1e6 * stability.assumed.encoder_step_m:g} um"
        )
    columns = ["", "in the scene", ">N/m", "sounds", ">error"]
    columns += ["fit"] if any(material.verdict for material in report.materials) else []
    materials = sorted(report.materials, key=lambda material: not material.used)
    rows = [_material_row(material)[: len(columns)] for material in materials]
    print_table(columns, rows, "Materials", broken="sounds")
    if output.dynamics is not None:
        click.echo(
            "error: RMS of the difference between the handle's acceleration and the library's, over the library's RMS, "
            f"from 30 Hz to 0.4 of the rate, with compensation: {output.compensation}"
        )
    again = rearm_words(output.rearm_m, report.encoder_step_m, output.rate_hz)
    if again is not None:
        click.echo(again)
    if stability.sets:
        numbers = [">N/m", ">safe in any hand up to", ">stable in this hand up to", ">margin"]
        columns = ["objects", *numbers, "verdict", "by"]
        print_table(columns, map(_set_row, stability.worst), "What can be touched together", broken="objects")
        if stability.sets > len(stability.worst):
            least = f"shown are those with the least margin of {stability.sets} sets"
            click.echo(f"{least}, {stability.unsafe} of them not safe")
    for what, text in stability_words(stability.to_dict()):
        if what != "unsafe":  # these are among the problems below
            click.echo(f"{what}: {text}")
    for problem in (*report.refused, *report.undisplayable, *report.warnings, *stability.problems(), *report.notes):
        click.echo(str(problem))
    if report.faults == 0:
        click.echo("all of the scene can be shown")


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
