"""How far the objects of a scene are from instability: the margin of docs/stability.md, without a run."""

from __future__ import annotations

from hapticd.base.errors import HapticdError
from hapticd.rendering.scene_stability import sets_of
from hapticd.sweeps.columns import Column, Row
from hapticd.sweeps.measures.measure import NoOptions
from hapticd.sweeps.point import Point


class StabilityFactor:
    """The least factor by which all stiffnesses of a contact set may be multiplied while it stays safe: below 1 it is
    not proved to be stable in any hand. None: nothing can be touched."""

    columns = (
        Column(
            "stability_factor",
            "number",
            "measured",
            "",
            "Stiffnesses may be so many times as large in any passive hand.",
        ),
    )
    needs_run = False

    def __init__(self, _: NoOptions) -> None: ...

    def of(self, point: Point) -> Row:
        """Of the scene, with the simulated joystick or with `device.handle`."""
        sets = sets_of(point.config)
        if sets is None:
            raise HapticdError("stability is not known for a real joystick without device.handle")
        return {"stability_factor": float(sets.factor.min()) if len(sets) else None}
