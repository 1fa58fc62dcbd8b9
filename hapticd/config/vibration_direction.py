"""Where the vibration of a surface acts: along its normal n, its tangent t = (n_y, -n_x), or at an angle between."""

import math
from typing import Final, Literal, TypeAlias

from pydantic import Field
from pydantic.config import JsonDict

from hapticd.config.modes import ModeKeys, given

Direction: TypeAlias = Literal["tangent", "normal"]

ONE_DIRECTION: Final[JsonDict] = {"not": given("direction", "angle_rad")}
"""JSON Schema of at most one of the two keys."""


class AimedKeys(ModeKeys):
    """A ringing mode, and where it pushes first."""

    direction: Direction | None = Field(
        default=None, description="Where it acts: across the surface (as without this key) or along it."
    )
    angle_rad: float | None = Field(
        default=None, ge=-10, le=10, description="Angle from the normal towards the tangent, instead of a direction."
    )

    def cross_faults(self) -> list[str]:
        faults = super().cross_faults()
        if self.direction is not None and self.angle_rad is not None:
            faults.append("needs at most one of direction and angle_rad, has both")
        return faults

    @property
    def aim(self) -> tuple[float, float]:
        """The unit vector in which its first half wave pushes, in parts along n and along t."""
        if self.angle_rad is not None:
            return math.cos(self.angle_rad), math.sin(self.angle_rad)
        return (0.0, 1.0) if self.direction == "tangent" else (1.0, 0.0)
