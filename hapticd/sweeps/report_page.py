"""The results of a sweep as one HTML page: figures, tables, the study, its seed and versions."""

from __future__ import annotations

import html
from collections.abc import Sequence
from typing import Final

from hapticd.base import html_page, wording
from hapticd.base.yaml_text import yaml_text
from hapticd.sweeps.axis_scales import shown
from hapticd.sweeps.columns import Row
from hapticd.sweeps.figure_keys import SweepFigure
from hapticd.sweeps.figures import Drawing, title_of
from hapticd.sweeps.results import Results, best_of, with_values

MAX_TABLE_ROWS: Final = 1000


def page(results: Results, drawings: Sequence[Drawing]) -> str:
    """Return the HTML page of a sweep with each figure as SVG. Raises HapticdError if a figure cannot be drawn."""
    tables = [figure for figure in results.study.figures or () if figure.kind == "table"]
    source = results.source or yaml_text(results.study.to_dict())
    made = {"seed": str(results.study.seed), **results.versions}
    parts = [
        f"<p>{html.escape(_summary(results))}</p>",
        *(f"<figure>{drawing.svg()}</figure>" for drawing in drawings),
        *(_named_table(results, figure) for figure in tables),
        "<h2>All points</h2>",
        _table(results, results.rows, _own_columns(results)),
        "<h2>Study</h2>",
        f"<pre>{html.escape(source.rstrip())}</pre>",
        "<h2>Computed with</h2>",
        html_page.table(("what", "value"), list(made.items()), (True, True)),
    ]
    return html_page.page(results.study.title, "\n".join(parts))


def _summary(results: Results) -> str:
    failed = sum(row["error"] is not None for row in results.rows)
    missing = results.points - len(results.rows)
    text = wording.count(results.points, "point")
    if missing:
        text += f", {missing} of them not computed yet"
    if failed:
        text += f", {failed:,} without a result"
    counts = [
        f"{results.words(name)}: yes at {sum(row[name] is True for row in results.rows):,}"
        for name in results.named("measured")
        if results.column(name).kind == "boolean"
    ]
    return f"{'; '.join([text, *counts])}."


def _own_columns(results: Results) -> list[str]:
    """Return the names of all columns except `point`, and except `error` if no row has an error."""
    failed = any(row["error"] is not None for row in results.rows)
    return [*results.named("varied"), *results.named("measured"), *(["error"] if failed else [])]


def _named_table(results: Results, figure: SweepFigure) -> str:
    rows = with_values(results.rows, figure.where)
    if figure.best:
        rows = best_of(rows, figure.best)
    return _table(results, rows, figure.columns or _own_columns(results), title_of(results, figure))


def _table(results: Results, rows: Sequence[Row], columns: Sequence[str], caption: str = "") -> str:
    heads = [
        f"{results.words(name)}, {unit}" if (unit := results.column(name).unit) else results.words(name)
        for name in columns
    ]
    cells = [[shown(row[name]) for name in columns] for row in rows[:MAX_TABLE_ROWS]]
    left = [results.column(name).kind == "text" for name in columns]
    drawn = html_page.table(heads, cells, left, caption)
    if not rows:
        return f'{drawn}\n<p class="note">No point has these values.</p>'
    if len(rows) > MAX_TABLE_ROWS:
        return f'{drawn}\n<p class="note">{len(rows) - MAX_TABLE_ROWS:,} more rows are in pieces/*.parquet.</p>'
    return drawn
