"""The linear device as a force sees it: a handle's mass and damping, and the hand that holds it.

    (m + m_h) x'' + (b + b_h) x' + k (x - w) = F,

with handle (m, b), hand (m_h, b_h, k) and the wish w of the hand.
"""

from __future__ import annotations

from dataclasses import dataclass

from pydantic import Field

from hapticd.model import Damping, Model, Stiffness


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
    """Handle and hand together, SI units. Coulomb friction stands beside: it is not linear."""

    handle_mass_kg: float
    handle_damping_n_s_per_m: float
    friction_n: float
    grip_mass_kg: float
    grip_damping_n_s_per_m: float
    grip_stiffness_n_per_m: float

    @property
    def mass_kg(self) -> float:
        """What moves, m + m_h."""
        return self.handle_mass_kg + self.grip_mass_kg

    @property
    def damping_n_s_per_m(self) -> float:
        """What damps it, b + b_h."""
        return self.handle_damping_n_s_per_m + self.grip_damping_n_s_per_m
