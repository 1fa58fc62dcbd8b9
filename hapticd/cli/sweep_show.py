"""`hapticd sweep show`: the results of a study as a table, as figures and as a page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from hapticd.base.errors import HapticdError, known_names
from hapticd.base.files import check_new, write_whole
from hapticd.cli.common import json_option, note, overwrite_option, print_json

if TYPE_CHECKING:
    from hapticd.sweeps.columns import Column, Value
    from hapticd.sweeps.store import Store

_MAX_PRINTED_ROWS: Final = 40
_MAX_MEASURED_WIDTH: Final = 4096
_PAGE_SUFFIX: Final = ".html"
_OTHER_RESULTS_BY_KIND: Final = {
    "batch": "a batch of fits; hapticd fit batch shows it, as does its report.html",
    "participants": "sessions of simulated participants; hapticd experiment analyze shows them",
}
"""What else the engine computes into a folder, and what shows it."""


@click.command("show", short_help="Show the results of a study: table, figures, page.")
@click.argument("folder", type=click.Path(file_okay=False, path_type=Path), metavar="DIR")
@click.option(
    "--figures",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="DIR",
    help="Draw the study's figures there, as PNG.",
)
@click.option("--html", "page", type=click.Path(), metavar="FILE.html", help="Write figures, tables and study there.")
@click.option(
    "--where", multiple=True, metavar="COLUMN=VALUE", help="Print only rows that have this value; may be repeated."
)
@overwrite_option
@json_option
def show_command(
    folder: Path, figures: Path | None, page: str | None, where: tuple[str, ...], overwrite: bool, as_json: bool
) -> None:
    """Show the rows of the study in DIR as a table.

    The key `figures` of the study says what is drawn; without it, what suits the study is. The page is one file.
    """
    from hapticd.sweeps.results import in_order, with_values
    from hapticd.sweeps.store import Store

    store = Store(folder, note)
    manifest = store.manifest()
    if (other := _OTHER_RESULTS_BY_KIND.get(manifest.get("kind", ""))) is not None:
        raise HapticdError(f"{folder}: holds {other}")
    title, columns = manifest["title"], store.columns()
    kept = dict(_condition(text, columns) for text in where)
    if figures is not None or page is not None:
        _draw(store, figures, page, overwrite)
    rows: list[dict[str, Any]] = store.table().to_pylist()
    shown = with_values(in_order(rows, columns), kept)
    if as_json:
        print_json({"title": title, "columns": [[column.name, column.unit] for column in columns], "rows": shown})
        return
    if not rows:
        raise HapticdError(f"{folder}: no point has been computed yet: hapticd sweep run goes on")
    _print(folder, title, columns, shown)


def _draw(store: Store, folder: Path | None, page: str | None, overwrite: bool) -> None:
    """Writes figures and page; whatever is in the way is said before anything is drawn."""
    from hapticd.analysis.drawing import require_matplotlib
    from hapticd.sweeps import figures, report_page
    from hapticd.sweeps.results import load_results

    if page is not None and not page.lower().endswith(_PAGE_SUFFIX):
        raise HapticdError(f"{page}: is no kind of page: must end in {_PAGE_SUFFIX}")
    require_matplotlib("a figure", "fit")
    results = load_results(store)
    drawings = figures.drawings_of(results)
    if folder is not None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise HapticdError(f"{folder}: cannot be made: {error.strerror}") from None
    files = [] if folder is None else [str(folder / name) for name in figures.file_names(drawings)]
    for file in (*files, *([] if page is None else [page])):
        check_new(file, overwrite)
    if not drawings:
        note("nothing is drawn: no number is varied, and the study names no figures")
    for file, drawing in zip(files, drawings, strict=False):
        write_whole(file, drawing.png(), overwrite)
        note(f"figure: {file}")
    if page is not None:
        write_whole(page, report_page.page(results, drawings), overwrite)
        note(f"page: {page}")


def _condition(text: str, columns: Sequence[Column]) -> tuple[str, Value]:
    """Column and value of `suffices=yes`; a column may be given by the end of its name, if no other ends so."""
    name, equals, value = text.partition("=")
    if not equals:
        raise HapticdError(f"--where {text}: must be COLUMN=VALUE")
    found = [column for column in columns if name in (column.name, column.name.rpartition(".")[2])]
    exact = [column for column in found if column.name == name]
    if len(exact or found) != 1:
        listed = ", ".join(column.name for column in found)
        known = f"may be {listed}" if found else known_names(name, [column.name for column in columns])
        raise HapticdError(f"--where {text}: no one column is called {name}; {known}")
    column = (exact or found)[0]
    return column.name, _value(text, value, column)


def _value(text: str, value: str, column: Column) -> Value:
    if column.kind == "text":
        return value
    if column.kind == "boolean":
        known = {"yes": True, "true": True, "no": False, "false": False}
        if value not in known:
            raise HapticdError(f"--where {text}: {column.name} is yes or no")
        return known[value]
    try:
        return float(value)
    except ValueError:
        raise HapticdError(f"--where {text}: {column.name} is a number") from None


def _print(folder: Path, title: str, columns: Sequence[Column], rows: Sequence[dict[str, Any]]) -> None:
    from rich.console import Console
    from rich.measure import Measurement
    from rich.table import Table

    from hapticd.sweeps.axis_scales import shown

    some_failed = any(row["error"] is not None for row in rows)
    drawn = [column for column in columns if column.role != "point" and (column.role != "error" or some_failed)]
    table = Table(title=title, box=None, pad_edge=False, padding=(0, 2, 0, 0), title_justify="left")
    ends = [column.name.rpartition(".")[2] for column in drawn]
    for column, end in zip(drawn, ends, strict=True):
        name = end if ends.count(end) == 1 else column.name
        head = f"{name}, {column.unit}" if column.unit else name
        table.add_column(head, justify="left" if column.kind == "text" else "right", no_wrap=True)
    for row in rows[:_MAX_PRINTED_ROWS]:
        table.add_row(*(shown(row[column.name]) for column in drawn))
    # As wide as it is: a terminal wraps a line, and a number that is cut off is none.
    wide = Measurement.get(Console(width=_MAX_MEASURED_WIDTH), Console(width=_MAX_MEASURED_WIDTH).options, table).maximum
    Console(width=wide, soft_wrap=True).print(table)
    if len(rows) > _MAX_PRINTED_ROWS:
        click.echo(f"and {len(rows) - _MAX_PRINTED_ROWS} more rows: {folder}/pieces/*.parquet, or --json")
