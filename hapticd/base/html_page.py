"""An HTML page in a single file, and its tables, for a light and a dark screen."""

from __future__ import annotations

import html
from collections.abc import Sequence
from typing import Final

_PAGE_STYLE: Final = (
    ":root{color-scheme:light dark}"
    "body{font:15px/1.5 sans-serif;max-width:84em;margin:2em auto;padding:0 1em}"
    "table{border-collapse:collapse;margin:.4em 0}caption{text-align:left;font-weight:bold;padding:.3em 0}"
    "td,th{padding:.15em .7em;border-bottom:1px solid #8888;text-align:right;vertical-align:bottom}"
    "td,caption{white-space:nowrap}td.text,th.text{text-align:left}div.wide{overflow-x:auto}"
    "svg,img{max-width:100%;height:auto}.note{opacity:.75;margin:0 0 1em}.warning{color:light-dark(#a40,#fa6)}"
    "span.prose{display:block;white-space:normal;min-width:18em;max-width:48em}"
    "code{font-size:12px}pre{overflow-x:auto;border:1px solid #8888;padding:.6em .8em;line-height:1.35}"
    "figure{margin:1.5em 0;overflow-x:auto}figure svg{min-width:38em}"
    # No gaps between the cells of a heat map at any zoom.
    "[id^=QuadMesh] *{vector-effect:non-scaling-stroke}"
)


def page(title: str, body: str) -> str:
    """Return an HTML page; `title` is also its heading, `body` is HTML."""
    return f"""<!DOCTYPE html>
<html lang="en">
<head><meta charset="utf-8"><title>{html.escape(title)}</title><style>{_PAGE_STYLE}</style></head>
<body>
<h1>{html.escape(title)}</h1>
{body}
</body>
</html>
"""


def table(columns: Sequence[str], rows: Sequence[Sequence[str]], of_text: Sequence[bool], caption: str = "") -> str:
    """Return an HTML table of texts, which scrolls sideways in a narrow window.

    `of_text` says for each column whether it holds text, aligned left, or numbers.
    """
    return table_of_html(columns, [[html.escape(text) for text in row] for row in rows], of_text, caption)


def table_of_html(
    columns: Sequence[str], rows: Sequence[Sequence[str]], of_text: Sequence[bool], caption: str = ""
) -> str:
    """Return an HTML table whose cells are HTML; the arguments are those of `table`."""
    classes = [' class="text"' if is_text else "" for is_text in of_text]
    body = "\n".join(_row("td", row, classes) for row in rows)
    heads = _row("th", [html.escape(column) for column in columns], classes)
    head = f"<caption>{html.escape(caption)}</caption>\n" if caption else ""
    return f'<div class="wide"><table>\n{head}{heads}\n{body}</table></div>'


def _row(tag: str, cells: Sequence[str], classes: Sequence[str]) -> str:
    paired = zip(cells, classes, strict=True)
    return "<tr>" + "".join(f"<{tag}{each}>{cell}</{tag}>" for cell, each in paired) + "</tr>"
