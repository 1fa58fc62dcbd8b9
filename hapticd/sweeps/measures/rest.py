"""How the motion of the handle ends after the last waypoint of the hand, by the criteria of docs/stability.md."""

from __future__ import annotations

from pydantic import Field

from hapticd.base.errors import HapticdError
from hapticd.base.model import Model
from hapticd.rendering.end_state import end_of
from hapticd.sweeps.columns import Column, Row
from hapticd.sweeps.point import Point


class RestOptions(Model):
    """Options of the measure `end`."""

    longest_s: float = Field(
        default=40.0,
        ge=0.5,
        le=3600,
        description="Longest time that a motion is followed which is neither at rest nor in a regular cycle.",
    )


class Rest:
    """How the motion of the closed loop ends, without vibration (hapticd.rendering.end_state).

    The column `end` is `rests`, `cycles`, `grows`, or `falls` (the motion's energy still falls after `longest_s`).
    `rests` is true if `end` is `rests`; `decays` is true if `end` is `rests` or `falls`. Use `decays` to search for the
    boundary of stability: close to it, a motion takes long to come to rest.
    """

    columns = (
        Column("rests", "boolean", "measured", "", "Whether the handle comes to rest."),
        Column("decays", "boolean", "measured", "", "Whether it rests, or its energy still fell at the end."),
        Column("end", "text", "measured", "", "How the motion ends: rests, cycles, grows, falls."),
    )
    needs_run = True

    def __init__(self, options: RestOptions) -> None:
        self._longest_s = options.longest_s

    def of(self, point: Point) -> Row:
        """Return how the handle's motion ends after the last waypoint; the study's key `duration_s` is ignored."""
        if point.run_kind != "simulate":
            raise HapticdError("end needs the closed loop: set run: simulate")
        config, operator = point.config, point.operator
        assert operator is not None
        quiet = config.scene.display.model_copy(update={"vibration": False})
        silent = config.model_copy(update={"scene": config.scene.model_copy(update={"display": quiet})})
        found = end_of(silent, point.waypoints.tolist(), self._longest_s, operator.interpolation)
        return {"rests": found.fate == "rests", "decays": found.fate in ("rests", "falls"), "end": found.fate}
