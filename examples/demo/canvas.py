"""The sheet of the plot: twelve panels with letters, residuals and captions, and one legend for all of them.

Three colours, of the palette of Okabe and Ito, have the same meaning in all panels: blue dots are measured, an orange
line is the library, a black dashed line is the paper. They also differ in brightness and in mark. Dots lie over lines.
"""

from __future__ import annotations

import textwrap
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from examples.demo.perform import MASS_KG, Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MEASURED: Final[dict[str, Any]] = {"color": "#0072B2", "ls": "none", "marker": "o", "ms": 2.8, "mew": 0, "zorder": 4}
LIBRARY: Final[dict[str, Any]] = {"color": "#E69F00", "ls": "-", "lw": 2.2, "zorder": 2}
PAPER: Final[dict[str, Any]] = {"color": "#000000", "ls": (0, (3, 2)), "lw": 0.9, "zorder": 3}
GUIDE_COLOR: Final = "#BBBBBB"
"""Colour of lines without a meaning: zero and the positions of grooves."""
MEANINGS: Final = (
    ("measured in the telemetry of the daemon", MEASURED),
    ("library: the shipped materials", LIBRARY),
    ("paper: Okamura, Dennerlein, Howe 1998", PAPER),
)
SETTINGS: Final = {
    "font.size": 8.5,
    "axes.labelsize": 8.5,
    "axes.linewidth": 0.6,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "axes.axisbelow": True,
    "svg.fonttype": "none",
}
COLUMNS, ROWS = 3, 4
LETTERS: Final = "abcdefghijkl"
CELL_IN: Final = (3.34, 3.42)
"""Width and height of a cell; this and all other lengths of the sheet are in inches."""
LEFT_IN, RIGHT_IN, TITLE_IN, CURVES_IN, BETWEEN_IN, RESIDUAL_IN, LABEL_IN = 0.62, 0.12, 0.26, 1.5, 0.08, 0.52, 0.42
WIDE_IN: Final = CELL_IN[0] - LEFT_IN - RIGHT_IN
HEADER_IN: Final = 0.95
FOOTER_IN: Final = 0.62
CAPTION_CHARACTERS: Final = 52
"""Longest line of a caption; it fits the width of a cell."""
MAX_DOTS: Final = 70
"""Largest number of samples that are drawn of a curve, so that the lines below the dots remain visible."""
RESIDUAL_TICKS_PERCENT: Final = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
"""Ticks of residuals. The smallest is 1 %, so that rounding errors do not fill the axis."""
PNG_COLORS: Final = 64
FOOTNOTE: Final = (
    "Captions give measured / library / paper; n is the number of fitted taps, strikes or ruptures. Residuals are "
    "measured minus library: in (a) to (g), (i) and (j) in % of the largest value of the library's curve, in (h), (k) "
    "and (l) in % of the library's value. The curves of library and paper are those of the true speed of the handle. "
    "The daemon renders with an estimate of this speed. The curves of the paper are its equations 1 to 3 with the "
    "figures that it prints. Where it prints none, no curve is drawn."
)


def percent_of_peak(measured: Floats, library: Floats) -> Floats:
    """Return the difference of two curves in per cent of the largest absolute value of `library`."""
    return np.asarray(100 * (measured - library) / abs(library).max())


def percent_of_value(measured: Floats, library: Floats) -> Floats:
    """Return the difference in per cent of each value of `library`."""
    return np.asarray(100 * (measured / library - 1))


def spread(values: Floats, gap: float) -> Floats:
    """Return positions of labels at rising `values`: each at least `gap` above the one before, and near its value."""
    steps = gap * np.arange(len(values))
    # Labels that only give way upwards, and labels that only give way downwards, are equally far from their values.
    upwards = np.maximum.accumulate(values - steps) + steps
    downwards = np.minimum.accumulate((values - steps)[::-1])[::-1] + steps
    return np.asarray((upwards + downwards) / 2)


@dataclass(frozen=True, slots=True)
class Panel:
    """A panel: curves above, residuals below, and a caption."""

    letter: str
    curves: Axes
    residuals: Axes

    def title(self, text: str) -> None:
        self.curves.set_title(f"({self.letter}) {text}", fontsize=9.5, fontweight="bold", loc="left", pad=4)

    def axes(self, x: str, y: str) -> None:
        """Name both axes, each by quantity and unit."""
        self.curves.set_ylabel(y)
        self.curves.tick_params(labelbottom=False)
        self.residuals.set_ylabel("residual, %")
        self.residuals.set_xlabel(x, labelpad=2)
        for axes in (self.curves, self.residuals):
            axes.grid(color="#EEEEEE", lw=0.5)

    def residual(self, x: Floats, percent: Floats, marker: str = "o") -> None:
        """Draw residuals, and widen the axis for them."""
        widened = bool(self.residuals.lines)
        self.residuals.plot(x, percent, **{**MEASURED, "ms": 1.8, "marker": marker})
        self.residuals.axhline(0.0, color=GUIDE_COLOR, lw=0.8, zorder=1)
        largest = max(float(abs(percent).max(initial=0.0)), self.residuals.get_yticks()[-1] if widened else 0.0)
        tick = next((tick for tick in RESIDUAL_TICKS_PERCENT if 1.2 * tick >= largest), largest)
        self.residuals.set_yticks([-tick, 0, tick])
        self.residuals.set_ylim(-1.4 * tick, 1.4 * tick)

    def caption(self, *lines: str) -> None:
        """Write lines below the panel, and break those that are too long."""
        self.residuals.text(
            -(LEFT_IN - 0.1) / WIDE_IN,
            -LABEL_IN / RESIDUAL_IN,
            "\n".join(textwrap.fill(line, CAPTION_CHARACTERS) for line in lines),
            transform=self.residuals.transAxes,
            va="top",
            fontsize=7.8,
            linespacing=1.15,
        )

    def empty(self, reason: str) -> None:
        """Draw no curves, but the reason."""
        self.curves.set_axis_off()
        self.residuals.set_axis_off()
        self.caption(reason)

    def waveform(self, x: Floats, measured: Floats, library: Floats) -> str:
        """Draw the samples of a curve and their residuals; return which of them are drawn, for the caption."""
        step = max(1, -(-len(x) // MAX_DOTS))
        self.curves.plot(x[::step], measured[::step], **MEASURED)
        self.residual(x[::step], percent_of_peak(measured, library)[::step])
        return "" if step == 1 else f", one sample of {step} drawn"


def sheet() -> tuple[Figure, list[Panel]]:
    """Return an empty figure, and its panels (a) to (l) in order."""
    from matplotlib.figure import Figure

    width, height = COLUMNS * CELL_IN[0], HEADER_IN + ROWS * CELL_IN[1] + FOOTER_IN
    figure = Figure(figsize=(width, height))

    def axes(left: float, top: float, high: float, **shared: Any) -> Axes:
        return figure.add_axes((left / width, 1 - (top + high) / height, WIDE_IN / width, high / height), **shared)

    panels = []
    for number, letter in enumerate(LETTERS):
        left = number % COLUMNS * CELL_IN[0] + LEFT_IN
        top = HEADER_IN + number // COLUMNS * CELL_IN[1] + TITLE_IN
        curves = axes(left, top, CURVES_IN)
        panels.append(Panel(letter, curves, axes(left, top + CURVES_IN + BETWEEN_IN, RESIDUAL_IN, sharex=curves)))
    return figure, panels


def finish(figure: Figure, rate_hz: float, skipped: int, periods: int) -> None:
    """Write heading, legend and footnote."""
    from matplotlib.lines import Line2D

    width, height = figure.get_size_inches()
    figure.text(
        0.1 / width, 1 - 0.25 / height, "Measured, over the library, over the paper", fontsize=12.5, weight="bold"
    )
    figure.text(
        0.1 / width,
        1 - 0.48 / height,
        f"Vibrations and forces of the simulated joystick: {rate_hz:,.0f} Hz, effective mass of handle and hand "
        f"{MASS_KG:g} kg, {skipped:,} of {periods:,} periods missed",
        fontsize=9,
    )
    samples = [
        Line2D([], [], label=label, **{**style, "ms": 5} if "ms" in style else style) for label, style in MEANINGS
    ]
    figure.legend(
        handles=samples, loc="upper left", bbox_to_anchor=(0.0, 1 - 0.52 / height), ncols=3, fontsize=9, frameon=False
    )
    figure.text(0.1 / width, 0.06 / height, textwrap.fill(FOOTNOTE, 172), fontsize=7.8, va="bottom", linespacing=1.2)


def write(figure: Figure, png: Path) -> None:
    """Write the figure to a PNG and, beside it, an SVG."""
    from PIL import Image

    figure.savefig(png, dpi=120)
    with Image.open(png) as drawn:
        # Fewer colours make the file a third as large.
        drawn.convert("RGB").quantize(PNG_COLORS, dither=Image.Dither.NONE).save(png, optimize=True)
    figure.savefig(png.with_suffix(".svg"), metadata={"Date": None})
