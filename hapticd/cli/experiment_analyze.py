"""`hapticd experiment analyze`: statistics of sessions, as tables, CSV and an HTML report."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hapticd.base.errors import HapticdError
from hapticd.base.files import check_new, write_atomically
from hapticd.cli.common import json_option, note, overwrite_option, print_json

if TYPE_CHECKING:
    from hapticd.experiment.analyze import Analysis

_MAX_TABLE_WIDTH = 500
"""Largest width of a printed table, in characters."""


@click.command("analyze", short_help="Compute statistics of sessions.")
@click.argument("folders", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="FOLDER...")
@click.option("-o", "--output", type=click.Path(), metavar="FILE.html", help="HTML report with figures.")
@click.option(
    "--csv", "csv_folder", type=click.Path(), metavar="DIR", help="Existing folder for the tables as CSV files."
)
@overwrite_option
@json_option
def analyze_command(
    folders: tuple[Path, ...], output: str | None, csv_folder: str | None, overwrite: bool, as_json: bool
) -> None:
    """Compute statistics of the sessions in each FOLDER of a session, a participant or a data set.

    Depending on the study these are percentage correct against chance, paired comparisons, scale values, confusion
    matrices, psychometric functions and measures of the motion, next to the published results that the study names.
    """
    from hapticd.experiment import report
    from hapticd.experiment.analyze import analyze

    if output is not None:
        if not output.lower().endswith(".html"):
            raise HapticdError(f"{output}: must end in .html")
        report.require()
        check_new(output, overwrite)
    if csv_folder is not None and not Path(csv_folder).is_dir():
        raise HapticdError(f"{csv_folder}: no such folder; create it, or give another one")
    found = analyze(folders)
    files = report.texts(found.tables) if csv_folder is not None else {}
    for name in files:
        check_new(str(Path(csv_folder or "") / name), overwrite)
    if output is not None:
        write_atomically(output, report.page(found), overwrite)
    for name, text in files.items():
        write_atomically(str(Path(csv_folder or "") / name), text, overwrite)
    if as_json:
        print_json(found.to_dict())
    else:
        _print_tables(found)


def _print_tables(found: Analysis) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table

    console = Console(soft_wrap=False)
    width = console.width
    console.print(f"{found.title}\n{found.summary}", markup=False, highlight=False)
    for each in found.tables:
        rows = each.text()
        table = Table(title=each.title, title_justify="left", box=box.SIMPLE, show_edge=False, padding=(0, 1, 0, 0))
        for place, (head, is_text) in enumerate(zip(each.columns, each.of_text(), strict=True)):
            # A heading is wrapped to the width of the cells, or of its longest word.
            widest = max((len(text) for text in (*head.split(), *(row[place] for row in rows))), default=1)
            lines = textwrap.wrap(head, max(1, widest), break_long_words=False)
            table.add_column("\n".join(lines), justify="left" if is_text else "right", no_wrap=True)
        for row in rows:
            table.add_row(*row)
        # The table may be wider than the terminal: that is easier to read than broken words.
        console.width = max(
            width, console.measure(table, options=console.options.update(max_width=_MAX_TABLE_WIDTH)).maximum
        )
        console.print()
        console.print(table)
        if each.note:
            console.print(each.note, markup=False, highlight=False)
    for line in found.notes:
        note(line)
