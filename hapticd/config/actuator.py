"""The actuator as a lag between the force of its command and the force that it exerts.

    order 1:  F' = a (u - F)                       order 2:  F'' = a^2 (u - F) - 2 zeta a F'

u is held from one command to the next. The bandwidth is where a sine of force has fallen to 1/sqrt(2), by 3 dB.
"""

from __future__ import annotations

import math
from typing import Final, Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field

from hapticd.base.model import Model

LEAST_HZ: Final = 10.0
MOST_HZ: Final = 5000.0


class Actuator(Model):
    """How fast the actuator follows; without it, at once."""

    bandwidth_hz: float = Field(ge=LEAST_HZ, le=MOST_HZ, description="Where a sine of force has fallen by 3 dB.")
    order: Literal[1, 2] = Field(
        default=1, description="Order of its lag: 1 is one time constant, 2 a resonance or two time constants."
    )
    damping_ratio: float = Field(
        default=math.sqrt(0.5), ge=0.1, le=2, description="Order 2: damping over that which just does not overshoot."
    )

    @property
    def rate_per_s(self) -> float:
        """a of the equations: of order 1 the inverse of the time constant, of order 2 the natural angular frequency."""
        angular = 2 * math.pi * self.bandwidth_hz
        if self.order == 1:
            return angular
        # |A|^2 = 1/2: with r = (w/a)^2, r^2 + (4 zeta^2 - 2) r - 1 = 0, in the form that does not cancel.
        half = 2 * self.damping_ratio**2 - 1
        root = math.hypot(half, 1)
        ratio = root - half if half < 0 else 1 / (root + half)
        return angular / math.sqrt(ratio)

    def response(self, s: npt.NDArray[np.complex128]) -> npt.NDArray[np.complex128]:
        """Force exerted over force commanded, at these complex frequencies in 1/s, of the same shape."""
        x = np.asarray(s, np.complex128) / self.rate_per_s
        lag = 1 + x if self.order == 1 else 1 + (2 * self.damping_ratio + x) * x
        return np.asarray(1 / lag, np.complex128)

    def at(self, s: complex) -> complex:
        """As `response`, of one frequency."""
        return complex(self.response(np.array([s], np.complex128))[0])

    def shares(self) -> tuple[float, float, float]:
        """What stability needs of the force h(t) after an impulse: the integrals of |h|, of t |h| and of t h, in s.

        A force is the one that was commanded, spread over later times with the weights h; they sum up to 1.
        """
        if self.order == 1:
            return 1.0, 1.0 / self.rate_per_s, 1.0 / self.rate_per_s
        # In units of 1/a; slower than the slower root by 40 time constants nothing is left.
        zeta = self.damping_ratio
        slow = zeta if zeta <= 1.0 else zeta - math.sqrt(zeta * zeta - 1.0)
        step = 40.0 / slow / 100_000
        t = step * (np.arange(100_000) + 0.5)
        root = np.emath.sqrt(zeta * zeta - 1.0)
        away = np.exp(-zeta * t)
        h = np.real(away * t if abs(root) < 1e-6 else away * np.sinh(root * t) / root)
        gain, late = step * float(np.abs(h).sum()), step * float((t * np.abs(h)).sum())
        return gain, late / self.rate_per_s, 2.0 * zeta / self.rate_per_s
