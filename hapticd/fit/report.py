"""Report of a fit: pictures of recording and model, the fitted values with their intervals, and the verdict.

The report is one file: an HTML page with embedded pictures, or a PNG. matplotlib is imported when something is drawn.
"""

from __future__ import annotations

import base64
import html
import io
import math
import textwrap
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

import numpy as np

from hapticd._version import __version__
from hapticd.analysis.drawing import literal, plain_decades, require_matplotlib
from hapticd.analysis.statistics import Estimate, Floats
from hapticd.base import html_page
from hapticd.base.errors import HapticdError
from hapticd.config.schema import unit_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_CELL_INCHES: Final = (5.2, 3.6)
"""Width and height of a picture with title and labels, in inches."""
_GAP_INCHES: Final = (0.85, 1.05)
"""Width and height of title and labels within _CELL_INCHES."""
_MARGIN_INCHES: Final = (0.3, 0.2)
"""Margins of the page, left and right together, and above and below together."""
MAX_LABELLED_DECADES: Final = 3.5
"""A logarithmic axis over more decades has labels at powers of ten only."""
LABELS_BY_DECADES: Final = (
    (0.35, (1.0, 1.2, 1.4, 1.6, 1.8, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0)),
    (0.7, (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0)),
    (1.5, (1.0, 2.0, 5.0)),
    (MAX_LABELLED_DECADES, (1.0, 3.0)),
)
"""Pairs (decades, labels): a logarithmic axis over this number of decades or fewer has these labels in each decade."""


@dataclass(frozen=True, slots=True)
class Curve:
    """A line or points (n,) in a picture; `low` and `high` are a band about the line or error bars at the points."""

    label: str
    x: Floats
    y: Floats
    points: bool = False
    crossed: bool = False
    """Whether the points, which are not used, are drawn as crosses."""
    dashed: bool = False
    color: str | None = None
    """Name in matplotlib; None is the next color of the cycle."""
    low: Floats | None = None
    high: Floats | None = None


@dataclass(frozen=True, slots=True)
class Panel:
    """One picture of a report: its curves, labels and axes."""

    title: str
    x_label: str
    y_label: str
    curves: tuple[Curve, ...]
    logarithmic: bool = False
    """Whether both axes are logarithmic."""
    counted: bool = False
    """Whether x has integers only."""


@dataclass(frozen=True, slots=True)
class Page:
    """Content of a report."""

    title: str
    verdict: str
    warnings: tuple[str, ...]
    figures: Mapping[str, Estimate]
    plain: Mapping[str, float]
    """Fitted values that have no interval, by name."""
    sources: Sequence[tuple[str, str]]
    """Path and SHA-256 of each recording."""
    rows: Sequence[Sequence[Panel]]
    """Rows of pictures."""


def require(path: str) -> None:
    """Raise HapticdError (one line) if matplotlib is missing, or if a report cannot have the file name `path`."""
    require_matplotlib("a report", "fit")
    if not path.lower().endswith((".html", ".png")):
        raise HapticdError(f"{path}: a report must end in .html or .png")


def drawn(path: str, page: Page) -> bytes:
    """Return the content of the report at this path: HTML if it ends in .html, else PNG."""
    if not path.lower().endswith(".html"):
        return _picture(page.rows, "\n".join((page.title, *textwrap.wrap(page.verdict, 110))))
    pictures = "\n".join(html_picture(row) for row in page.rows)
    body = f"""<p><b>{html.escape(page.verdict)}</b></p>
{html_warnings(page.warnings)}
{html_figures(page.figures, page.plain)}
{pictures}
<h2>Recordings</h2>
{html_page.table(("file", "SHA-256"), page.sources, (True, True))}"""
    return fit_page(page.title, body).encode(errors="backslashreplace")


def thinned(x: Floats, y: Floats, max_points: int = 4000) -> tuple[Floats, Floats]:
    """Return about `max_points` points of a line: the smallest and the largest value of each section of the line.

    A section that contains a gap (NaN) keeps the gap.
    """
    if len(x) <= max_points:
        return x, y
    section = math.ceil(2 * len(x) / max_points)
    pieces = [(start, y[start : start + section]) for start in range(0, len(x), section)]
    kept = np.unique([start + end(piece) for start, piece in pieces for end in (np.argmin, np.argmax)])
    return x[kept], y[kept]


def _picture(rows: Sequence[Sequence[Panel]], title: str = "") -> bytes:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    columns, count = max((len(row) for row in rows), default=1), max(1, len(rows))
    titled = 0.27 * (title.count("\n") + 1) if title else 0.0
    width, height = _MARGIN_INCHES[0] + columns * _CELL_INCHES[0], _MARGIN_INCHES[1] + titled + count * _CELL_INCHES[1]
    figure: Figure
    # Fixed layout in inches: an automatic layout measures all text, which takes longer than drawing.
    figure, axes = plt.subplots(count, columns, figsize=(width, height), squeeze=False)
    figure.subplots_adjust(
        left=(_GAP_INCHES[0] + _MARGIN_INCHES[0] / 2) / width,
        right=1 - _MARGIN_INCHES[0] / 2 / width,
        bottom=(_GAP_INCHES[1] / 2 + _MARGIN_INCHES[1] / 2) / height,
        top=1 - (_GAP_INCHES[1] / 2 + _MARGIN_INCHES[1] / 2 + titled) / height,
        wspace=_GAP_INCHES[0] / (_CELL_INCHES[0] - _GAP_INCHES[0]),
        hspace=_GAP_INCHES[1] / (_CELL_INCHES[1] - _GAP_INCHES[1]),
    )
    try:
        for axes_row, row in zip(axes, rows, strict=False):
            for place, panel in zip(axes_row, row, strict=False):
                _draw(place, panel)
            for place in axes_row[len(row) :]:
                place.set_axis_off()
        if title:
            figure.suptitle(literal(title), y=1 - _MARGIN_INCHES[1] / 2 / height, va="top")
        content = io.BytesIO()
        with warnings.catch_warnings():
            # The name of a file may contain letters that the font does not have.
            warnings.filterwarnings("ignore", "Glyph .* missing from", UserWarning)
            figure.savefig(content, format="png", dpi=90)
    finally:
        plt.close(figure)
    return content.getvalue()


def _draw(axes: Axes, panel: Panel) -> None:
    if panel.logarithmic:
        axes.set_xscale("log")
        axes.set_yscale("log")
    for place, curve in enumerate(panel.curves):
        color = curve.color or f"C{place}"
        if curve.points:
            size = 4 if len(curve.x) <= 50 else 2
            if curve.low is not None and curve.high is not None:
                bars = np.maximum(0.0, [curve.y - curve.low, curve.high - curve.y])
                axes.errorbar(
                    curve.x, curve.y, bars, fmt="o", ms=size, lw=1, capsize=2, color=color, label=curve.label, zorder=3
                )
            else:
                mark, size = ("x", size + 2) if curve.crossed else ("o", size)
                axes.plot(curve.x, curve.y, mark, ms=size, color=color, label=curve.label, zorder=3)
            continue
        style = "--" if curve.dashed else "-"
        axes.plot(*thinned(curve.x, curve.y), style, lw=1, color=color, label=curve.label, zorder=4 + place)
        if curve.low is not None and curve.high is not None:
            axes.fill_between(curve.x, curve.low, curve.high, color=color, alpha=0.25, lw=0, label="95 %")
    if panel.logarithmic and panel.curves:
        highest = max(float(np.nanmax(curve.y)) for curve in panel.curves)
        if highest > 0:
            axes.set_ylim(highest * 1e-8, highest * 3)
        _label_logarithmic(axes)
    if panel.counted:
        from matplotlib.ticker import MaxNLocator

        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlabel(panel.x_label)
    axes.set_ylabel(panel.y_label)
    axes.grid(alpha=0.3)
    several = len(panel.curves) > 1
    # The legend stands between curves and title, because there may be no room next to the curves.
    title = panel.title if len(panel.title) <= 56 else f"{panel.title[:28]}…{panel.title[-28:]}"
    axes.set_title(literal(title), fontsize=10, pad=22 if several else 6)
    if several:
        axes.legend(
            loc="lower center",
            bbox_to_anchor=(0.5, 1.0),
            ncols=5,
            fontsize=8,
            frameon=False,
            borderpad=0.2,
            columnspacing=1.2,
            handlelength=1.6,
        )


def _label_logarithmic(axes: Axes) -> None:
    """Label logarithmic axes: below MAX_LABELLED_DECADES with numbers such as 1, 2, 5, else with powers of ten."""
    from matplotlib.ticker import NullLocator

    axes.yaxis.set_minor_locator(NullLocator())  # there would be hundreds, which are slow to draw
    low, high = axes.get_xlim()
    decades = math.log10(high / low) if low > 0 else math.inf
    if decades > MAX_LABELLED_DECADES:
        return
    plain_decades(axes.xaxis, next(steps for limit, steps in LABELS_BY_DECADES if decades <= limit))
    # matplotlib adds labels beyond either end, which would extend the axis.
    axes.set_xlim(low, high)


def figure_rows(
    figures: Mapping[str, Estimate], plain: Mapping[str, float] = MappingProxyType({})
) -> list[tuple[str, str, str, str]]:
    """Return name, value, interval and unit of each fitted value, as text; the values in `plain` have no interval."""
    rows = [
        (name, f"{each.value:.6g}", f"{each.low:.6g} to {each.high:.6g}", unit_of(name) or "")
        for name, each in figures.items()
    ]
    return rows + [(name, f"{value:.6g}", "", unit_of(name) or "") for name, value in plain.items()]


def fit_page(title: str, body: str) -> str:
    """Return an HTML page with this title, this body, and the version of hapticd."""
    return html_page.page(title, f"{body}\n<p>hapticd {html.escape(__version__)}</p>")


def html_figures(figures: Mapping[str, Estimate], plain: Mapping[str, float]) -> str:
    """Return the fitted values as an HTML table."""
    heads, of_text = ("figure", "value", "95 % interval", "unit"), (True, False, False, True)
    return html_page.table(heads, figure_rows(figures, plain), of_text)


def html_picture(row: Sequence[Panel]) -> str:
    """Return a row of pictures as an embedded HTML image."""
    return (
        f'<p><img alt="{html.escape("; ".join(panel.title for panel in row))}" src="data:image/png;base64,'
        f'{base64.b64encode(_picture([row])).decode()}"></p>'
    )


def html_warnings(warnings: Sequence[str]) -> str:
    """Return an HTML paragraph for each warning."""
    return "\n".join(f'<p class="warning">{html.escape(text)}</p>' for text in warnings)
