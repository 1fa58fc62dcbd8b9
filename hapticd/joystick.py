"""The simulated joystick and its operator as C objects, made from validated configuration."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from hapticd.config import Sim
from hapticd.core import CData, Interpolation, ffi, invalid_reason, lib, pointer
from hapticd.errors import HapticdError


def new_sim(sim: Sim, rate_hz: float) -> CData:
    """A `struct hd_sim *` at rest, freed with the last reference to it.

    Raises HapticdError where the figures do not fit together.
    """
    config = ffi.new("struct hd_sim_config *")
    hand = sim.hand
    for name in (
        "handle_mass_kg",
        "handle_damping_n_s_per_m",
        "coulomb_friction_n",
        "encoder_step_m",
        "max_force_n",
        "force_step_n",
        "report_interval_s",
        "report_delay_s",
        "workspace_m",
        "force_timeout_s",
    ):
        setattr(config, name, getattr(sim, name))
    config.hand_mass_kg = hand.mass_kg
    config.hand_stiffness_n_per_m = hand.stiffness_n_per_m
    config.hand_damping_n_s_per_m = hand.damping_n_s_per_m
    config.start_m = sim.start_m
    made = lib.hd_sim_new(config, 1.0 / rate_hz)
    if made == ffi.NULL:
        raise HapticdError(f"device.sim: {invalid_reason()}")
    return ffi.gc(made, lib.hd_sim_free)


def new_operator(
    waypoints: Sequence[Sequence[float]], interpolation: Literal["linear", "minimum_jerk"]
) -> CData:
    """A `struct hd_operator *` over waypoints [t_s, x_m, y_m], freed with the last reference to it.

    Raises HapticdError for waypoints that are not finite or not in order.
    """
    points = np.ascontiguousarray(waypoints, dtype=np.float64)
    kind = Interpolation.LINEAR if interpolation == "linear" else Interpolation.MINIMUM_JERK
    made = lib.hd_operator_new(pointer("double[]", points), len(points), kind)
    if made == ffi.NULL:
        raise HapticdError(f"waypoints: {invalid_reason()}")
    return ffi.gc(made, lib.hd_operator_free)
