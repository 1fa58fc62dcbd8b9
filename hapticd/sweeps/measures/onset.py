"""The error of the reported time of a touch."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt

from hapticd.base.core import EventKind, lib
from hapticd.base.errors import HapticdError
from hapticd.config.scene import SURFACE_MODELS, Box, Disc, SceneObject, Wall
from hapticd.sweeps.columns import Column, Row
from hapticd.sweeps.point import Point

Floats: TypeAlias = npt.NDArray[np.float64]
Trajectory: TypeAlias = Callable[[Floats], Floats]
"""A function of times in s, (n,), that returns positions in m, (n, 2)."""
_CROSSING_BISECTIONS: Final = 60
"""Number of bisections of a period; the time of a crossing is then exact to the last bit of a float."""


class OnsetError:
    """The time of a touch as reported by its event, minus the time at which the probe crosses the surface.

    In the open loop the probe moves along the path of the hand. In the closed loop its true motion between two ticks is
    the cubic with the true positions and velocities at both. A touch is compared with the crossing of the same object
    that is nearest in time.
    """

    columns = (
        Column(
            "onset_error_s",
            "number",
            "measured",
            "s",
            "Reported time of a touch minus true time, of the touch with the largest error; above 0 is late.",
        ),
        Column("onsets", "integer", "measured", "", "Number of touches that were reported."),
    )
    needs_run = True

    def of(self, point: Point) -> Row:
        """Return the error of largest magnitude of the run's touches (None without a touch), and their number.

        Raises HapticdError if an object was touched although the probe never crosses its surface.
        """
        run, objects = point.run, point.config.scene.objects
        touched = run.events[run.events["kind"] == EventKind.CONTACT]
        reported = touched[(touched["code"] & lib.HD_CONTACT_SILENT) == 0]
        time_s = np.arange(len(run.samples)) / run.rate_hz
        trajectory: Trajectory = point.hand_at if run.truth is None else _cubic(run.truth, run.rate_hz)
        positions = trajectory(time_s) if run.truth is None else run.truth[:, :2]
        crossings: dict[str, Floats] = {}
        errors = []
        for event in reported:
            name = run.objects[int(event["slot"]), int(event["generation"])]
            if name not in crossings:
                crossings[name] = _crossings(objects[name], time_s, positions, trajectory)
            if not len(crossings[name]):
                raise HapticdError(f"onset_error: a touch of {name} is reported, but its surface is never crossed")
            late_s = float(event["tick"]) / run.rate_hz - float(event["before_tick_s"]) - crossings[name]
            errors.append(float(late_s[np.argmin(np.abs(late_s))]))
        return {"onset_error_s": max(errors, key=abs, default=None), "onsets": len(errors)}


def _crossings(item: SceneObject, time_s: Floats, positions: Floats, trajectory: Trajectory) -> Floats:
    """Return the times in s at which the probe enters an object, being outside at one tick and inside at the next."""
    height = _height_of(item, positions)
    into = np.flatnonzero((height[:-1] > 0.0) & (height[1:] <= 0.0))
    low, high = time_s[into], time_s[into + 1]
    for _ in range(_CROSSING_BISECTIONS):
        middle = 0.5 * (low + high)
        above = _height_of(item, trajectory(middle)) > 0.0
        low, high = np.where(above, middle, low), np.where(above, high, middle)
    return high


def _height_of(item: SceneObject, position: Floats) -> Floats:
    """Return the heights of positions above the surface of an object in m, (n,); inside they are negative.

    For a box, the height is the larger of the heights along its two axes.
    """
    if not isinstance(item, SURFACE_MODELS):
        raise HapticdError(f"onset_error: a {item.kind} has no surface")
    if isinstance(item, Wall):
        return np.asarray((position - item.point_m) @ np.array(item.normal))
    away = position - np.array(item.center_m)
    if isinstance(item, Disc):
        return np.asarray(np.hypot(*away.T) - item.radius_m)
    if isinstance(item, Box):
        turn = np.array(
            [
                [math.cos(item.angle_rad), -math.sin(item.angle_rad)],
                [math.sin(item.angle_rad), math.cos(item.angle_rad)],
            ]
        )
        return np.asarray((np.abs(away @ turn) - 0.5 * np.array(item.size_m)).max(axis=1))
    raise HapticdError("onset_error needs walls, discs or boxes: a membrane can be touched from both sides")


def _cubic(truth: Floats, rate_hz: float) -> Trajectory:
    """Return the trajectory that interpolates `truth` (positions and velocities at n ticks, (n, 4)) by cubics."""

    def at(time_s: Floats) -> Floats:
        index = np.clip((time_s * rate_hz).astype(np.int64), 0, len(truth) - 2)
        s = (time_s * rate_hz - index)[:, np.newaxis]
        (begin, end), period_s = (truth[index], truth[index + 1]), 1.0 / rate_hz
        h = s * s * (3.0 - 2.0 * s)
        found: Floats = (
            begin[:, :2]
            + (end - begin)[:, :2] * h
            + period_s * (begin[:, 2:] * s * (1.0 - s) ** 2 - end[:, 2:] * s * s * (1.0 - s))
        )
        return found

    return at
