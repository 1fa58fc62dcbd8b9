"""The report of a fit: pictures of recording and model, the figures with their intervals, and the verdict.

One file: a page whose pictures stand in it, or a picture. matplotlib is imported when something is drawn.
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

_CELL: Final = (5.2, 3.6)
"""Inches of a picture with what is written about it, and below the share of that."""
_GAP: Final = (0.85, 1.05)
_MARGINS: Final = (0.3, 0.2)
MANY_DECADES: Final = 3.5
"""On a logarithmic axis that spans more, powers of ten alone are labelled; one that spans less has"""
STEPS: Final = (
    (0.35, (1.0, 1.2, 1.4, 1.6, 1.8, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0)),
    (0.7, (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0)),
    (1.5, (1.0, 2.0, 5.0)),
    (MANY_DECADES, (1.0, 3.0)),
)
"""these labels a decade, by the decades that it spans at most."""


@dataclass(frozen=True, slots=True)
class Curve:
    """A line, or points; `low` and `high` are a band about the line, or bars at the points. All are (n,)."""

    label: str
    x: Floats
    y: Floats
    points: bool = False
    crossed: bool = False
    """Points that are not used: crosses."""
    dashed: bool = False
    color: str | None = None
    """matplotlib's name; None: the next one."""
    low: Floats | None = None
    high: Floats | None = None


@dataclass(frozen=True, slots=True)
class Panel:
    """One picture."""

    title: str
    x_label: str
    y_label: str
    curves: tuple[Curve, ...]
    logarithmic: bool = False
    """Both axes."""
    counted: bool = False
    """Along x are whole numbers."""


@dataclass(frozen=True, slots=True)
class Page:
    """What is reported of a fit."""

    title: str
    verdict: str
    warnings: tuple[str, ...]
    figures: Mapping[str, Estimate]
    plain: Mapping[str, float]
    """Figures that have no interval."""
    sources: Sequence[tuple[str, str]]
    """Path and SHA-256."""
    rows: Sequence[Sequence[Panel]]
    """Of pictures."""


def require(path: str) -> None:
    """Raises HapticdError (one line) where a report cannot be drawn, or not one with that ending."""
    require_matplotlib("a report", "fit")
    if not path.lower().endswith((".html", ".png")):
        raise HapticdError(f"{path}: is no kind of report: must end in .html or .png")


def drawn(path: str, page: Page) -> bytes:
    """The report that is to stand at this path, whose ending says which kind."""
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


def thinned(x: Floats, y: Floats, most: int = 4000) -> tuple[Floats, Floats]:
    """At most about `most` points of a line, with the least and the largest value of each stretch among them. Of a
    stretch with a gap (NaN) in it the gap is kept."""
    if len(x) <= most:
        return x, y
    stretch = math.ceil(2 * len(x) / most)
    pieces = [(start, y[start : start + stretch]) for start in range(0, len(x), stretch)]
    kept = np.unique([start + end(piece) for start, piece in pieces for end in (np.argmin, np.argmax)])
    return x[kept], y[kept]


def _picture(rows: Sequence[Sequence[Panel]], title: str = "") -> bytes:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    columns, count = max((len(row) for row in rows), default=1), max(1, len(rows))
    titled = 0.27 * (title.count("\n") + 1) if title else 0.0
    width, height = _MARGINS[0] + columns * _CELL[0], _MARGINS[1] + titled + count * _CELL[1]
    figure: Figure
    # Laid out in inches, by hand: to measure every letter takes longer than to draw it all.
    figure, axes = plt.subplots(count, columns, figsize=(width, height), squeeze=False)
    figure.subplots_adjust(
        left=(_GAP[0] + _MARGINS[0] / 2) / width,
        right=1 - _MARGINS[0] / 2 / width,
        bottom=(_GAP[1] / 2 + _MARGINS[1] / 2) / height,
        top=1 - (_GAP[1] / 2 + _MARGINS[1] / 2 + titled) / height,
        wspace=_GAP[0] / (_CELL[0] - _GAP[0]),
        hspace=_GAP[1] / (_CELL[1] - _GAP[1]),
    )
    try:
        for axes_row, row in zip(axes, rows, strict=False):
            for place, panel in zip(axes_row, row, strict=False):
                _draw(place, panel)
            for place in axes_row[len(row) :]:
                place.set_axis_off()
        if title:
            figure.suptitle(literal(title), y=1 - _MARGINS[1] / 2 / height, va="top")
        content = io.BytesIO()
        with warnings.catch_warnings():
            # The font has not every letter that a file's name may have.
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
        largest = max(float(np.nanmax(curve.y)) for curve in panel.curves)
        if largest > 0:
            axes.set_ylim(largest * 1e-8, largest * 3)
        _label_logarithmic(axes)
    if panel.counted:
        from matplotlib.ticker import MaxNLocator

        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlabel(panel.x_label)
    axes.set_ylabel(panel.y_label)
    axes.grid(alpha=0.3)
    several = len(panel.curves) > 1
    # Beside the curves there may be no room: what they are stands between them and the title.
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
    """As many labels as have room: of less than a decade 1, 2, 5 and so on as plain numbers, of more only decades."""
    from matplotlib.ticker import NullLocator

    axes.yaxis.set_minor_locator(NullLocator())  # hundreds of them, and each takes its time
    low, high = axes.get_xlim()
    decades = math.log10(high / low) if low > 0 else math.inf
    if decades > MANY_DECADES:
        return
    plain_decades(axes.xaxis, next(steps for most, steps in STEPS if decades <= most))
    # matplotlib adds what it has beyond either end, which would stretch the axis.
    axes.set_xlim(low, high)


def figure_rows(
    figures: Mapping[str, Estimate], plain: Mapping[str, float] = MappingProxyType({})
) -> list[tuple[str, str, str, str]]:
    """Name, value, interval and unit of each figure, as text; `plain` have no interval."""
    rows = [
        (name, f"{each.value:.6g}", f"{each.low:.6g} to {each.high:.6g}", unit_of(name) or "")
        for name, each in figures.items()
    ]
    return rows + [(name, f"{value:.6g}", "", unit_of(name) or "") for name, value in plain.items()]


def fit_page(title: str, body: str) -> str:
    """A page of fits: below its heading this text of HTML, and by which version it was made."""
    return html_page.page(title, f"{body}\n<p>hapticd {html.escape(__version__)}</p>")


def html_figures(figures: Mapping[str, Estimate], plain: Mapping[str, float]) -> str:
    """The figures of a fit as a table."""
    heads, of_text = ("figure", "value", "95 % interval", "unit"), (True, False, False, True)
    return html_page.table(heads, figure_rows(figures, plain), of_text)


def html_picture(row: Sequence[Panel]) -> str:
    """A row of pictures, in the page itself."""
    return (
        f'<p><img alt="{html.escape("; ".join(panel.title for panel in row))}" src="data:image/png;base64,'
        f'{base64.b64encode(_picture([row])).decode()}"></p>'
    )


def html_warnings(warnings: Sequence[str]) -> str:
    """One paragraph each."""
    return "\n".join(f'<p class="warning">{html.escape(text)}</p>' for text in warnings)
