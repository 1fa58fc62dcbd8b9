"""The margin of a scene to instability (docs/stability.md)."""

from __future__ import annotations

from hapticd.base.errors import HapticdError
from hapticd.rendering.scene_stability import sets_of
from hapticd.sweeps.columns import Column, Row
from hapticd.sweeps.point import Point


class StabilityFactor:
    """The largest factor by which all stiffnesses can grow while stability in every hand is still proved.

    Below 1 the scene is not proved stable. The value is None if the scene has no surfaces.
    """

    columns = (
        Column(
            "stability_factor",
            "number",
            "measured",
            "",
            "Factor by which stiffnesses may grow with stability in any passive hand.",
        ),
    )
    needs_run = False

    def of(self, point: Point) -> Row:
        """Return the factor for the simulated joystick or `device.handle`; raise HapticdError for an unknown handle."""
        sets = sets_of(point.config)
        if sets is None:
            raise HapticdError("stability_factor: a real joystick needs device.handle")
        return {"stability_factor": float(sets.factor.min()) if len(sets) else None}
