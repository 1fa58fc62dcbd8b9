"""Draws the workspace, a wall, the proxy, gestures and the signal path for docs/images: `python -m docs.figures`.

The curves of the gestures are computed by `hapticd.simulate`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("svg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import hapticd

IMAGES = Path(__file__).parent / "images"
INK, QUIET, SOLID, TEAL, ORANGE = "#263238", "#78909c", "#eceff1", "#00796b", "#d84315"
STYLE: Mapping[str, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "hapticd",
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans", "Arial", "Helvetica", "sans-serif"],
    "font.size": 11,
    "text.color": INK,
    "axes.edgecolor": QUIET,
    "axes.labelcolor": INK,
    "xtick.color": QUIET,
    "ytick.color": QUIET,
    "axes.spines.top": False,
    "axes.spines.right": False,
}
RATE_HZ = 10_000
"""Servo rate of the default configuration."""
Point = tuple[float, float]


def save(figure: Figure, name: str) -> None:
    figure.savefig(
        IMAGES / f"{name}.svg", metadata={"Date": None}, facecolor="white", bbox_inches="tight", pad_inches=0.15
    )
    plt.close(figure)


def arrow(axes: Axes, begin: Point, end: Point, colour: str, width: float = 2.0) -> None:
    axes.annotate(
        "", end, begin, arrowprops={"arrowstyle": "-|>", "color": colour, "lw": width, "shrinkA": 0, "shrinkB": 0}
    )


def bare(width: float, height: float, x: Point, y: Point) -> tuple[Figure, Axes]:
    """Return an empty drawing to scale, without axes; `x` and `y` are its ranges."""
    figure, axes = plt.subplots(figsize=(width, height))
    axes.set(xlim=x, ylim=y, aspect="equal")
    axes.axis("off")
    return figure, axes


def ground(axes: Axes, corners: Sequence[Point]) -> None:
    """Fill the inside of a solid."""
    axes.fill(*zip(*corners, strict=True), facecolor=SOLID, edgecolor="#cfd8dc", hatch="////", linewidth=0)


# ---- The drawings ----------------------------------------------------------------------------------------------------


def workspace() -> None:
    """Draw axes, units, a wall, the handle and a force."""
    figure, axes = plt.subplots(figsize=(7.2, 4.2))
    axes.set(
        xlim=(-0.065, 0.065),
        ylim=(-0.022, 0.047),
        aspect="equal",
        xlabel="x (m), to the right",
        ylabel="y (m), upwards",
    )
    axes.set_xticks([-0.06, -0.04, -0.02, 0, 0.02, 0.04, 0.06])
    axes.set_yticks([-0.02, 0, 0.02, 0.04])
    ground(axes, [(-0.065, 0), (0.065, 0), (0.065, -0.022), (-0.065, -0.022)])
    axes.axhline(0, color=INK, lw=2)
    axes.text(-0.062, -0.009, "a wall: solid below y = 0", bbox={"facecolor": "white", "edgecolor": "none", "pad": 2})
    axes.plot(0, 0, "+", color=INK, ms=12, mew=2)
    axes.text(0.002, -0.0075, "origin [0, 0]", bbox={"facecolor": "white", "edgecolor": "none", "pad": 2})
    axes.plot(0, 0.01, "o", color=TEAL, ms=12)
    axes.text(0.004, 0.0075, "handle at [0, 0.01]: 1 cm above the wall", color=TEAL)
    arrow(axes, (0, 0.012), (0, 0.032), ORANGE, 2.5)
    axes.text(0.003, 0.027, "force on the hand (N): positive y pushes upwards", color=ORANGE, va="center")
    save(figure, "workspace")


def wall() -> None:
    """Draw a wall's point, normal and sides, and the direction of the arc length."""
    figure, axes = bare(7.2, 3.7, (-4.3, 4.5), (-2.2, 2.4))
    along, normal = np.array([np.cos(0.3), np.sin(0.3)]), np.array([-np.sin(0.3), np.cos(0.3)])
    left, right = -4.2 * along, 4.4 * along
    ground(axes, [tuple(left), tuple(right), tuple(right - 1.4 * normal), tuple(left - 1.4 * normal)])
    axes.plot(*zip(left, right, strict=True), color=INK, lw=2.5)
    tip = 1.5 * normal
    arrow(axes, (0, 0), (tip[0], tip[1]), ORANGE, 2.5)
    axes.text(tip[0] + 0.2, tip[1] + 0.15, "normal: points out of the solid", color=ORANGE)
    axes.plot(0, 0, "o", color=TEAL, ms=10)
    axes.text(
        0.25,
        -0.42,
        "point_m: any point of the surface",
        color=TEAL,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 2},
    )
    end = 2.4 * along + 0.22 * normal
    start = 0.35 * along + 0.22 * normal
    arrow(axes, (start[0], start[1]), (end[0], end[1]), QUIET, 1.6)
    axes.text(
        *(1.1 * along + 0.42 * normal),
        "along it (m)",
        color=QUIET,
        rotation=np.degrees(0.3),
        rotation_mode="anchor",
    )
    axes.text(-3.6, 0.6, "free: no force")
    axes.text(-3.4, -1.75, "solid: pushes out", bbox={"facecolor": "white", "edgecolor": "none", "pad": 2})
    save(figure, "wall")


def proxy() -> None:
    """Draw the probe and the proxy, in the air and in a wall."""
    figure, axes = bare(7.2, 3.4, (-4.6, 4.6), (-2.0, 2.2))
    ground(axes, [(-4.5, 0), (4.5, 0), (4.5, -1.9), (-4.5, -1.9)])
    axes.plot([-4.5, 4.5], [0, 0], color=INK, lw=2.5)
    axes.plot(-2.7, 1.0, "o", color=TEAL, ms=13)
    axes.plot(-2.7, 1.0, "o", mfc="none", mec=ORANGE, ms=19, mew=2)
    axes.text(-2.7, 1.5, "in the air:\nprobe and proxy are one", ha="center", va="bottom")
    axes.plot(1.2, -1.1, "o", color=TEAL, ms=13)
    axes.plot(1.2, 0, "o", mfc="white", mec=ORANGE, ms=15, mew=2.5)
    arrow(axes, (1.2, 0.25), (1.2, 1.75), ORANGE, 2.5)
    axes.text(1.45, 1.2, "force = stiffness x depth", color=ORANGE)
    axes.text(1.45, 0.3, "proxy: stays on the surface", color=ORANGE)
    axes.text(
        1.55, -1.22, "probe: where the hand is", color=TEAL, bbox={"facecolor": "white", "edgecolor": "none", "pad": 2}
    )
    axes.annotate(
        "",
        (0.75, -1.1),
        (0.75, 0),
        arrowprops={"arrowstyle": "<->", "color": INK, "lw": 1.5, "shrinkA": 0, "shrinkB": 0},
    )
    axes.text(0.6, -0.65, "depth (m)", ha="right", bbox={"facecolor": "white", "edgecolor": "none", "pad": 2})
    save(figure, "proxy")


FLOOR = {"objects": {"floor": {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "wood"}}}
COMB = {"objects": {"floor": {**FLOOR["objects"]["floor"], "material": "comb_4800um_vibration"}}}
MEMBRANE = {"kind": "membrane", "center_m": [0, 0], "normal": [0, 1], "width_m": 0.04, "material": "cellophane"}
SKIN = {"objects": {"skin": MEMBRANE}}
TAP = {"kind": "tap", "object": "floor", "speed_m_per_s": 0.2}
STROKE = {"kind": "stroke", "object": "floor", "from_m": -0.02, "to_m": 0.02, "speed_m_per_s": 0.1, "press_n": 0.8}
PUNCTURE = {"kind": "puncture", "object": "skin", "speed_m_per_s": 0.05}
GESTURES: Mapping[str, tuple[Mapping[str, Any], Mapping[str, Any]]] = {
    "tap: down, and back": (FLOOR, TAP),
    "stroke: along a comb": (COMB, STROKE),
    "press: into a membrane until it breaks": (SKIN, PUNCTURE),
}


def gestures() -> None:
    """Draw position of the handle and force on the hand over time, for each gesture."""
    figure, grid = plt.subplots(2, 3, figsize=(10, 4.6), layout="constrained")
    for column, (title, (scene, gesture)) in enumerate(GESTURES.items()):
        path, force = grid[0, column], grid[1, column]
        start_m = [gesture.get("from_m", 0), 0.01]
        samples = hapticd.simulate({"device": {"sim": {"start_m": start_m}}, "scene": scene}, {"gesture": gesture})
        time_s = np.arange(len(samples)) / RATE_HZ
        position_mm, along = 1e3 * samples["position_m"], gesture["kind"] == "stroke"
        path.plot(time_s, position_mm[:, 0 if along else 1], color=TEAL, lw=1.8)
        if not along:
            path.axhline(0, color=INK, lw=1.2)
        path.set(title=title, ylabel="x of the handle (mm)" if along else "y of the handle (mm)")
        force.plot(time_s, samples["force_n"][:, 0 if along else 1], color=ORANGE, lw=0.9)
        force.set(xlabel="time (s)", ylabel="force along x (N)" if along else "force along y (N)")
    save(figure, "gestures")


def box(axes: Axes, centre: Point, text: str, colour: str = INK) -> None:
    """Draw a box 2 wide and 1 high with `text` in it."""
    x, y = centre
    axes.fill(
        [x - 1, x + 1, x + 1, x - 1], [y - 0.5, y - 0.5, y + 0.5, y + 0.5], facecolor=SOLID, edgecolor=colour, lw=1.6
    )
    axes.text(x, y, text, ha="center", va="center", fontsize=9.5, linespacing=1.3)


def signal_path() -> None:
    """Draw the way from the position of the hand to the force on it."""
    figure, axes = bare(10, 4.6, (-1.3, 12.9), (-4.0, 2.5))
    measured: Sequence[tuple[Point, str]] = (
        ((0, 1.5), "hand and\nhandle"),
        ((2.9, 1.5), "encoder\nin steps"),
        ((5.8, 1.5), "link\ndevice to host"),
        ((8.7, 1.5), "estimator\nvelocity"),
    )
    parts: Sequence[tuple[Point, str]] = (
        ((11.6, 1.5), "contact\nand fields"),
        ((11.6, 0), "texture\ngrooves, noise"),
        ((11.6, -1.5), "modes\ntaps, ruptures"),
    )
    ways: Sequence[tuple[Point, str]] = (
        ((0, -3.2), "actuator"),
        ((2.9, -3.2), "link\nhost to device"),
        ((5.8, -3.2), "limits\nof force"),
        ((8.7, -3.2), "sum (N)"),
    )
    axes.fill(
        [4.6, 12.85, 12.85, 7.5, 7.5, 4.6], [-4, -4, 2.3, 2.3, -2.4, -2.4], facecolor="white", edgecolor=QUIET, lw=1
    )
    axes.text(7.65, -2.25, "one tick", color=QUIET, va="bottom")
    for centre, text in measured:
        box(axes, centre, text, TEAL)
    for centre, text in (*parts, *ways):
        box(axes, centre, text, ORANGE)
    for x in (1, 3.9, 6.8, 9.7):
        arrow(axes, (x, 1.5), (x + 0.85, 1.5), TEAL)
    for x in (7.65, 4.75, 1.9):
        arrow(axes, (x + 0.05, -3.2), (x - 0.85, -3.2), ORANGE)
    for y in (1, -0.5):
        arrow(axes, (11.6, y), (11.6, y - 0.5), TEAL)
    for y in (1.2, 0, -1.5):
        axes.plot([10.6, 10.15], [y, y], color=ORANGE, lw=2)
    axes.plot([10.15, 10.15], [1.2, -3.2], color=ORANGE, lw=2)
    arrow(axes, (10.15, -3.2), (9.7, -3.2), ORANGE)
    arrow(axes, (0, -2.7), (0, 1), ORANGE)
    axes.text(0.2, -0.9, "force on the hand (N)", color=ORANGE)
    axes.text(1.9, 0.65, "position (m)", color=TEAL)
    save(figure, "signal-path")


def main() -> None:
    """Draw all figures."""
    with matplotlib.rc_context(STYLE):
        for draw in (workspace, wall, proxy, gestures, signal_path):
            draw()


if __name__ == "__main__":
    main()
