"""What every figure and page of results shares: matplotlib where it is installed, SVG that stands in a page, labels.

matplotlib is imported when something is drawn.
"""

from __future__ import annotations

import html
import io
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final

from hapticd.base.errors import HapticdError

if TYPE_CHECKING:
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

INK: Final = "#010203"
"""Stands in a figure of `page_colors` for the color of the page's text, which a browser chooses: light or dark."""
_INKED: Final = ("text.color", "axes.edgecolor", "axes.labelcolor", "axes.titlecolor", "xtick.color", "ytick.color")


def require_matplotlib(what: str, extra: str) -> None:
    """Raises HapticdError (one line) where matplotlib is missing. `what` needs it, as `the report`."""
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        raise HapticdError(f"{what} needs matplotlib: pip install 'hapticd[{extra}]'") from None


def literal(text: str) -> str:
    """Text that matplotlib takes for no formula."""
    return text.replace("$", r"\$")


@contextmanager
def drawing(settings: Mapping[str, Any], salt: str, page_colors: bool = False) -> Iterator[None]:
    """Draws with these settings of matplotlib; the same figure has the same text of SVG, whenever it is drawn.

    With `page_colors`, text, frames and ticks have the color of the page's text, and nothing is behind them.
    """
    import matplotlib

    known: dict[Any, Any] = {"svg.hashsalt": salt, **settings}
    if page_colors:
        known |= dict.fromkeys(_INKED, INK) | {"figure.facecolor": "none", "axes.facecolor": "none"}
    with matplotlib.rc_context(known):
        yield


def svg_element(figure: Figure, title: str) -> str:
    """A figure as an element of a page; `title` is what it says to whoever does not see it."""
    content = io.StringIO()
    figure.savefig(content, format="svg", metadata={"Date": None})
    text = content.getvalue()
    drawn = text[text.index("<svg") :].replace(INK, "currentColor")
    return f'<span role="img" aria-label="{html.escape(title)}">{drawn}</span>'


def plain_decades(axis: Axis, steps: tuple[float, ...]) -> None:
    """Labels a logarithmic axis by plain numbers at these steps of each decade: 200, 500, 1000."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator

    axis.set_major_locator(LogLocator(subs=steps))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator())
    axis.set_minor_formatter(NullFormatter())
