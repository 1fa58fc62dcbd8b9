"""Model of the actuator: a lag between the commanded force u and the exerted force F.

    order 1:  F' = a (u - F)                       order 2:  F'' = a^2 (u - F) - 2 zeta a F'

u is held from one command to the next. The bandwidth is the frequency at which a sinusoidal force has fallen to
1/sqrt(2), by 3 dB.
"""

from __future__ import annotations

import math
from typing import Final, Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field

from hapticd.base.model import Model

MIN_BANDWIDTH_HZ: Final = 10.0
MAX_BANDWIDTH_HZ: Final = 5000.0
"""Limits of `bandwidth_hz`."""


class Actuator(Model):
    """Lag between the commanded and the exerted force; without this mapping the force follows at once."""

    bandwidth_hz: float = Field(
        ge=MIN_BANDWIDTH_HZ,
        le=MAX_BANDWIDTH_HZ,
        description="Frequency at which a sinusoidal force has fallen by 3 dB.",
    )
    order: Literal[1, 2] = Field(
        default=1, description="Order of the lag: 1 has one time constant, 2 a resonance or two time constants."
    )
    damping_ratio: float = Field(
        default=math.sqrt(0.5), ge=0.1, le=2, description="Order 2: damping ratio; 1 is critical damping."
    )

    @property
    def rate_per_s(self) -> float:
        """Rate a of the lag, in 1/s: the inverse time constant (order 1) or the natural angular frequency (order 2)."""
        angular = 2 * math.pi * self.bandwidth_hz
        if self.order == 1:
            return angular
        # |A|^2 = 1/2: with r = (w/a)^2, r^2 + (4 zeta^2 - 2) r - 1 = 0, in the form that does not cancel.
        half = 2 * self.damping_ratio**2 - 1
        root = math.hypot(half, 1)
        ratio = root - half if half < 0 else 1 / (root + half)
        return angular / math.sqrt(ratio)

    def response(self, s: npt.NDArray[np.complex128]) -> npt.NDArray[np.complex128]:
        """Return the transfer function F/u at complex frequencies `s` in 1/s, in the shape of `s`."""
        x = np.asarray(s, np.complex128) / self.rate_per_s
        lag = 1 + x if self.order == 1 else 1 + (2 * self.damping_ratio + x) * x
        return np.asarray(1 / lag, np.complex128)

    def at(self, s: complex) -> complex:
        """Return the transfer function F/u at one complex frequency in 1/s."""
        return complex(self.response(np.array([s], np.complex128))[0])

    def moments(self) -> tuple[float, float, float]:
        """Return the integrals of |h|, t |h| and t h over time, the last two in s; h(t) is the lag's impulse response.

        The stability analysis uses these moments. The integral of h is 1.
        """
        if self.order == 1:
            return 1.0, 1.0 / self.rate_per_s, 1.0 / self.rate_per_s
        # Time in units of 1/a, up to 40 time constants of the slower root.
        zeta = self.damping_ratio
        slow = zeta if zeta <= 1.0 else zeta - math.sqrt(zeta * zeta - 1.0)
        step = 40.0 / slow / 100_000
        t = step * (np.arange(100_000) + 0.5)
        root = np.emath.sqrt(zeta * zeta - 1.0)
        away = np.exp(-zeta * t)
        h = np.real(away * t if abs(root) < 1e-6 else away * np.sinh(root * t) / root)
        gain, late = step * float(np.abs(h).sum()), step * float((t * np.abs(h)).sum())
        return gain, late / self.rate_per_s, 2.0 * zeta / self.rate_per_s
