"""The picture of a calibration: the response as measured and as fitted, magnitude above phase."""

from __future__ import annotations

import io
import os
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hapticd.analysis.calibration.fit import Fit, Point
from hapticd.base.errors import HapticdError


@dataclass(frozen=True, slots=True)
class Curve:
    """One drive: free or held."""

    name: str
    fit: Fit
    accelerometer: tuple[Point, ...] = ()


def require(path: str) -> None:
    """Raises HapticdError (one line) where a picture cannot be drawn, or not one with that ending."""
    try:
        import matplotlib  # noqa: F401
        from matplotlib.backend_bases import FigureCanvasBase
    except ImportError:
        raise HapticdError("a plot needs matplotlib: pip install 'hapticd[fit]'") from None
    known = sorted(FigureCanvasBase.get_supported_filetypes())
    ending = os.path.splitext(path)[1].lower().lstrip(".")
    if ending and ending not in known:
        raise HapticdError(f"{path}: cannot be drawn: must end in .png or another of {', '.join(known)}")


def drawn(path: str | os.PathLike[str], curves: Sequence[Curve]) -> bytes:
    """The picture of the curves, of the kind that the ending of `path` says; without one, a PNG."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (above, below) = plt.subplots(2, 1, figsize=(8, 7), sharex=True, constrained_layout=True)
    highest = max(point.frequency_hz for curve in curves for point in (*curve.fit.points, *curve.accelerometer))
    lowest = min(point.frequency_hz for curve in curves for point in curve.fit.points)
    fine = np.geomspace(lowest, highest, 500)
    for color, curve in zip(("C0", "C1"), curves, strict=False):
        response = curve.fit.response(fine)
        above.loglog(fine, np.abs(response), lw=1, color=color, label=f"{curve.name}, fit")
        below.semilogx(fine, np.degrees(np.angle(response)), lw=1, color=color)
        for points, marker, by in ((curve.fit.points, "o", "encoder"), (curve.accelerometer, "x", "accelerometer")):
            if points:
                frequency = np.array([point.frequency_hz for point in points])
                measured = curve.fit.response(frequency) * np.array([point.ratio for point in points])
                above.loglog(frequency, np.abs(measured), marker, ms=4, color=color, label=f"{curve.name}, {by}")
                below.semilogx(frequency, np.degrees(np.angle(measured)), marker, ms=4, color=color)
    above.set_ylabel("position over force, m/N")
    above.legend(fontsize=8)
    below.set_ylabel("phase, degrees")
    below.set_xlabel("Hz")
    try:
        content = io.BytesIO()
        figure.savefig(content, dpi=120, format=os.path.splitext(path)[1].lower().lstrip(".") or "png")
        return content.getvalue()
    except (OSError, ValueError) as error:
        raise HapticdError(f"{os.fspath(path)}: cannot be drawn: {error}") from None
    finally:
        plt.close(figure)
