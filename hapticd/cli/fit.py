"""`hapticd fit`: materials from recordings."""

from __future__ import annotations

import datetime
import os
import sys
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from hapticd.base import wording
from hapticd.base.errors import HapticdError
from hapticd.base.files import check_new, write_atomically
from hapticd.base.yaml_text import yaml_text
from hapticd.cli.common import (
    Finite,
    json_option,
    note,
    options,
    output_option,
    overwrite_option,
    print_json,
    print_table,
    results_option,
    status_line,
)
from hapticd.cli.engine import Where, computed, engine_options, outcome_dict, outcome_text, require_engine
from hapticd.cli.synthesize import synthesize_command
from hapticd.fit.options import STIFFNESS_N_PER_M, FitOptions

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hapticd.config.modes import Attack
    from hapticd.fit.options import TapKind
    from hapticd.fit.recording import Kind
    from hapticd.fit.speed_law import LawKind
    from hapticd.sweeps.batches.ranking import MaterialResult

_MAX_RANKING_ROWS: Final = 100
_REDIRECTED_RANKING_WIDTH: Final = 4096
"""Largest width of a ranking that is not printed to a terminal, in characters."""


@click.group("fit", no_args_is_help=False, short_help="Fit a material to recordings.")
def fit_command() -> None:
    """Fit a material to recordings of a stylus: acceleration, force and position, as CSV, npz or WAV.

    A file FILE.yaml next to FILE describes columns with other names or units.
    """


fit_command.add_command(synthesize_command)
_options = options(
    click.argument("files", nargs=-1, required=True, type=click.Path(), metavar="FILES..."),
    output_option("YAML file for the material."),
    click.option("--name", metavar="NAME", help="Name of the material [default: that of the output, without .yaml]."),
    click.option(
        "--report", type=click.Path(), metavar="FILE.html|.png", help="Plot of recordings and model; needs matplotlib."
    ),
    click.option(
        "--stiffness",
        "stiffness_n_per_m",
        type=Finite(min=0, max=1e5),
        metavar="N/M",
        help=f"Stiffness, if the recordings do not determine it [default: {STIFFNESS_N_PER_M:g}].",
    ),
    click.option("--merge", is_flag=True, help="Add the material to the output, instead of replacing the file."),
    click.option("--strict", is_flag=True, help="Fail instead of leaving out a bad file or a clipped tap."),
    overwrite_option,
    json_option,
)


@fit_command.command("tap", short_help="Fit slope, frequency and decay of a tap.")
@_options
@click.option(
    "--attack",
    type=click.Choice(["coefficient", "first_peak"]),
    help="Definition of the slope in the material [default: coefficient].",
)
@click.option(
    "--law",
    type=click.Choice(["line", "power", "table"]),
    help="Law of the amplitude over the speed [default: the one with the lowest AICc].",
)
@click.option("--table", "law", flag_value="table", help="Same as --law table: amplitudes over speed.")
@click.option(
    "--two-modes/--one-mode",
    default=None,
    help="Number of modes in the material [default: two if one explains too little].",
)
@click.option(
    "--as",
    "form",
    type=click.Choice(["auto", "mode", "waveform"]),
    help="Model: a ringing mode, the waveform of a pulse, or whichever explains the taps better [default: auto].",
)
@click.option(
    "--mode-table/--no-mode-table",
    default=None,
    help="Table of frequency and decay over the speed, or one value of each [default: a table if they change].",
)
def tap_command(
    attack: Attack | None,
    law: LawKind | None,
    two_modes: bool | None,
    form: TapKind | None,
    mode_table: bool | None,
    **given: Any,
) -> None:
    """Fit slope, frequency and decay of a tap, or its waveform, to recordings of taps and their speeds."""
    option_by_field = {
        "form": "--as",
        "law": f"--law {law}",
        "two_modes": "--two-modes" if two_modes else "--one-mode",
        "mode_table": "--mode-table" if mode_table else "--no-mode-table",
        "attack": "--attack",
    }
    asked = FitOptions(form, attack, law, two_modes, mode_table)
    fault = asked.fault(option_by_field.__getitem__)
    if fault is not None:
        raise click.UsageError(fault[1])
    _run("tap", asked, **given)


@fit_command.command("grooves", short_help="Fit spacing, mode and gains of grooves.")
@_options
def grooves_command(**given: Any) -> None:
    """Fit spacing, mode and gains of grooves to recordings of strokes over them."""
    _run("grooves", FitOptions(), **given)


@fit_command.command("texture", short_help="Fit spectrum and loudness of a texture.")
@_options
@click.option("--ar", "autoregressive", is_flag=True, help="Fit autoregressive models over speed and force.")
def texture_command(autoregressive: bool, **given: Any) -> None:
    """Fit spectrum and loudness of a texture to recordings of strokes over it."""
    _run("texture", FitOptions(autoregressive=autoregressive), **given)


@fit_command.command("puncture", short_help="Fit stiffness, rupture and mode of a membrane.")
@_options
def puncture_command(**given: Any) -> None:
    """Fit stiffness, rupture and mode of a membrane to recordings of punctures."""
    _run("puncture", FitOptions(), **given)


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
) -> None:
    from hapticd.analysis.statistics import require_scipy
    from hapticd.config.materials import MAX_PROVENANCE_FILES, validate_materials
    from hapticd.fit import report as drawing
    from hapticd.fit.contribution import added, contribution_of
    from hapticd.fit.from_files import fitted_files, materials_of
    from hapticd.fit.result import estimates, finite, plain_figures

    # Arguments are checked before any file is read.
    require_scipy()
    if merge and output is None:
        raise click.UsageError("--merge needs -o, the file to which the material is added")
    name = name if name is not None else kind if output is None else Path(output).stem
    validate_materials({name: {"stiffness_n_per_m": STIFFNESS_N_PER_M}})
    if len(files) > MAX_PROVENANCE_FILES:
        raise HapticdError(f"too many recordings: {len(files)}, a material may have at most {MAX_PROVENANCE_FILES}")
    taken = {os.path.realpath(file) for file in files}
    for target in filter(None, (output, report)):
        if os.path.realpath(target) in taken:
            raise HapticdError(f"{target}: used twice in this command; give another name")
        taken.add(os.path.realpath(target))
        check_new(target, overwrite or (merge and target == output))
    if report is not None:
        drawing.require(report)
    library = materials_of(output) if merge and output is not None and os.path.exists(output) else {}

    with status_line() as step:
        recordings, unused, fitted = fitted_files(files, kind, asked, step, strict)
    notes, fit = list(fitted.notes), fitted.fit
    part = contribution_of(kind, fitted, recordings)
    found = added(part, name, datetime.date.today(), onto=library.get(name), stiffness_n_per_m=stiffness_n_per_m)
    if found.assumed_n_per_m is not None:
        notes.append(f"the stiffness, {found.assumed_n_per_m:g} N/m, is assumed, not measured; --stiffness sets it")
    notes += [f"{key} of {name} in {output} is replaced" for key in found.replaced]
    fresh = {"materials": {name: found.material.to_dict()}}
    picture = None
    if report is not None:
        from hapticd.fit.panels import page_of

        picture = drawing.drawn(report, page_of(kind, f"{name}: {kind}", fit, recordings, unused))
    if output is not None:
        materials = {key: each.to_dict() for key, each in {**library, name: found.material}.items()}
        write_atomically(output, yaml_text({"materials": materials}) + "\n", overwrite or merge)
    if report is not None and picture is not None:
        write_atomically(report, picture, overwrite)
    if as_json:
        print_json({"kind": kind, "fit": finite(fit.to_dict()), "notes": notes, **fresh})
        return
    # Without -o stdout is for the material, and the table goes to stderr.
    table_on_stderr = output is None
    rows = drawing.figure_rows(estimates(fit), plain_figures(fit))
    print_table((kind, ">value", ">95 % interval", "unit"), rows, stderr=table_on_stderr)
    click.echo(fit.verdict, err=table_on_stderr)
    for line in (*fit.warnings, *notes):
        note(line)
    if table_on_stderr:
        click.echo(yaml_text(fresh))


@fit_command.command("batch", short_help="Fit many materials: a tree of folders.")
@click.argument("tree", type=click.Path(), metavar="TREE")
@results_option("the tree's name with -fits")
@engine_options("fits")
@json_option
def batch_command(tree: str, output: Path | None, as_json: bool, **where: Any) -> int:
    """Fit the recordings in each folder TREE/MATERIAL/KIND in parallel.

    KIND is tap, grooves, texture or puncture. The folder of results gets the materials, tables and a page that ranks
    them by verdict. Finished fits are not computed again; Ctrl-C keeps them. The tables list the reason of each refused
    fit. The exit code is 1 if a fit was refused, otherwise 0.
    """
    from hapticd.analysis.statistics import require_scipy
    from hapticd.sweeps.batches.batch import Batch
    from hapticd.sweeps.batches.output import check_folder, shown_files, write_materials, write_tables
    from hapticd.sweeps.batches.page import summary, write_page
    from hapticd.sweeps.batches.ranking import counts, ranked, result_dict
    from hapticd.sweeps.batches.tree import read_tree

    engine = Where(**where)
    require_engine(engine)
    require_scipy()
    folder = Path(f"{os.path.basename(os.path.abspath(tree))}-fits") if output is None else output
    found = read_tree(tree)
    check_folder(folder, tree)
    if found.others:
        note(f"{wording.count(len(found.others), 'file')} left out, not recordings: {shown_files(found.others)}")
    batch = Batch(found)
    with warnings.catch_warnings():
        # Each fit does this, too. But in threads, the last fit to end would restore the filter of another fit.
        warnings.simplefilter("ignore", RuntimeWarning)
        outcome, store = computed(batch, folder, engine, "fit")
    results = ranked(batch, store.table().to_pylist(), datetime.date.today())
    files, left = write_materials(folder, results)
    write_tables(folder, results, files)
    drawn = _can_draw()
    write_page(batch.title, results, files, folder, drawn, note)
    if as_json:
        materials = [result_dict(rank, each, files.get(each.name)) for rank, each in enumerate(results, 1)]
        about = outcome_dict(outcome, folder, store.digest(), "fits")
        print_json({**about, "qualities": counts(results), "materials": materials})
    else:
        _print_ranking(results)
        click.echo(summary(results))
        click.echo(outcome_text(outcome, "fit"))
        click.echo(f"materials: {folder}/materials/*.yaml; ranking.csv, figures.csv and report.html in {folder}")
    if left:
        note(f"{wording.count(len(left), 'file')} of an earlier batch kept: {shown_files(left)}")
    return 1 if any(each.quality == "refused" for each in results) else 0


def _can_draw() -> bool:
    from hapticd.fit.report import require

    try:
        require("report.html")
    except HapticdError as error:
        note(f"the page has no figures: {error}")
        return False
    return True


def _print_ranking(results: Sequence[MaterialResult]) -> None:
    """Print the ranking of at most the _MAX_RANKING_ROWS worst materials. A row is one line if stdout is redirected."""
    hidden = max(0, len(results) - _MAX_RANKING_ROWS)
    if hidden:
        click.echo(f"the best {hidden} are not shown; see ranking.csv")
    rows = []
    for rank, each in list(enumerate(results, 1))[hidden:]:
        kinds = ", ".join(fit.kind for fit in each.fits)
        count = sum(len(fit.recordings.files) for fit in each.fits)
        rows.append((str(rank), each.name, each.quality, kinds, str(count), each.shown_reasons))
    columns = (">rank", "material", "verdict", "fits", ">recordings", "reasons")
    print_table(columns, rows, wrapped="reasons", width=None if sys.stdout.isatty() else _REDIRECTED_RANKING_WIDTH)
