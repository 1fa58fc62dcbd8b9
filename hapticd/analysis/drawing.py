"""Helpers of figures and result pages: matplotlib, SVG elements, axis labels.

matplotlib is optional, and imported only when something is drawn.
"""

from __future__ import annotations

import html
import io
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final

from hapticd.base.errors import HapticdError
from hapticd.system.extras import install_command

if TYPE_CHECKING:
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

PAGE_TEXT_COLOR: Final = "#010203"
"""Placeholder for the text color of the page in a figure; svg_element replaces the placeholder by currentColor."""
_TEXT_COLOR_SETTINGS: Final = (
    "text.color",
    "axes.edgecolor",
    "axes.labelcolor",
    "axes.titlecolor",
    "xtick.color",
    "ytick.color",
)
"""Settings of matplotlib for the colors of text, frames and ticks."""


def require_matplotlib(what: str, extra: str) -> None:
    """Raise HapticdError if matplotlib is missing; `what` names the feature that needs it, such as "the report"."""
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        raise HapticdError(f"{what} needs matplotlib: {install_command(extra)}") from None


def literal(text: str) -> str:
    """Escape text so that matplotlib does not read it as a formula."""
    return text.replace("$", r"\$")


@contextmanager
def drawing(settings: Mapping[str, Any], salt: str, page_colors: bool = False) -> Iterator[None]:
    """Apply settings of matplotlib in a `with` statement. With an equal `salt`, equal figures yield equal SVG text.

    With `page_colors`, text, frames and ticks have the text color of the page, and the background is transparent.
    """
    import matplotlib

    known: dict[Any, Any] = {"svg.hashsalt": salt, **settings}
    if page_colors:
        known |= dict.fromkeys(_TEXT_COLOR_SETTINGS, PAGE_TEXT_COLOR) | {
            "figure.facecolor": "none",
            "axes.facecolor": "none",
        }
    with matplotlib.rc_context(known):
        yield


def svg_element(figure: Figure, title: str) -> str:
    """Return a figure as an HTML element; `title` is its description for screen readers."""
    content = io.StringIO()
    figure.savefig(content, format="svg", metadata={"Date": None})
    text = content.getvalue()
    drawn = text[text.index("<svg") :].replace(PAGE_TEXT_COLOR, "currentColor")
    return f'<span role="img" aria-label="{html.escape(title)}">{drawn}</span>'


def plain_decades(axis: Axis, steps: tuple[float, ...]) -> None:
    """Label a logarithmic axis with plain numbers, such as 200, 500, 1000, at these steps of each decade."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator

    axis.set_major_locator(LogLocator(subs=steps))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator())
    axis.set_minor_formatter(NullFormatter())
