"""Draws the figures of a sweep as PNG files and as SVG for a page."""

from __future__ import annotations

import io
import re
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from hapticd.analysis.drawing import drawing, literal, svg_element
from hapticd.sweeps.axis_scales import key_scale, shown
from hapticd.sweeps.default_figures import default_figures
from hapticd.sweeps.figure_keys import SweepFigure
from hapticd.sweeps.line_figure import draw_lines
from hapticd.sweeps.map_figure import draw_map
from hapticd.sweeps.results import Results

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MATPLOTLIB_STYLE: Final = {"font.size": 9, "axes.titlesize": 9, "axes.linewidth": 0.6, "legend.fontsize": 8}
"""Settings of matplotlib for all figures; sizes are in points."""
_MAX_NAME_CHARACTERS: Final = 60
"""Length in characters at which a title is cut in the name of its figure's file."""


@dataclass(frozen=True)
class Drawing:
    """A figure with its title and caption, ready to be drawn."""

    title: str
    caption: str
    """The varied keys that are constant in the figure, with their values; may be empty."""
    keys: SweepFigure
    results: Results

    def draw(self) -> Figure:
        """Return a matplotlib figure, drawn with matplotlib's current settings. Raises HapticdError."""
        from matplotlib.figure import Figure

        draw: Callable[[Figure, Results, SweepFigure], None] = draw_map if self.keys.kind == "map" else draw_lines
        figure = Figure(layout="constrained")
        draw(figure, self.results, self.keys)
        figure.suptitle(literal(self.title if not self.caption else f"{self.title}\n{self.caption}"), fontsize=10)
        return figure

    def png(self) -> bytes:
        """Return the figure as a PNG file on a white background."""
        content = io.BytesIO()
        with drawing(_MATPLOTLIB_STYLE, self.title):
            self.draw().savefig(content, format="png", dpi=150)
        return content.getvalue()

    def svg(self) -> str:
        """Return the figure as an SVG element in the colors of the page."""
        with drawing(_MATPLOTLIB_STYLE, self.title, page_colors=True):
            return svg_element(self.draw(), self.title)


def drawings_of(results: Results) -> list[Drawing]:
    """Return the maps and line figures of the study, or the default figures if the study has no key `figures`."""
    named = results.study.figures
    keys = default_figures(results) if named is None else [each for each in named if each.kind != "table"]
    return [
        Drawing(title_of(results, each), _listed(results, each) if each.where else "", each, results) for each in keys
    ]


def file_names(drawings: Sequence[Drawing]) -> list[str]:
    """Return a file name for the PNG of each figure, made of the figure's number and title."""
    words = [re.sub(r"[^a-z0-9]+", " ", each.title.lower()).strip() for each in drawings]
    kept = [textwrap.wrap(text, _MAX_NAME_CHARACTERS)[0] if text else "figure" for text in words]
    return [f"{number}-{text.replace(' ', '-')}.png" for number, text in enumerate(kept, 1)]


def title_of(results: Results, figure: SweepFigure) -> str:
    """Return the title of a figure; by default it is made of the labels of its columns and axes."""
    if figure.title is not None:
        return figure.title
    if figure.kind == "table":
        return f"Points with {_listed(results, figure)}" if figure.where else "Points"
    assert figure.x is not None and figure.y is not None
    words = results.words
    drawn = figure.color if figure.kind == "map" else figure.y
    over = [figure.x, *(figure.y if figure.kind == "map" else ())]
    what = figure.axis_label or ", ".join(words(name) for name in drawn or ())
    text = f"{what} over {' and '.join(words(name) for name in over)}"
    return text[0].upper() + text[1:]


def _listed(results: Results, figure: SweepFigure) -> str:
    """Return the entries of the figure's key `where` as text with units: `handle mass: 40 g`."""
    found = []
    for name, value in figure.where.items():
        column = results.column(name)
        text = key_scale(results, name).text(value) if column.role == "varied" else f"{shown(value)} {column.unit}"
        found.append(f"{results.words(name)}: {text}".rstrip())
    return ", ".join(found)
