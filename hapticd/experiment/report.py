"""The report of an analysis: one HTML page with tables, and with pictures as SVG, drawn by matplotlib."""

from __future__ import annotations

import html
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from hapticd._version import __version__
from hapticd.analysis.drawing import drawing, literal, plain_decades, require_matplotlib, svg_element
from hapticd.base import html_page
from hapticd.experiment.analyze import Analysis
from hapticd.experiment.results import Dots, Fitted, Matrices, PairedValues, Picture, ResultTable, Section

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MATRIX_CELL_INCHES: Final = 0.42
"""Width and height of a drawn cell of a matrix, enough for four characters."""
_LABEL_LETTER_INCHES: Final = 0.085
"""Width of a letter in a label, for the size of a picture."""


def require() -> None:
    """Raise HapticdError if matplotlib, which a report needs, is not installed."""
    require_matplotlib("the report", "experiment")


def page(analysis: Analysis) -> str:
    """Return the report of an analysis as an HTML page. Raises HapticdError if matplotlib is not installed."""
    require()
    warned = "\n".join(f'<p class="warning">{html.escape(note)}</p>' for note in analysis.notes)
    compared = (
        f"Compared with published results: <code>{html.escape(analysis.published)}</code>."
        if analysis.published
        else ""
    )
    sections = "\n".join(_section(section) for section in analysis.sections)
    files = "\n".join(f"<li><code>{html.escape(str(file))}</code></li>" for file in analysis.files)
    body = f"""<p><b>{html.escape(analysis.summary)}.</b> {compared}</p>
{warned}
{sections}
<h2>Tables of answers</h2>
<ul>{files}</ul>
<p>hapticd {html.escape(__version__)}</p>"""
    return html_page.page(analysis.title, body)


def _section(section: Section) -> str:
    pictures = "\n".join(f'<div class="wide">{svg(picture)}</div>' for picture in section.pictures)
    return "\n".join((*(_table(table) for table in section.tables), pictures))


def _table(table: ResultTable) -> str:
    note = f'\n<p class="note">{html.escape(table.note)}</p>' if table.note else ""
    return html_page.table(table.columns, table.text(), table.of_text(), table.title) + note


def svg(picture: Picture) -> str:
    """Draw a picture, and return it as an SVG element."""
    from matplotlib.figure import Figure

    drawn: dict[type[Any], Callable[[Figure, Any], None]] = {
        Dots: _dots,
        Matrices: _matrices,
        Fitted: _fitted,
        PairedValues: _paired,
    }
    with drawing({"font.size": 9, "axes.titlesize": 10}, picture.title, page_colors=True):
        figure = Figure(figsize=_size(picture), layout="constrained")
        drawn[type(picture)](figure, picture)
        return svg_element(figure, picture.title)


def _size(picture: Picture) -> tuple[float, float]:
    """Return width and height of a picture, in inches."""
    if isinstance(picture, Dots):
        return 7.5, 1.4 + 0.3 * len(picture.labels) * max(1, 0.6 * len(picture.series))
    if isinstance(picture, Matrices):
        named = _LABEL_LETTER_INCHES * max(map(len, picture.rows + picture.columns))
        wide = 0.6 + named + max(_MATRIX_CELL_INCHES * len(picture.columns), 1.8)
        return 1.2 + wide * len(picture.panels), 1.3 + named + _MATRIX_CELL_INCHES * len(picture.rows)
    return 7.0, 4.2


def _dots(figure: Figure, picture: Dots) -> None:
    axes = figure.subplots()
    places = np.arange(len(picture.labels), dtype=float)
    count = len(picture.series)
    for number, (name, values, low, high) in enumerate(picture.series):
        at = places + 0.5 * ((number + 0.5) / count - 0.5)
        present = np.isfinite(values)
        bars = np.maximum(0.0, [(values - low)[present], (high - values)[present]])
        axes.errorbar(values[present], at[present], xerr=bars, fmt="o", ms=5, lw=1.2, capsize=3, label=name)
    if picture.chance is not None:
        axes.axvline(picture.chance, color="0.5", ls=":", label="chance")
    axes.set_yticks(places, [literal(label) for label in picture.labels])
    axes.set_ylim(len(places) - 0.5, -0.5)
    axes.set_xlabel(picture.axis)
    axes.grid(axis="x", alpha=0.3)
    _title(figure, picture.title)
    if count > 1 or picture.chance is not None:
        figure.legend(loc="outside lower center", ncols=min(4, count + 1), frameon=False, fontsize=8)


def _matrices(figure: Figure, picture: Matrices) -> None:
    places = np.asarray(figure.subplots(1, len(picture.panels), squeeze=False))[0]
    image = None
    for axes, (name, values) in zip(places, picture.panels, strict=True):
        image = axes.imshow(np.ma.masked_invalid(values), vmin=0, vmax=100, cmap="viridis")
        axes.set_xticks(range(len(picture.columns)), [literal(each) for each in picture.columns], rotation=90)
        axes.set_yticks(range(len(picture.rows)), [literal(each) for each in picture.rows])
        axes.set_xlabel(picture.column_label)
        axes.set_ylabel(picture.row_label)
        axes.set_title(literal(name))
        for (row, column), value in np.ndenumerate(values):
            if math.isfinite(value):
                color = "white" if value < 60 else "black"
                axes.text(column, row, f"{value:.3g}", ha="center", va="center", fontsize=7, color=color)
    if image is not None:
        figure.colorbar(image, ax=list(places), label=picture.unit, shrink=0.8)
    _title(figure, picture.title)


def _fitted(figure: Figure, picture: Fitted) -> None:
    axes = figure.subplots()
    bars = np.maximum(0.0, [picture.percent - picture.low, picture.high - picture.percent])
    axes.errorbar(picture.levels, picture.percent, bars, fmt="o", ms=4, lw=1, capsize=2, label="answers, Wilson's 95 %")
    axes.plot(picture.curve_levels, picture.curve_percent, "-", lw=1.5, label="fitted function")
    if picture.threshold is not None:
        threshold, low, high = picture.threshold
        axes.axvline(threshold, color="C2", lw=1, label="threshold, 95 %")
        axes.axvspan(low, high, color="C2", alpha=0.15, lw=0)
    if picture.logarithmic:
        axes.set_xscale("log")
        plain_decades(axes.xaxis, (1.0, 2.0, 5.0))
    axes.set_ylim(-3, 103)
    axes.set_xlabel(picture.level_label)
    axes.set_ylabel(picture.axis)
    axes.grid(alpha=0.3)
    _title(figure, picture.title)
    figure.legend(loc="outside lower center", ncols=3, frameon=False, fontsize=8)


def _paired(figure: Figure, picture: PairedValues) -> None:
    axes = figure.subplots()
    places = np.arange(len(picture.conditions))
    for number, values in enumerate(picture.values):
        label = None if number else "a participant"
        axes.plot(places, values, "o-", color="0.6", ms=3, lw=0.8, label=label)
    if len(picture.values) > 1:
        axes.plot(places, picture.values.mean(axis=0), "o-", color="C0", ms=6, lw=2, label="mean over participants")
    axes.set_xticks(places, [literal(each) for each in picture.conditions])
    axes.set_xlim(-0.5, len(places) - 0.5)
    axes.set_ylabel(picture.axis)
    axes.grid(axis="y", alpha=0.3)
    _title(figure, picture.title)
    figure.legend(loc="outside lower center", frameon=False, fontsize=8)


def _title(figure: Figure, text: str) -> None:
    figure.suptitle(literal(text), fontsize=10)


def texts(tables: Sequence[ResultTable]) -> dict[str, str]:
    """Return the text of a CSV file for each table of results, by file name."""
    return {f"{table.name}.csv": table.csv() for table in tables}
