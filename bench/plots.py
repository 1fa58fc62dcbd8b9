"""The report's figures: cost on one axis, error on the other, both logarithmic, the chosen way ringed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from hapticd.base.files import check_regular

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

COLOURS = (
    *("#0072b2", "#e69f00", "#009e73", "#d55e00", "#cc79a7", "#56b4e9"),
    *("#7f7f7f", "#8c564b", "#bcbd22", "#393b79", "#17a37f", "#843c39"),
)
"""The first six are those of Okabe and Ito, which colour-blind readers tell apart."""
MARKERS = "osD^v<>pPX*h"
SMALLEST = 1e-17
"""Where an error of exactly zero is drawn: below what rounding leaves."""
NARROWEST = 4.0
"""An axis of costs spans at least this factor."""
DPI = 100


@dataclass(frozen=True, slots=True)
class Figure:
    """A picture of a section."""

    name: str
    """Of its file, without suffix."""
    caption: str
    draw: Callable[[Canvas], None]
    size_in: tuple[float, float] = (9.0, 5.0)

    def save(self, folder: Path) -> Path:
        """Draws it into `folder`; the file."""
        # Without a window, and loaded only where something is drawn.
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure as Canvas

        canvas = Canvas(figsize=self.size_in, dpi=DPI, layout="constrained")
        FigureCanvasAgg(canvas)
        self.draw(canvas)
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / f"{self.name}.png"
        check_regular(path)
        canvas.savefig(path, metadata={"Software": None})
        return path


@dataclass(frozen=True, slots=True)
class Point:
    """One way of doing it. `costs` are of all rounds; `error` is one figure."""

    name: str
    costs: Sequence[float]
    error: float
    chosen: bool = False


def trade(axes: Axes, points: Sequence[Point | None], *, hollow: bool = False) -> None:
    """Points with the tenth to the ninetieth percentile of their cost. Marker and colour go by the place in the row, of
    which a None is only left out. Hollow ones are drawn beside filled ones, and bear no name of their own."""
    import numpy as np

    for index, point in enumerate(points):
        if point is None:
            continue
        low, middle, high = np.percentile(point.costs, [10, 50, 90])
        zero = point.error < SMALLEST
        name = f"{point.name}{' (error 0)' if zero else ''}{' - chosen' if point.chosen else ''}"
        colour = COLOURS[index % len(COLOURS)]
        error = max(point.error, SMALLEST)
        axes.errorbar(
            [middle],
            [error],
            xerr=[[middle - low], [high - middle]],
            fmt=MARKERS[index % len(MARKERS)],
            color=colour,
            markerfacecolor="none" if hollow else colour,
            markersize=7,
            elinewidth=1,
            label=None if hollow else name,
        )
        if point.chosen:
            axes.plot([middle], [error], "o", markersize=15, markerfacecolor="none", markeredgecolor="black")
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.grid(True, which="major", linewidth=0.4, alpha=0.6)


def _plain_ticks(axes: Axes) -> None:
    """Numbers as people write them, where they are not too far apart for that."""
    from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

    low, high = axes.get_xlim()
    if high / low < NARROWEST:
        # Costs that are all alike shall look so.
        wider = (NARROWEST * low / high) ** 0.5
        axes.set_xlim(low / wider, high * wider)
    for axis, bounds in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
        axis.set_minor_formatter(NullFormatter())
        spread = bounds[1] / bounds[0]
        if spread > 1e4:
            continue
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        if spread < 6:
            axis.set_major_locator(MaxNLocator(4))
        else:
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if spread < 30 else (1.0, 3.0)))


def beside(canvas: Canvas, axes: Axes) -> None:
    """The last of a drawing: its ticks, and one legend to the right of everything, from the labels of one plot."""
    for each in canvas.axes:
        _plain_ticks(each)
    handles, labels = axes.get_legend_handles_labels()
    canvas.legend(handles, labels, loc="outside right upper", fontsize=8, frameon=False)
