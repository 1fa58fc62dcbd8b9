"""The HTML page of a batch: the ranking of materials, a comparison of fitted quantities, and the plots of each fit."""

from __future__ import annotations

import html
import math
import os
import urllib.parse
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from typing import Any, Final

import numpy as np

from hapticd.analysis.statistics import Estimate, Floats
from hapticd.base import html_page, wording
from hapticd.base.files import check_regular, write_atomically
from hapticd.config.schema import unit_of
from hapticd.fit.recording import Kind
from hapticd.fit.report import Curve, Panel, fit_page, html_figures, html_picture, html_warnings
from hapticd.sweeps.batches.batch import Quality
from hapticd.sweeps.batches.ranking import FitResult, MaterialResult, counts
from hapticd.sweeps.worker_check import code_version

COMPARED_FIGURES: Final[Mapping[Kind, tuple[str, ...]]] = {
    "tap": ("frequency_hz", "decay_time_s", "first_peak_slope_per_s"),
    "grooves": ("spacing_m", "frequency_hz", "velocity_gain_per_s"),
    "texture": ("peak_hz", "mean_hz", "velocity_gain_per_s"),
    "puncture": ("stiffness_n_per_m", "force_n", "frequency_hz"),
}
"""For each kind of fit, the estimated quantities that a plot compares between all materials."""
QUALITY_COLORS: Final[Mapping[Quality, str]] = {"good": "C2", "fair": "C1", "poor": "C3", "refused": "C7"}
"""matplotlib's color for each verdict."""
MAX_INTERVAL_RATIO: Final = 1.5
"""Confidence intervals in a plot are cut at 1.5 times the largest estimate in the plot."""


def write_page(
    title: str,
    results: Sequence[MaterialResult],
    files: Mapping[str, str],
    folder: Path,
    drawn: bool,
    note: Callable[[str], None],
) -> None:
    """Write the page of a batch into `folder` as report.html.

    Args:
        title: Title of the page.
        results: The materials in order of rank.
        files: Path of the YAML file of each material.
        folder: The result folder.
        drawn: Whether to draw plots.
        note: Is called with a line of text when drawing begins.

    An existing page with the same content is kept, since drawing it again would take long. Raises HapticdError if the
    page cannot be written.
    """
    path = folder / "report.html"
    check_regular(path)
    content = repr([title, results, files, drawn, COMPARED_FIGURES]) + code_version()
    mark = f"<!-- {sha256(content.encode(errors='backslashreplace')).hexdigest()} -->\n"
    with suppress(OSError), path.open("rb") as file:  # a missing or shorter file raises, and the page is written
        file.seek(-len(mark), os.SEEK_END)
        if file.read() == mark.encode():
            return
    count = sum(bool(fit.panels) for each in results for fit in each.fits)
    if drawn and count:
        note(f"drawing {wording.count(count, 'fit')} into {path}")
    write_atomically(str(path), page(title, results, files, folder, drawn) + mark, overwrite=True)


def page(title: str, results: Sequence[MaterialResult], files: Mapping[str, str], folder: Path, drawn: bool) -> str:
    """Return the page of a batch as HTML; links are relative to `folder`."""
    rows = [
        (
            str(rank),
            f'<a href="#{_anchor(rank)}">{html.escape(each.name)}</a>',
            each.quality,
            ", ".join(fit.kind for fit in each.fits),
            str(sum(len(fit.recordings.files) for fit in each.fits)),
            f'<span class="prose">{html.escape(each.shown_reasons)}</span>',
        )
        for rank, each in enumerate(results, 1)
    ]
    overview = "\n".join(html_picture(row) for row in _compared(results)) if drawn else ""
    sections = "\n".join(_section(rank, each, files, folder, drawn) for rank, each in enumerate(results, 1))
    heads = ("rank", "material", "verdict", "fits", "recordings", "reasons")
    ranking = html_page.table_of_html(heads, rows, (False, True, True, True, False, True))
    return fit_page(
        title,
        f"""<p><b>{summary(results)}</b></p>
{ranking}
{overview}
{sections}""",
    )


def summary(results: Sequence[MaterialResult]) -> str:
    """Return the number of materials with each verdict as text."""
    parts = ", ".join(f"{count} {quality}" for quality, count in counts(results).items() if count)
    return f"{wording.count(len(results), 'material')}: {parts}"


def _anchor(rank: int) -> str:
    return f"material-{rank}"


def _section(rank: int, result: MaterialResult, files: Mapping[str, str], folder: Path, drawn: bool) -> str:
    """Return the section of a material; it is collapsed if the verdict is good."""
    file = files.get(result.name)
    link = ""
    if file is not None:
        there = os.path.relpath(file, folder)
        link = f'<p><a href="{urllib.parse.quote(there)}">{html.escape(there)}</a></p>'
    fits = "\n".join(_fit(fit, drawn) for fit in result.fits)
    return f"""<details{"" if result.quality == "good" else " open"}>
<summary><b>{rank}. {html.escape(result.name)}</b>: {result.quality}</summary>
<div id="{_anchor(rank)}">
{fits}
{html_warnings(result.notes)}
{link}
</div>
</details>"""


def _fit(fit: FitResult, drawn: bool) -> str:
    panels = [Panel(**{**each, "curves": tuple(map(_curve, each["curves"]))}) for each in fit.panels]
    picture = html_picture(panels) if drawn and panels else ""
    figures = "" if fit.estimates is None else html_figures(fit.estimates, fit.plain or {})
    return f"""<h3>{fit.kind}</h3>
<p><b>{html.escape(fit.verdict)}</b></p>
{html_warnings(fit.warnings)}
{picture}
{figures}"""


def _curve(data: Mapping[str, Any]) -> Curve:
    fields: dict[str, Any] = {key: _array(value) if isinstance(value, list) else value for key, value in data.items()}
    return Curve(**fields)


def _array(values: Sequence[float | None]) -> Floats:
    return np.array([math.nan if value is None else value for value in values], dtype=np.float64)


def _compared(results: Sequence[MaterialResult]) -> Iterator[tuple[Panel, ...]]:
    """Yield a row of plots for each kind of fit: each plot shows an estimated quantity over the material's rank."""
    for kind, names in COMPARED_FIGURES.items():
        fits = [(rank, fit) for rank, each in enumerate(results, 1) for fit in each.fits if fit.kind == kind]
        panels = tuple(panel for name in names if (panel := _over_ranks(kind, name, fits)) is not None)
        if panels:
            yield panels


def _over_ranks(kind: Kind, name: str, fits: Sequence[tuple[int, FitResult]]) -> Panel | None:
    found = [
        (rank, fit.quality, each)
        for rank, fit in fits
        if (each := (fit.estimates or {}).get(name)) is not None and math.isfinite(each.value)
    ]
    if len(found) < 2:
        return None
    limit = MAX_INTERVAL_RATIO * max(abs(each.value) for _, _, each in found)
    by_quality = {
        quality: [(rank, each) for rank, other, each in found if other == quality] for quality in QUALITY_COLORS
    }
    curves = tuple(_dots(quality, dots, limit) for quality, dots in by_quality.items() if dots)
    return Panel(f"{kind}: {name}", "rank", unit_of(name) or "", curves, counted=True)


def _dots(quality: Quality, found: Sequence[tuple[int, Estimate]], limit: float) -> Curve:
    ranks = np.array([rank for rank, _ in found], dtype=np.float64)
    values, low, high = (
        np.array([getattr(each, name) for _, each in found], dtype=np.float64) for name in ("value", "low", "high")
    )
    low = np.clip(np.nan_to_num(low, nan=-limit), -limit, limit)
    high = np.clip(np.nan_to_num(high, nan=limit), -limit, limit)
    return Curve(quality, ranks, values, points=True, color=QUALITY_COLORS[quality], low=low, high=high)
