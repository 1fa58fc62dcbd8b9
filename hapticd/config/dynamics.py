"""Linear model of the device: mass and damping of the handle, and the hand that holds it.

    (m + m_h) x'' + (b + b_h) x' + k (x - w) = F,

with handle (m, b), hand (m_h, b_h, k) and the position w to which the hand's spring pulls.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from pydantic import Field

from hapticd.base.model import Damping, Model, Stiffness


class Handle(Model):
    """The handle without a hand, as seen along one axis."""

    mass_kg: float = Field(ge=0.001, le=10, description="Moving mass.")
    damping_n_s_per_m: Damping = Field(default=0.0, description="Viscous friction.")
    friction_n: float = Field(default=0.0, ge=0, le=10, description="Dry friction.")


class Grip(Model):
    """The hand, as seen from the handle: a mass on it, held by spring and damper."""

    mass_kg: float = Field(default=0.0, ge=0, le=10, description="Mass that moves with the handle.")
    damping_n_s_per_m: Damping = Field(default=0.0, description="Damping.")
    stiffness_n_per_m: Stiffness = Field(default=0.0, description="Stiffness.")


@dataclass(frozen=True, slots=True)
class Dynamics:
    """Parameters of handle and hand, in SI units. Coulomb friction is not part of the linear model."""

    handle_mass_kg: float
    handle_damping_n_s_per_m: float
    friction_n: float
    grip_mass_kg: float
    grip_damping_n_s_per_m: float
    grip_stiffness_n_per_m: float

    @property
    def mass_kg(self) -> float:
        """Moving mass: that of the handle plus that of the hand, m + m_h."""
        return self.handle_mass_kg + self.grip_mass_kg

    @property
    def damping_n_s_per_m(self) -> float:
        """Total damping: that of the handle plus that of the hand, b + b_h."""
        return self.handle_damping_n_s_per_m + self.grip_damping_n_s_per_m


@lru_cache(maxsize=64)
def held_motion(dynamics: Dynamics, span_s: float) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return the arrays `state` and `pushed` that advance the held handle by `span_s` seconds at a constant force F.

    Position and velocity [x, v] become exactly state @ [x, v] + pushed F. state (2, 2) and pushed (2,), both read-only,
    are blocks of exp([[A, B], [0, 0]] span_s) for x' = A x + B F. The series is computed by scaling and squaring.
    """
    mass = dynamics.mass_kg
    a = np.zeros((3, 3))
    a[0, 1] = 1.0
    a[1] = -dynamics.grip_stiffness_n_per_m / mass, -dynamics.damping_n_s_per_m / mass, 1.0 / mass
    fastest = max(dynamics.damping_n_s_per_m / mass, math.sqrt(dynamics.grip_stiffness_n_per_m / mass)) * span_s
    halvings = max(0, math.ceil(math.log2(fastest / 0.25))) if fastest > 0.25 else 0
    step = a * (span_s / 2**halvings)
    # The series of exp(A) - 1, so that squaring does not lose small terms.
    term = grown = step.copy()
    for order in range(2, 20):
        term = term @ step / order
        grown = grown + term
    for _ in range(halvings):
        grown = 2.0 * grown + grown @ grown
    state, pushed = grown[:2, :2] + np.eye(2), grown[:2, 2]
    for shared in (state, pushed):
        shared.flags.writeable = False
    return state, pushed
