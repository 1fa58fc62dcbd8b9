"""Draws a map: the values of a measured column as colors over two varied keys.

Several columns, or the values of a third varied key, have one panel each.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from hapticd.analysis.drawing import literal
from hapticd.base.errors import HapticdError
from hapticd.sweeps.axis_scales import Scale, key_scale, measured_scale, shown
from hapticd.sweeps.columns import Row, Value
from hapticd.sweeps.figure_keys import SweepFigure
from hapticd.sweeps.line_figure import NO_RESULT_LABEL
from hapticd.sweeps.results import Results, with_values

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PANELS_PER_ROW: Final = 4
"""Maximum number of panels side by side."""
_PANEL_INCHES: Final = (2.5, 2.3)
"""Width and height of a panel in a map with several panels, in inches."""
_ONE_PANEL_INCHES: Final = (5.4, 3.9)
"""Width and height of a single panel, in inches."""
_MARGINS_INCHES: Final = (1.6, 1.3)
"""Width and height of the figure outside its panels, in inches."""
_PANEL_PADDING_INCHES: Final = 0.1
"""Horizontal padding of a panel in inches, so that tick labels of neighbouring panels do not overlap."""
MAX_MAP_TEXTS: Final = 8
"""Maximum number of different texts in a map: the number of _TEXT_COLORS."""
_TEXT_COLORS: Final = ("#4477aa", "#88ccee", "#ddaa33", "#cc4455", "#aa77aa", "#777777", "#228833", "#663333")
"""Colors of texts; people with a color vision deficiency can distinguish them, too."""
_BOOLEAN_COLORS: Final = ("#cc6644", "#4477aa")
"""Colors of false and true."""
_MAX_INTEGER_COLORS: Final = 12
"""Integers that span at most 12 values have a separate color for each value."""
_MAX_VECTOR_CELLS: Final = 5000
"""In SVG, a map with more cells or dots is drawn as a raster image."""
_OVERLAY_TOLERANCE: Final = 1e-9
"""Relative difference up to which two values of an overlay at the same x count as equal."""


@dataclass(frozen=True, slots=True)
class _Panel:
    """One panel of a map: its title, its column, and the rows of its points."""

    title: str
    column: str
    rows: Sequence[Row]


@dataclass(frozen=True, slots=True)
class _Colors:
    """The color scale of a map: a numeric scale for numbers, categories for texts and booleans."""

    scale: Scale | None
    """Scale of numbers; None for categories."""
    categories: tuple[Value, ...]
    """Texts or booleans, each with a color; empty for numbers."""
    keywords: dict[str, Any]
    """Keyword arguments of matplotlib's drawing functions."""
    has_infinite: bool = False

    @property
    def largest(self) -> float:
        """The number that has the last color of the color map."""
        return float(self.keywords["norm"].vmax)

    def at(self, values: Sequence[Value]) -> npt.NDArray[np.float64]:
        """Return the position of each value on the color map, (n,); NaN for None."""
        if self.scale is not None:
            numbers = self.scale.at(values)
            # matplotlib omits infinite numbers. A finite number above the largest gets the last color.
            return np.where(np.isposinf(numbers), self.largest + abs(self.largest) + 1.0, numbers)
        return np.array([math.nan if value is None else float(self.categories.index(value)) for value in values])


def draw_map(figure: Figure, results: Results, keys: SweepFigure) -> None:
    """Draw the panels of a map with one color scale.

    A point without a result is a cross; the cell of a point that is not computed yet is empty. Infinite values have the
    last color, and the color bar then ends in an arrow.

    Raises HapticdError if an overlay has several values at one x, or a column more than MAX_MAP_TEXTS different texts.
    """
    assert keys.x is not None and keys.y is not None and keys.color is not None
    panels = _panels(results, keys, with_values(results.rows, keys.where))
    x, y = key_scale(results, keys.x), key_scale(results, keys.y[0])
    colors = _colors(results, keys, panels)
    across = min(_PANELS_PER_ROW, len(panels))
    down = math.ceil(len(panels) / across)
    size = _ONE_PANEL_INCHES if len(panels) == 1 else _PANEL_INCHES
    engine = figure.get_layout_engine()
    if engine is not None and len(panels) > 1:
        engine.set(w_pad=_PANEL_PADDING_INCHES)  # type: ignore[call-arg]
    figure.set_size_inches(_MARGINS_INCHES[0] + across * size[0], _MARGINS_INCHES[1] + down * size[1])
    grid: npt.NDArray[Any] = figure.subplots(down, across, squeeze=False, sharex=True, sharey=True)
    places = list(grid.flat)
    drawn = None
    for axes, panel in zip(places, panels, strict=False):
        x.prepare(axes, "x")
        y.prepare(axes, "y")
        drawn = _draw_cells(axes, results, panel, keys, x, y, colors) or drawn
        if len(panels) > 1:
            axes.set_title(literal(panel.title))
    for place, axes in enumerate(places):
        if place >= len(panels):
            axes.set_axis_off()
            continue
        x.label_ticks(axes, "x")
        y.label_ticks(axes, "y")
        if place + across >= len(panels):
            axes.xaxis.set_tick_params(labelbottom=True)
            axes.set_xlabel(literal(x.label))
        if place % across == 0:
            axes.set_ylabel(literal(y.label))
    _add_legend(figure, places[: len(panels)], places, results, keys, colors, drawn)


def _panels(results: Results, keys: SweepFigure, rows: Sequence[Row]) -> list[_Panel]:
    assert keys.color is not None
    if keys.by is None:
        return [_Panel(results.words(name), name, rows) for name in keys.color]
    scale, found = key_scale(results, keys.by), []
    for value in results.values(keys.by):
        text = scale.text(value) if scale.spacing == "categories" else f"{results.words(keys.by)} {scale.text(value)}"
        found.append(_Panel(text, keys.color[0], [row for row in rows if row[keys.by] == value]))
    return found


def _colors(results: Results, keys: SweepFigure, panels: Sequence[_Panel]) -> _Colors:
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap, LogNorm, Normalize

    assert keys.color is not None
    column = results.column(keys.color[0])
    values = [row[panel.column] for panel in panels for row in panel.rows]
    if column.kind in ("text", "boolean"):
        found = {value for value in values if value is not None}
        listed = [text for text in keys.legend or () if text in found]
        categories: tuple[Value, ...] = (*listed, *sorted(found - set(listed), key=str))
        if column.kind == "boolean":
            categories = (False, True)
        if len(categories) > MAX_MAP_TEXTS:
            raise HapticdError(
                f"figures: {column.name} has {len(categories)} different texts; a map can have at most {MAX_MAP_TEXTS}"
            )
        palette = _BOOLEAN_COLORS if column.kind == "boolean" else _TEXT_COLORS[: max(1, len(categories))]
        limits = {"vmin": -0.5, "vmax": max(1, len(categories)) - 0.5}
        return _Colors(None, categories, {"cmap": ListedColormap(palette), **limits})
    scale = measured_scale(results, keys.color, keys.axis_label, values)
    numbers = scale.at(values)
    finite = numbers[np.isfinite(numbers)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)
    if column.kind == "integer" and high - low < _MAX_INTEGER_COLORS:
        # A color for each number.
        count = round(high - low) + 1
        steps = colormaps["viridis"].resampled(count)
        return _Colors(scale, (), {"cmap": steps, "norm": Normalize(low - 0.5, high + 0.5)})
    if low == high:
        low, high = low - 0.5 * (abs(low) or 1.0), high + 0.5 * (abs(high) or 1.0)
    norm = LogNorm(low, high) if scale.spacing == "logarithmic" else Normalize(low, high)
    return _Colors(scale, (), {"cmap": "viridis", "norm": norm}, bool(np.isposinf(numbers).any()))


def _draw_cells(
    axes: Axes, results: Results, panel: _Panel, keys: SweepFigure, x: Scale, y: Scale, colors: _Colors
) -> Any:
    """Draw points as cells if all axes are crossed, else as dots; return matplotlib's mappable for a color bar."""
    assert keys.x is not None and keys.y is not None
    at_x = x.at([row[keys.x] for row in panel.rows])
    at_y = y.at([row[keys.y[0]] for row in panel.rows])
    values = colors.at([row[panel.column] for row in panel.rows])
    if results.study.combine == "crossed":
        columns, lines = np.unique(x.at(results.values(keys.x))), np.unique(y.at(results.values(keys.y[0])))
        cells = np.full((len(lines), len(columns)), math.nan)
        cells[np.searchsorted(lines, at_y), np.searchsorted(columns, at_x)] = values
        shown_cells = np.ma.masked_where(np.isnan(cells), cells)
        places = x.edges(columns), y.edges(lines)
        is_image = cells.size > _MAX_VECTOR_CELLS
        drawn: Any = axes.pcolormesh(
            *places, shown_cells, edgecolors="face", lw=0.8, rasterized=is_image, **colors.keywords
        )
        limits = axes.get_ylim()
    else:
        known = ~np.isnan(values)
        is_image = len(values) > _MAX_VECTOR_CELLS
        drawn = axes.scatter(at_x[known], at_y[known], c=values[known], s=16, rasterized=is_image, **colors.keywords)
        limits = axes.get_ylim()
    missing = np.isnan(values)
    if missing.any():
        size = 5.0 if missing.sum() <= 200 else 2.5
        ink = axes.xaxis.label.get_color()
        axes.plot(at_x[missing], at_y[missing], "x", ms=size, mew=1.0, color=ink, label=NO_RESULT_LABEL)
    _draw_overlays(axes, results, panel, keys, x, y)
    axes.set_ylim(limits)
    return drawn


def _draw_overlays(axes: Axes, results: Results, panel: _Panel, keys: SweepFigure, x: Scale, y: Scale) -> None:
    """Draw overlay columns as dashed black lines with a white border, which is visible on any color."""
    from matplotlib.patheffects import withStroke

    assert keys.x is not None
    for number, name in enumerate(keys.overlay or ()):
        found: dict[Value, float] = {}
        for row in panel.rows:
            value = row[name]
            if value is None:
                continue
            known = found.setdefault(row[keys.x], float(value))
            if abs(known - float(value)) > _OVERLAY_TOLERANCE * abs(known):
                raise HapticdError(
                    f"figures: overlay {name} has more than one value at {keys.x} {shown(row[keys.x])}: it must depend "
                    f"on {keys.x} only"
                )
        axes.plot(
            x.at(list(found)),
            y.at(list(found.values())),
            ("--", ":", "-.")[number % 3],
            color="black",
            lw=1.5,
            path_effects=[withStroke(linewidth=3.2, foreground="white")],
            label=literal(results.words(name)),
            zorder=5,
        )


def _add_legend(
    figure: Figure,
    used: Sequence[Axes],
    all_axes: Sequence[Axes],
    results: Results,
    keys: SweepFigure,
    colors: _Colors,
    drawn: Any,
) -> None:
    """Add to a map a color bar for numbers, and a legend for texts, lines and crosses."""
    from matplotlib.patches import Patch

    assert keys.color is not None
    handles: dict[str, Any] = {}
    if colors.scale is None:
        palette = colors.keywords["cmap"]
        words = results.words(keys.color[0])
        for place, value in enumerate(colors.categories):
            text = (keys.legend or {}).get(str(value), shown(value))
            if isinstance(value, bool):
                text = f"{words}: {shown(value)}"
            handles[literal(text)] = Patch(color=palette(place))
    elif drawn is not None:
        bar = figure.colorbar(
            drawn,
            ax=list(all_axes),
            label=literal(colors.scale.label),
            extend="max" if colors.has_infinite else "neither",
        )
        bar.outline.set_linewidth(0.6)
        colors.scale.label_ticks(bar.ax, "y")
    for axes in used:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    if handles:
        figure.legend(
            list(handles.values()), list(handles), loc="outside lower center", ncols=min(5, len(handles)), frameon=False
        )
