"""`hapticd fit`: materials from recordings."""

from __future__ import annotations

import datetime
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from hapticd.base.errors import HapticdError
from hapticd.base.files import check_new, write_whole
from hapticd.base.yaml_text import yaml_text
from hapticd.cli.common import (
    Choice,
    Finite,
    json_option,
    note,
    overwrite_option,
    print_json,
)
from hapticd.cli.fit_batch import batch_command
from hapticd.cli.synthesize import synthesize_command
from hapticd.fit.options import STIFFNESS_N_PER_M, FitOptions

if TYPE_CHECKING:
    from hapticd.config.modes import Attack
    from hapticd.fit.options import TapKind
    from hapticd.fit.recording import Kind
    from hapticd.fit.result import Fit
    from hapticd.fit.speed_law import LawKind

_F = TypeVar("_F", bound=Callable[..., Any])


@click.group("fit", no_args_is_help=False, short_help="Make a material from recordings.")
def fit_command() -> None:
    """Make a material from recordings of a stylus: acceleration, force and position, as CSV, npz or WAV.

    Columns may have other names and units than the known ones: FILE.yaml beside FILE describes them.
    """


fit_command.add_command(synthesize_command)
fit_command.add_command(batch_command)


def _options(command: _F) -> _F:
    for option in (
        json_option,
        overwrite_option,
        click.option("--strict", is_flag=True, help="Refuse what would be left out: a bad file, a clipped tap."),
        click.option("--merge", is_flag=True, help="Add to what the output holds, instead of replacing it."),
        click.option(
            "--stiffness",
            "stiffness_n_per_m",
            type=Finite(min=0, max=1e5),
            metavar="N/M",
            help=f"Stiffness of the material if the recordings do not determine it [default: {STIFFNESS_N_PER_M:g}].",
        ),
        click.option(
            "--report", type=click.Path(), metavar="FILE.html|.png", help="Draw recording and model (needs matplotlib)."
        ),
        click.option("--name", metavar="NAME", help="Name of the material [default: the output's, without .yaml]."),
        click.option("-o", "--output", type=click.Path(), metavar="FILE", help="Write the material there, as YAML."),
        click.argument("files", nargs=-1, required=True, type=click.Path(), metavar="FILES..."),
    ):
        command = option(command)
    return command


@fit_command.command("tap", short_help="Slope, frequency and decay of a tap.")
@_options
@click.option(
    "--attack",
    type=Choice(["coefficient", "first_peak"]),
    help="What the slope in the material means [default: coefficient].",
)
@click.option(
    "--law",
    type=Choice(["line", "power", "table"]),
    help="How the amplitude of the material follows the speed [default: the law with the lowest AICc].",
)
@click.option("--table", is_flag=True, help="The same as --law table: amplitudes over speed, instead of a slope.")
@click.option(
    "--two-modes/--one-mode",
    default=None,
    help="Two modes in the material, or one [default: two where one explains too little].",
)
@click.option(
    "--as",
    "form",
    type=Choice(["auto", "mode", "waveform"]),
    help="A mode that rings, a waveform of a pulse, or the one that explains the taps better [default: auto].",
)
@click.option(
    "--mode-table/--no-mode-table",
    default=None,
    help="Frequency and decay over the speed, or one of each [default: a table if they change].",
)
def tap_command(
    attack: Attack | None,
    law: LawKind | None,
    table: bool,
    two_modes: bool | None,
    form: TapKind | None,
    mode_table: bool | None,
    **options: Any,
) -> None:
    """Slope, frequency and decay of a tap, or its waveform, from recordings of taps and their speeds."""
    if table and law not in (None, "table"):
        raise click.UsageError(f"--table and --law {law} do not go together: leave out one")
    taken: LawKind | None = "table" if table else law
    words = {
        "form": "--as",
        "law": "--table" if table else f"--law {law}",
        "two_modes": "--two-modes" if two_modes else "--one-mode",
        "mode_table": "--mode-table" if mode_table else "--no-mode-table",
        "attack": "--attack",
    }
    given = FitOptions(form, attack, taken, two_modes, mode_table)
    fault = given.fault(words.__getitem__)
    if fault is not None:
        raise click.UsageError(fault[1])
    _run("tap", given, per_file=2, **options)


@fit_command.command("grooves")
@_options
def grooves_command(**options: Any) -> None:
    """Spacing, mode and gains of grooves, from strokes over them."""
    _run("grooves", FitOptions(), **options)


@fit_command.command("texture")
@_options
@click.option("--ar", "autoregressive", is_flag=True, help="Autoregressive models over speed and force.")
def texture_command(autoregressive: bool, **options: Any) -> None:
    """Spectrum and loudness of a texture, from strokes over it."""
    _run("texture", FitOptions(autoregressive=autoregressive), **options)


@fit_command.command("puncture", short_help="Stiffness, rupture and mode of a membrane.")
@_options
def puncture_command(**options: Any) -> None:
    """Stiffness, rupture and mode of a membrane, from recordings of punctures."""
    _run("puncture", FitOptions(), **options)


def _run(
    kind: Kind,
    asked: FitOptions,
    files: tuple[str, ...],
    output: str | None,
    name: str | None,
    report: str | None,
    stiffness_n_per_m: float | None,
    overwrite: bool,
    merge: bool,
    strict: bool,
    as_json: bool,
    per_file: int = 1,
) -> None:
    from hapticd.analysis.statistics import require_scipy
    from hapticd.fit import report as drawing
    from hapticd.fit.contribution import added, contribution_of
    from hapticd.fit.from_files import fitted_files, materials_of
    from hapticd.fit.result import finite

    require_scipy()
    if merge and output is None:
        raise click.UsageError("--merge adds to the file of -o, which is missing")
    name = name if name is not None else kind if output is None else Path(output).stem
    _check(files, output, name, report, overwrite, merge)
    if report is not None:
        drawing.require(report)
    library = materials_of(output) if merge and output is not None and os.path.exists(output) else {}
    onto = library.get(name)

    with _progress(len(files) * per_file + (per_file == 1)) as step:
        recordings, unused, fitted = fitted_files(files, kind, asked, step, strict)
    notes = list(fitted.notes)
    part = contribution_of(kind, fitted, recordings)
    found = added(part, name, datetime.date.today(), onto=onto, stiffness_n_per_m=stiffness_n_per_m)
    material = found.material
    if found.assumed_n_per_m is not None:
        notes.append(f"the stiffness, {found.assumed_n_per_m:g} N/m, is not in the recordings; --stiffness sets it")
    notes += [f"{key} of {name} in {output} is replaced" for key in found.replaced]
    picture = None
    if report is not None:
        from hapticd.fit.panels import page_of

        picture = drawing.drawn(report, page_of(kind, f"{name}: {kind}", fitted.fit, recordings, unused))

    fresh = {"materials": {name: material.to_dict()}}
    if output is not None:
        whole = {**library, name: material}
        write_whole(
            output,
            yaml_text({"materials": {key: each.to_dict() for key, each in whole.items()}}) + "\n",
            overwrite or merge,
        )
    if report is not None and picture is not None:
        write_whole(report, picture, overwrite)
    if as_json:
        print_json({"kind": kind, "fit": finite(fitted.fit.to_dict()), "notes": notes, **fresh})
        return
    # The material is what is read on, where it goes to no file: then the table is beside it.
    _tell(kind, fitted.fit, beside=output is None)
    for line in notes:
        note(line)
    if output is None:
        click.echo(yaml_text(fresh))


def _check(
    files: Sequence[str], output: str | None, name: str, report: str | None, overwrite: bool, merge: bool
) -> None:
    """What can be refused before anything is read."""
    from hapticd.config.materials import MAX_PROVENANCE_FILES, validate_materials

    validate_materials({name: {"stiffness_n_per_m": STIFFNESS_N_PER_M}})
    if len(files) > MAX_PROVENANCE_FILES:
        raise HapticdError(f"{len(files)} recordings are too many: {MAX_PROVENANCE_FILES} are the most of one material")
    taken = {}
    for file in files:
        taken[os.path.realpath(file)] = file
    for target in (output, report):
        if target is None:
            continue
        if os.path.realpath(target) in taken:
            raise HapticdError(f"{target}: is one of the recordings; give another name")
        check_new(target, overwrite or (merge and target == output))
    if output is not None and report is not None and os.path.realpath(output) == os.path.realpath(report):
        raise HapticdError(f"{output}: cannot be both the material and the report; give another name")


@contextmanager
def _progress(steps: int) -> Iterator[Callable[[str], None]]:
    """What is being done, over the files and the fit, in one line on a terminal."""
    if not sys.stderr.isatty():
        yield lambda text: None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=steps)
        begun = False

        def show(text: str) -> None:
            nonlocal begun
            bar.update(task, description=text, advance=1 if begun else 0)
            begun = True

        yield show


def _tell(kind: Kind, found: Fit, beside: bool) -> None:
    from rich.console import Console
    from rich.table import Table

    from hapticd.fit.report import figure_rows
    from hapticd.fit.result import estimates, plain_figures

    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for head in (kind, "value", "95 % interval", "unit"):
        table.add_column(head, justify="left" if head in (kind, "unit") else "right", no_wrap=True)
    for row in figure_rows(estimates(found), plain_figures(found)):
        table.add_row(*row)
    Console(soft_wrap=True, stderr=beside).print(table)
    click.echo(found.verdict, err=beside)
    for warning in found.warnings:
        note(warning)
