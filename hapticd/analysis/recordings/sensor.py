"""A linear sensor: the response of its mounting and its filter to a decaying sinusoid, in closed form.

    H(s) = prod_j -q_j / (s - q_j)

with distinct poles q_j and a gain of 1 at 0 Hz. A decaying sinusoid Im exp(p t), p = -B + i w, that begins at t = 0
becomes

    Im y(t),  y(t) = H(p) exp(p t) + sum_j r_j / (q_j - p) exp(q_j t)

where r_j is the residue of H at q_j: the inverse Laplace transform of H(s)/(s - p), without discretization error.
"""

from __future__ import annotations

import cmath
import math
from typing import Annotated, TypeAlias

import numpy as np
import numpy.typing as npt
from pydantic import Field

from hapticd.base.model import Model

Complexes: TypeAlias = npt.NDArray[np.complex128]


class Sensor(Model):
    """An accelerometer's mounting and filter, from its data sheet."""

    filter_hz: Annotated[float, Field(ge=10, le=1e6)] | None = Field(
        default=None, description="Corner (-3 dB) of its Butterworth low-pass filter; unset: no filter."
    )
    filter_order: int = Field(default=2, ge=1, le=8, description="Order of the filter.")
    mounting_hz: Annotated[float, Field(ge=10, le=1e6)] | None = Field(
        default=None, description="Resonance of the sensor on its mounting; unset: rigid."
    )
    mounting_damping: float = Field(default=0.05, ge=0.001, le=0.999, description="Damping ratio of the resonance.")

    @property
    def poles(self) -> tuple[complex, ...]:
        """Poles of the transfer function, in rad/s; empty for an ideal sensor."""
        found: list[complex] = []
        if self.mounting_hz is not None:
            damping = self.mounting_damping
            pole = 2 * math.pi * self.mounting_hz * complex(-damping, math.sqrt(1 - damping**2))
            found += [pole, pole.conjugate()]
        if self.filter_hz is not None:
            turns = [1 + (2 * k + 1) / self.filter_order for k in range(self.filter_order)]
            found += [2 * math.pi * self.filter_hz * cmath.exp(0.5j * math.pi * turn) for turn in turns]
        return tuple(found)

    def response(self, pole: complex, since_s: npt.NDArray[np.float64]) -> tuple[Complexes, Complexes, Complexes]:
        """Return the response y to exp(p t), and dy/dp and dy/dt, (n,) each, for p = `pole` and t = `since_s` >= 0."""
        poles = np.array(self.poles, dtype=np.complex128)
        gain = complex(np.prod(-poles / (pole - poles)))
        turned = np.exp(pole * since_s)
        value = gain * turned
        by_pole = (since_s - np.sum(1 / (pole - poles))) * value
        by_time = pole * value
        for index, own in enumerate(poles):
            others = np.delete(poles, index)
            part = -own * np.prod(-others / (own - others)) / (own - pole) * np.exp(own * since_s)
            value = value + part
            by_pole = by_pole + part / (own - pole)
            by_time = by_time + own * part
        return value, by_pole, by_time
