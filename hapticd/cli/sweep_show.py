"""`hapticd sweep show`: the results of a sweep as a table, figures and an HTML page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from hapticd.base.errors import HapticdError, known_names
from hapticd.base.files import check_new, write_atomically
from hapticd.cli.common import json_option, note, overwrite_option, print_json

if TYPE_CHECKING:
    from hapticd.sweeps.columns import Column, Value
    from hapticd.sweeps.store import Store

_MAX_PRINTED_ROWS: Final = 40
"""Maximum number of rows of the printed table; --json prints all rows."""
_MAX_MEASURED_WIDTH: Final = 4096
"""Largest width of a printed table, in characters."""
_PAGE_SUFFIX: Final = ".html"
_OTHER_RESULTS_BY_KIND: Final = {
    "batch": "results of hapticd fit batch; see its report.html",
    "participants": "sessions of simulated participants; use: hapticd experiment analyze",
}
"""What result folders of other commands contain, and how to show it, by the `kind` in study.json."""


@click.command("show", short_help="Show the results of a sweep.")
@click.argument("folder", type=click.Path(file_okay=False, path_type=Path), metavar="DIR")
@click.option(
    "--figures",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="DIR",
    help="Folder for figures of the results as PNG.",
)
@click.option(
    "--html", "page", type=click.Path(), metavar="FILE.html", help="HTML page with figures, tables and study."
)
@click.option(
    "--where", multiple=True, metavar="COLUMN=VALUE", help="Print only rows with this value; may be repeated."
)
@overwrite_option
@json_option
def show_command(
    folder: Path, figures: Path | None, page: str | None, where: tuple[str, ...], overwrite: bool, as_json: bool
) -> None:
    """Show the results of the sweep in DIR as a table, and optionally as figures or a page.

    The key `figures` of the study defines the figures; without it they are chosen from its columns.
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
        raise HapticdError(f"{folder}: no point has been computed yet; continue with: hapticd sweep run")
    _print(folder, title, columns, shown)


def _draw(store: Store, folder: Path | None, page: str | None, overwrite: bool) -> None:
    """Write figures and page of a sweep. Raises HapticdError before drawing if an output cannot be written."""
    from hapticd.analysis.drawing import require_matplotlib
    from hapticd.sweeps import figures, report_page
    from hapticd.sweeps.results import load_results

    if page is not None and not page.lower().endswith(_PAGE_SUFFIX):
        raise HapticdError(f"{page}: must end in {_PAGE_SUFFIX}")
    require_matplotlib("a figure", "fit")
    results = load_results(store)
    drawings = figures.drawings_of(results)
    if folder is not None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise HapticdError(f"{folder}: cannot be created: {error.strerror}") from None
    files = [] if folder is None else [str(folder / name) for name in figures.file_names(drawings)]
    for file in (*files, *([] if page is None else [page])):
        check_new(file, overwrite)
    if not drawings:
        note("no figures: no number is varied, and the study has no key figures")
    for file, drawing in zip(files, drawings, strict=False):
        write_atomically(file, drawing.png(), overwrite)
        note(f"figure: {file}")
    if page is not None:
        write_atomically(page, report_page.page(results, drawings), overwrite)
        note(f"page: {page}")


def _condition(text: str, columns: Sequence[Column]) -> tuple[str, Value]:
    """Return column and value of a condition of --where, such as `suffices=yes`.

    The condition may have only the last part of a dotted column name, if no other name ends in the same part.
    """
    name, equals, value = text.partition("=")
    if not equals:
        raise HapticdError(f"--where {text}: must be COLUMN=VALUE")
    found = [column for column in columns if name in (column.name, column.name.rpartition(".")[2])]
    exact = [column for column in found if column.name == name]
    if len(exact or found) != 1:
        listed = ", ".join(column.name for column in found)
        if found:
            raise HapticdError(f"--where {text}: ambiguous column {name}: may be {listed}")
        known = known_names(name, [column.name for column in columns])
        raise HapticdError(f"--where {text}: unknown column {name}; {known}")
    column = (exact or found)[0]
    return column.name, _value(text, value, column)


def _value(text: str, value: str, column: Column) -> Value:
    if column.kind == "text":
        return value
    if column.kind == "boolean":
        known = {"yes": True, "true": True, "no": False, "false": False}
        if value not in known:
            raise HapticdError(f"--where {text}: {column.name} must be yes or no")
        return known[value]
    try:
        return float(value)
    except ValueError:
        raise HapticdError(f"--where {text}: {column.name} must be a number") from None


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
    # The table is printed at its full width: a terminal wraps long lines, while rich would cut numbers off.
    wide = Measurement.get(
        Console(width=_MAX_MEASURED_WIDTH), Console(width=_MAX_MEASURED_WIDTH).options, table
    ).maximum
    Console(width=wide, soft_wrap=True).print(table)
    if len(rows) > _MAX_PRINTED_ROWS:
        click.echo(f"and {len(rows) - _MAX_PRINTED_ROWS} more rows: {folder}/pieces/*.parquet, or --json")
