"""A tap's mode over the approach speed: frequency and decay time that a strike has from its onset on.

Between the points both lie on straight lines, beyond the outermost they stay. The tick does the same
(csrc/tick/hd_strike_mode.h).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated

from pydantic import Field, Strict

from hapticd.base.model import CheckedTogether
from hapticd.config.modes import DecayTime, Frequency, Mode
from hapticd.config.rising_points import MAX_POINTS, around, rising_faults


class ModeTable(CheckedTogether):
    """Frequency and decay time of a tap over the approach speed."""

    speeds_m_per_s: Annotated[tuple[Annotated[float, Field(ge=0, le=100)], ...], Strict(False)] = Field(
        min_length=1, max_length=MAX_POINTS, description="Approach speeds, rising."
    )
    frequencies_hz: Annotated[tuple[Frequency, ...], Strict(False)] = Field(
        min_length=1, max_length=MAX_POINTS, description="A frequency for each speed."
    )
    decay_times_s: Annotated[tuple[DecayTime, ...], Strict(False)] = Field(
        min_length=1, max_length=MAX_POINTS, description="A decay time for each speed."
    )

    def cross_faults(self) -> list[str]:
        faults = list(rising_faults("speeds_m_per_s", self.speeds_m_per_s))
        count = len(self.speeds_m_per_s)
        for key, what in (("frequencies_hz", "a frequency"), ("decay_times_s", "a decay time")):
            if len(getattr(self, key)) != count:
                faults.append(f"{key} must have {what} for each speed, {count}, has {len(getattr(self, key))}")
        return faults

    def at(self, speed_m_per_s: float) -> Mode:
        """The mode of a strike at this approach speed."""
        first, last, share = around(self.speeds_m_per_s, speed_m_per_s)

        def along(values: Sequence[float]) -> float:
            return values[first] + share * (values[last] - values[first])

        return Mode(1 / along(self.decay_times_s), 2 * math.pi * along(self.frequencies_hz))

    @property
    def modes(self) -> tuple[Mode, ...]:
        """Those at its points."""
        return tuple(self.at(speed) for speed in self.speeds_m_per_s)

    @property
    def bounds(self) -> tuple[Mode, ...]:
        """Those at its lowest and at its highest frequency; one where they are the same."""
        modes = sorted(self.modes, key=lambda mode: mode.angular_frequency_rad_per_s)
        return tuple(dict.fromkeys((modes[0], modes[-1])))

    @property
    def middle(self) -> Mode:
        """That in the middle of its speeds, for what strikes without a speed."""
        return self.at((self.speeds_m_per_s[0] + self.speeds_m_per_s[-1]) / 2)
