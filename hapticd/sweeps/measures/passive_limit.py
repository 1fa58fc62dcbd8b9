"""The stiffness up to which a virtual wall is passive, by Colgate and Schenkel (1997), in closed form."""

from __future__ import annotations

from pydantic import Field

from hapticd.base.errors import HapticdError
from hapticd.base.model import Model, Name
from hapticd.rendering.device_output import UNKNOWN_HANDLE, loop_of
from hapticd.sweeps.columns import Column, Row
from hapticd.sweeps.point import Point


class PassiveLimitOptions(Model):
    """Of which wall."""

    material: Name = Field(description="The wall's material: its damping counts.")


class PassiveLimit:
    """K = (b - |D|) / (T/2 + t_d), N/m: handle damping b, the wall's damping D, period T and age t_d of the positions.

    No passive hand makes a wall oscillate whose stiffness is below (Colgate and Schenkel, J. Robotic Systems 14, 1997),
    with exact positions. 0: no stiffness is passive, because D takes all of b. Where reports, ticks and frames beat
    against each other, the reach of docs/stability.md stands in the place of T/2 + t_d.
    """

    columns = (
        Column("passive_limit_n_per_m", "number", "measured", "N/m", "Stiffness up to which a wall is passive."),
    )
    needs_run = False

    def __init__(self, options: PassiveLimitOptions) -> None:
        self._material = options.material

    def of(self, point: Point) -> Row:
        """With the simulated joystick or with `device.handle`. Raises HapticdError without a handle or material."""
        config = point.config
        material, loop = config.materials.get(self._material), loop_of(config, config.servo.rate_hz)
        if material is None:
            raise HapticdError(f"no material is called {self._material}")
        if loop is None:
            raise HapticdError(UNKNOWN_HANDLE)
        left = loop.dynamics.handle_damping_n_s_per_m - abs(material.damping_n_s_per_m)
        return {"passive_limit_n_per_m": max(0.0, left) / loop.timing.reach_s}
