"""Whether the handle comes to rest once the hand does, as docs/stability.md judges it."""

from __future__ import annotations

from pydantic import Field

from hapticd.base.errors import HapticdError
from hapticd.base.model import Model
from hapticd.rendering.end_state import end_of
from hapticd.sweeps.columns import Column, Row
from hapticd.sweeps.point import Point


class RestOptions(Model):
    """How long is waited."""

    longest_s: float = Field(
        default=40.0,
        ge=0.5,
        le=3600,
        description="A motion that is neither at rest nor in a regular cycle is followed for so long.",
    )


class Rest:
    """How the motion of the closed loop ends, without vibration: `end` is rests, cycles, grows, or falls (its energy
    still fell after `longest_s`). `rests` is true of the first alone; `decays`, of the last too, is what a boundary of
    stability is searched by, since close to it a motion takes long to rest (hapticd.rendering.end_state)."""

    columns = (
        Column("rests", "boolean", "measured", "", "Whether the handle comes to rest."),
        Column("decays", "boolean", "measured", "", "Whether it rests, or its energy still fell at the end."),
        Column("end", "text", "measured", "", "How the motion ends: rests, cycles, grows, falls."),
    )
    needs_run = True

    def __init__(self, options: RestOptions) -> None:
        self._longest_s = options.longest_s

    def of(self, point: Point) -> Row:
        """From the hand's last waypoint on, whatever the study's duration is."""
        if point.run_kind != "simulate":
            raise HapticdError("rest is judged of the closed loop: run: simulate")
        config, operator = point.config, point.operator
        assert operator is not None
        quiet = config.scene.display.model_copy(update={"vibration": False})
        silent = config.model_copy(update={"scene": config.scene.model_copy(update={"display": quiet})})
        found = end_of(silent, point.waypoints.tolist(), self._longest_s, operator.interpolation)
        return {"rests": found.fate == "rests", "decays": found.fate in ("rests", "falls"), "end": found.fate}
