"""The simulated joystick and its operator as C objects, from a validated configuration, and targets of gestures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Literal, assert_never

import numpy as np
import numpy.typing as npt

from hapticd.base.core import CData, Interpolation, Status, ffi, invalid_reason, lib, pointer
from hapticd.base.errors import HapticdError
from hapticd.config.configuration import Config, Sim
from hapticd.config.materials import Material
from hapticd.config.operator import Grip, Operator, Target
from hapticd.config.scene import SURFACE_MODELS, Box, Disc, Membrane, SceneObject, Wall


def new_sim(sim: Sim, rate_hz: float) -> CData:
    """Return a simulated joystick at rest, a `struct hd_sim *`; freed when unused.

    Raises HapticdError if the parameters contradict each other.
    """
    made = lib.hd_sim_new(_sim_config(sim), 1.0 / rate_hz)
    if made == ffi.NULL:
        raise HapticdError(f"device.sim: {invalid_reason()}")
    return ffi.gc(made, lib.hd_sim_free)


def set_rate(joystick: CData, sim: Sim, rate_hz: float) -> None:
    """Continue a simulated joystick at another rate. Raises HapticdError if it cannot be simulated at this rate."""
    if lib.hd_sim_set_period(joystick, _sim_config(sim), 1.0 / rate_hz) != Status.OK:
        raise HapticdError(f"device.sim: {invalid_reason()}")


def _sim_config(sim: Sim) -> CData:
    config = ffi.new("struct hd_sim_config *")
    hand = sim.hand
    for name in (
        "handle_mass_kg",
        "handle_damping_n_s_per_m",
        "coulomb_friction_n",
        "encoder_step_m",
        "max_force_n",
        "force_step_n",
        "workspace_m",
        "force_timeout_s",
    ):
        setattr(config, name, getattr(sim, name))
    config.report_interval_s, config.report_delay_s = sim.reports_s
    if sim.link is not None:
        config.force_interval_s = 1.0 / sim.link.rate_hz
        config.force_intervals = sim.link.delay_frames
    config.hand_mass_kg = hand.mass_kg
    config.hand_stiffness_n_per_m = hand.stiffness_n_per_m
    config.hand_damping_n_s_per_m = hand.damping_n_s_per_m
    config.start_m = sim.start_m
    if sim.actuator is not None:
        config.actuator_order = sim.actuator.order
        config.actuator_rate_per_s = sim.actuator.rate_per_s
        config.actuator_damping_ratio = sim.actuator.damping_ratio
    return config


def new_operator(waypoints: Sequence[Sequence[float]], interpolation: Literal["linear", "minimum_jerk"]) -> CData:
    """Return the path of the hand, a `struct hd_operator *`, through waypoints [t_s, x_m, y_m]; freed when unused.

    Raises HapticdError for waypoints that are not finite or not in order.
    """
    points = np.ascontiguousarray(waypoints, dtype=np.float64)
    kind = Interpolation.LINEAR if interpolation == "linear" else Interpolation.MINIMUM_JERK
    made = lib.hd_operator_new(pointer("double[]", points), len(points), kind)
    if made == ffi.NULL:
        raise HapticdError(f"waypoints: {invalid_reason()}")
    return ffi.gc(made, lib.hd_operator_free)


def grip_of(sim: Sim) -> Grip:
    """Return the grip for gestures: the simulated hand, with the mass that it moves."""
    return Grip(
        stiffness_n_per_m=sim.hand.stiffness_n_per_m,
        damping_n_s_per_m=sim.hand.damping_n_s_per_m + sim.handle_damping_n_s_per_m,
        moving_mass_kg=sim.handle_mass_kg + sim.hand.mass_kg,
    )


def waypoints_of(operator: Operator, config: Config) -> npt.NDArray[np.float64]:
    """Return the path of the simulated hand from its start, rows [t_s, x_m, y_m], shape (n, 3).

    Raises InvalidError for a gesture that does not fit the scene.
    """
    objects = config.scene.objects
    return operator.waypoints_for(
        lambda id: target_of(objects.get(id), config.materials),
        grip_of(config.device.sim),
        config.device.sim.start_m,
        objects,
    )


def target_of(item: SceneObject | None, materials: Mapping[str, Material]) -> Target | None:
    """Return the target of gestures on an object; None for an object that cannot be touched.

    The target of a box is its upper face (as at angle 0), that of a disc the tangent at its top, infinitely long.
    """
    if not isinstance(item, SURFACE_MODELS):
        return None
    material = materials[item.material]
    rupture = material.rupture if isinstance(item, Membrane) else None
    half, height, face = math.inf, 0.0, "surface"
    if isinstance(item, Wall):
        point, normal = item.point_m, item.normal
    elif isinstance(item, Membrane):
        point, normal = item.center_m, item.normal
        half, face = item.width_m / 2.0, "membrane"
    elif isinstance(item, Box):
        point, normal = item.center_m, (-math.sin(item.angle_rad), math.cos(item.angle_rad))
        half, height, face = item.size_m[0] / 2.0, item.size_m[1] / 2.0, "face"
    elif isinstance(item, Disc):
        point, normal = item.center_m, (0.0, 1.0)
        height = item.radius_m
    else:
        assert_never(item)
    return Target(
        point_m=(point[0] + height * normal[0], point[1] + height * normal[1]),
        normal=normal,
        stiffness_n_per_m=material.stiffness_n_per_m,
        rupture_depth_m=None if rupture is None else rupture.rupture_depth_m,
        half_m=half,
        face=face,
    )
