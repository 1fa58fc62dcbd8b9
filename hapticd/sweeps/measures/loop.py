"""The error of the sampled loop relative to the continuous loop in closed form (docs/accuracy.md, The closed loop)."""

from __future__ import annotations

import numpy as np

from hapticd.base.errors import HapticdError
from hapticd.config.materials import Material
from hapticd.config.scene import Constant, Wall
from hapticd.sweeps.columns import Column, Row
from hapticd.sweeps.measures.continuous_wall import ContinuousWall, WallLoop
from hapticd.sweeps.point import Point


class LoopError:
    """Largest errors of force and penetration of a hand that presses on one wall.

    The causes are servo rate, zero-order hold, encoder, delay, force limit and actuator. The reference is a servo with
    infinite rate, exact positions and no delay.
    """

    columns = (
        Column("loop_force_error_n", "number", "measured", "N", "Largest error of the force of the wall at a tick."),
        Column("loop_penetration_error_m", "number", "measured", "m", "Largest error of the penetration at a tick."),
    )
    needs_run = True

    def of(self, point: Point) -> Row:
        """Return the largest errors at all ticks of the run. Raises HapticdError if there is no closed form."""
        if point.run_kind != "simulate":
            raise HapticdError("loop_error needs the closed loop: set run: simulate")
        wall, material, push = _the_wall(point)
        sim, run, operator = point.config.device.sim, point.run, point.operator
        assert run.truth is not None and operator is not None
        if sim.coulomb_friction_n:
            raise HapticdError("loop_error needs a handle without dry friction: set device.sim.coulomb_friction_n: 0")
        if np.any(run.samples["vibration_force_n"]):
            raise HapticdError("loop_error needs a wall that does not vibrate: set scene.display.vibration: false")
        normal, surface = np.array(wall.normal), np.array(wall.point_m)
        way = point.waypoints
        heights = (way[:, 1:] - surface) @ normal
        if heights[0] < 0.0:
            raise HapticdError("loop_error needs a hand that begins above the wall")
        loop = WallLoop(
            mass_kg=sim.handle_mass_kg + sim.hand.mass_kg,
            damping_n_s_per_m=sim.handle_damping_n_s_per_m,
            hand_stiffness_n_per_m=sim.hand.stiffness_n_per_m,
            hand_damping_n_s_per_m=sim.hand.damping_n_s_per_m,
            wall_stiffness_n_per_m=material.stiffness_n_per_m,
            wall_damping_n_s_per_m=material.damping_n_s_per_m,
            push_n=float(push @ normal),
        )
        time_s = np.arange(len(run.samples)) / run.rate_hz
        continuous = ContinuousWall(
            loop,
            np.column_stack((way[:, 0], heights)),
            operator.interpolation == "minimum_jerk",
            len(run.samples) / run.rate_hz,
            0.5 / run.rate_hz,
        )
        height, force = continuous.at(time_s)
        own = (run.truth[:, :2] - surface) @ normal
        commanded = (run.samples["force_n"] - push) @ normal
        depth_error = np.maximum(0.0, -own) - np.maximum(0.0, -height)
        return {
            "loop_force_error_n": float(np.abs(commanded - force).max()),
            "loop_penetration_error_m": float(np.abs(depth_error).max()),
        }


def _the_wall(point: Point) -> tuple[Wall, Material, np.ndarray[tuple[int], np.dtype[np.float64]]]:
    """Return the only wall of the scene, its material, and the sum of all constant forces in N."""
    config = point.config
    walls: list[Wall] = []
    push = np.zeros(2)
    for name, each in config.scene.objects.items():
        if isinstance(each, Constant):
            push += each.force_n
        elif isinstance(each, Wall) and not each.patches:
            walls.append(each)
        else:
            raise HapticdError(
                f"loop_error: the scene may have one wall without patches, and constant forces; {name} is neither"
            )
    if len(walls) != 1:
        raise HapticdError(f"loop_error: the scene must have one wall, has {len(walls)}")
    material = config.materials[walls[0].material]
    for key in ("friction", "texture"):
        if getattr(material, key) is not None:
            raise HapticdError(f"loop_error needs a wall without {key}: the material {walls[0].material} has {key}")
    return walls[0], material, push
