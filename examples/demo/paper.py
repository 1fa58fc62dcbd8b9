"""Figures of the paper: Okamura, Dennerlein and Howe, "Vibration Feedback Models for Virtual Environments", ICRA 1998.

The paper prints them as numbers. It prints neither frequency nor decay time of a groove's vibration, no figures of
sandpaper, and neither stiffness nor depth of the cellophane.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from hapticd.config.materials import Mode


@dataclass(frozen=True, slots=True)
class PaperTap:
    """A row of Table 1."""

    slope_per_s: float
    """Amplitude over approach speed; eq. 1 has the amplitude as the coefficient of the decaying sine."""
    frequency_hz: float
    decay_time_s: float

    @property
    def mode(self) -> Mode:
        return Mode(1 / self.decay_time_s, 2 * math.pi * self.frequency_hz)


TAPS: Final = {
    "wood": PaperTap(309, 67, 6.48e-3),
    "acrylic": PaperTap(389, 128, 2.13e-3),
    "delrin": PaperTap(509, 93, 4.12e-3),
    "aluminum": PaperTap(681, 1471, 0.47e-3),
    "glass": PaperTap(750, 1721, 0.56e-3),
    "cast_iron": PaperTap(1334, 1668, 0.40e-3),
    "steel": PaperTap(1692, 1682, 0.32e-3),
}
PUNCTURE_AMPLITUDE_M_PER_S2: Final = 38.0
PUNCTURE_MODE: Final = Mode(decay_rate_per_s=330.0, angular_frequency_rad_per_s=1260.0)
"""Ringing of punctured cellophane, eq. 3."""
COMB_SPACING_M: Final = 0.002
COMB_VELOCITY_GAIN_PER_S: Final = 1200.0
COMB_FORCE_GAIN_M_PER_S2_PER_N: Final = 63.4
"""Gains of the comb that the paper measured, eq. 2. The comb of the demo has another spacing and lower gains."""
