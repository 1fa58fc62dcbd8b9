"""`hapticd fit batch`: a tree of recordings, a folder for each material, fitted side by side."""

from __future__ import annotations

import datetime
import os
import sys
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from hapticd.base import wording
from hapticd.cli.common import json_option, note, print_json, print_table, results_option
from hapticd.cli.engine import Where, computed, engine_options, outcome_dict, outcome_text, require_engine

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hapticd.sweeps.batches.ranking import MaterialResult

_MOST_ROWS: Final = 100
_WIDEST: Final = 4096


@click.command("batch", short_help="Fit a tree of folders, one a material, side by side.")
@click.argument("tree", type=click.Path(), metavar="TREE")
@results_option("the tree's name with -fits")
@engine_options("fits")
@json_option
def batch_command(tree: str, output: Path | None, as_json: bool, **where: Any) -> int:
    """Fit the recordings of TREE/MATERIAL/KIND, where KIND is tap, grooves, texture or puncture, side by side.

    Materials, tables and a page with a ranking by verdict go to the folder of results. What it holds is not fitted
    again; Ctrl-C keeps what is done. A fit that is refused is a row with its reason. The exit code is 0 if none was,
    otherwise 1.
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
        note(f"{wording.count(len(found.others), 'file')} left out, no recordings: {shown_files(found.others)}")
    batch = Batch(found)
    with warnings.catch_warnings():
        # Each fit does so as well; of fits in threads, the last to end would restore what another one had set.
        warnings.simplefilter("ignore", RuntimeWarning)
        outcome, store = computed(batch, folder, engine, "fit")
    results = ranked(batch, store.table().to_pylist(), datetime.date.today())
    files, left = write_materials(folder, results)
    write_tables(folder, results, files)
    drawn = _can_draw()
    write_page(batch.title, results, files, folder, drawn, note)
    if as_json:
        told = [result_dict(rank, each, files.get(each.name)) for rank, each in enumerate(results, 1)]
        about = outcome_dict(outcome, folder, store.digest(), "fits")
        print_json({**about, "qualities": counts(results), "materials": told})
    else:
        _tell(results)
        click.echo(summary(results))
        click.echo(outcome_text(outcome, "fit"))
        click.echo(f"materials: {folder}/materials/*.yaml; ranking.csv, figures.csv and report.html beside them")
    if left:
        note(f"{wording.count(len(left), 'file')} of an earlier batch, left as they are: {shown_files(left)}")
    return 1 if any(each.quality == "refused" for each in results) else 0


def _can_draw() -> bool:
    from hapticd.base.errors import HapticdError
    from hapticd.fit.report import require

    try:
        require("report.html")
    except HapticdError as error:
        note(f"the page has no pictures: {error}")
        return False
    return True


def _tell(results: Sequence[MaterialResult]) -> None:
    """The ranking; of a long one its end, where there is something to do. For a program that reads it, a line each."""
    hidden = max(0, len(results) - _MOST_ROWS)
    if hidden:
        click.echo(f"the best {hidden} are left out here, and stand in ranking.csv")
    rows = []
    for rank, each in list(enumerate(results, 1))[hidden:]:
        kinds = ", ".join(fit.kind for fit in each.fits)
        count = sum(len(fit.asked.files) for fit in each.fits)
        rows.append((str(rank), each.name, each.quality, kinds, str(count), each.shown_reasons))
    columns = (">rank", "material", "verdict", "fits", ">recordings", "reasons")
    print_table(columns, rows, broken="reasons", width=None if sys.stdout.isatty() else _WIDEST)
