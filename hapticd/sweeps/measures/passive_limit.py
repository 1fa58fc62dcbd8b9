"""The stiffness up to which a virtual wall is passive, by Colgate and Schenkel (1997), in closed form."""

from __future__ import annotations

from pydantic import Field

from hapticd.base.errors import HapticdError
from hapticd.base.model import Model, Name
from hapticd.rendering.device_output import UNKNOWN_HANDLE, loop_of
from hapticd.sweeps.columns import Column, Row
from hapticd.sweeps.point import Point


class PassiveLimitOptions(Model):
    """Options of the measure `passive_limit`."""

    material: Name = Field(description="Material of the wall; its damping lowers the limit.")


class PassiveLimit:
    """The stiffness K = (b - |D|) / (T/2 + t_d) in N/m.

    b is the damping of the handle, D that of the wall, T the servo's period and t_d the age of the positions. A wall
    with a lower stiffness does not oscillate in any passive hand if positions are exact (Colgate and Schenkel, J.
    Robotic Systems 14, 1997). The limit is 0 if |D| is at least b. If position reports, ticks and force frames have
    different rates, the time called reach (docs/stability.md) replaces T/2 + t_d.
    """

    columns = (
        Column("passive_limit_n_per_m", "number", "measured", "N/m", "Stiffness up to which a wall is passive."),
    )
    needs_run = False

    def __init__(self, options: PassiveLimitOptions) -> None:
        self._material = options.material

    def of(self, point: Point) -> Row:
        """Return the passive limit for the simulated joystick or for `device.handle`.

        Raises HapticdError if the material is unknown, or the joystick has no known handle.
        """
        config = point.config
        material, loop = config.materials.get(self._material), loop_of(config, config.servo.rate_hz)
        if material is None:
            raise HapticdError(f"passive_limit: unknown material {self._material}")
        if loop is None:
            raise HapticdError(UNKNOWN_HANDLE)
        left = loop.dynamics.handle_damping_n_s_per_m - abs(material.damping_n_s_per_m)
        return {"passive_limit_n_per_m": max(0.0, left) / loop.timing.reach_s}
