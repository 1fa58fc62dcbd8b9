"""The rate at which a device accepts forces, and the interval at which its effects are restored.

Another program may reset the device and upload its own effect under the Effect Block Index of one of hapticd's effects.
A device that reports which effects play reveals this. To any other device hapticd sends all parameters of its effects
repeatedly: magnitude and start with every renewal; direction, type, gain, duration and envelope by the messages
`restore` of the plan.
"""

from __future__ import annotations

import math
import statistics
import time
from dataclasses import dataclass, replace
from typing import Final

from hapticd.base.core import lib
from hapticd.hid.device import Device
from hapticd.hid.plan import Plan

MAX_FOREIGN_EFFECT_S: Final = 0.1
"""Target for the longest time for which another program's effect can replace hapticd's; a slow link exceeds it."""
MAX_RESTORE_SHARE: Final = 1 / 3
"""At most this fraction of the output reports is used to restore effects."""
WRITER_DELAY_S: Final = 0.005
"""Assumed longest delay of the thread that writes forces; included in the plan's `foreign_effect_s`."""
_MAX_MEASURED_FORCES: Final = 8
"""Largest number of forces that are sent to measure the rate."""
_MEASUREMENT_TIMEOUT_S: Final = 0.05
"""The measurement ends after this time, even if fewer forces were sent."""


@dataclass(frozen=True, slots=True)
class Link:
    """Limits of the rate at which a device accepts forces (of one or more reports each); None if not known."""

    endpoint_hz: float | None
    """Limit that follows from the interval of the USB endpoint for output reports."""
    measured_hz: float | None
    """Rate that was measured during set-up."""
    limit_hz: float | None
    """Limit that the configuration sets (`max_rate_hz`)."""

    @property
    def rate_hz(self) -> float | None:
        """The smallest of endpoint_hz, measured_hz and limit_hz that are known; None if none is known."""
        return min(
            (rate for rate in (self.endpoint_hz, self.measured_hz, self.limit_hz) if rate is not None), default=None
        )

    def carried_hz(self, servo_hz: float) -> float | None:
        """Return the rate at which forces reach the device, in Hz; None if unknown, or not below the servo's rate."""
        rate_hz = self.rate_hz
        return None if rate_hz is None or rate_hz >= servo_hz else rate_hz


def link_of(plan: Plan, out_interval_s: float | None, measured_hz: float | None = None) -> Link:
    """Return the rate limits of a device with this plan; `out_interval_s` is its endpoint's interval, if known."""
    count = max(1, len(plan.force))
    endpoint = None if not out_interval_s else 1.0 / (out_interval_s * count)
    limit = None if plan.write_interval_s <= 0.0 else 1.0 / (plan.write_interval_s * count)
    return Link(endpoint, measured_hz, limit)


def measured_force_hz(device: Device, plan: Plan) -> float | None:
    """Send a few forces of zero, and return their median rate in Hz; None if the plan has no message for forces."""
    reports = [message.at_rest() for message in plan.force]
    took_s: list[float] = []
    begun = time.monotonic()
    while reports and len(took_s) < _MAX_MEASURED_FORCES and time.monotonic() - begun < _MEASUREMENT_TIMEOUT_S:
        start = time.monotonic()
        for report in reports:
            device.write(report)
        took_s.append(time.monotonic() - start)
    return 1.0 / max(statistics.median(took_s), 1e-6) if took_s else None


def plan_paced_for_link(plan: Plan, force_hz: float | None) -> Plan:
    """Return the plan with `restore_s` and `foreign_effect_s` for a device that accepts `force_hz` forces a second.

    None stands for a rate without a limit. A plan without effects is returned unchanged.
    """
    if plan.foreign_effect_s is None:
        return plan
    report_s = 0.0 if force_hz is None else 1.0 / (force_hz * max(1, len(plan.force)))
    # Time of the messages that may be sent before the next one that restores an effect.
    strike = 0 if plan.periodic is None else lib.HD_DEVICE_EFFECT_MESSAGES
    held_up_s = (len(plan.force) + len(plan.renew) + 1 + strike) * report_s + WRITER_DELAY_S
    count = max(1, len(plan.restore))
    gap_s = max((MAX_FOREIGN_EFFECT_S - held_up_s) / count, report_s / MAX_RESTORE_SHARE, 1e-3)
    # On a saturated link each pass sends one such report after the forces; some passes send the renewals, too.
    full_s = count * (len(plan.force) + 1) * report_s
    renewals = min(count, math.floor(full_s / plan.renew_s) + 1)
    full_s += renewals * len(plan.renew) * report_s + WRITER_DELAY_S
    foreign_s = max(max(count * gap_s, plan.foreign_effect_s) + held_up_s, full_s)
    return replace(plan, restore_s=gap_s, foreign_effect_s=foreign_s)
