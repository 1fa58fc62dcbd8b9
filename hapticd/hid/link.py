"""How fast a device takes forces, and how often the effects of a connection are restored at that speed.

Another program (a game, through the kernel's driver) may reset the device and upload another effect under the
number of ours. A device that reports which effects play shows it. To any other device each part of our effects is sent
again and again: magnitude and start with every renewal, direction, type, gain, duration and envelope by the script
`restore`, one report after the forces of a pass.
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

MOST_S: Final = 0.1
"""An effect of another program lasts so long at most, where the link allows that."""
SHARE: Final = 1 / 3
"""At most this part of the reports that a link carries restores effects."""
SPARE_S: Final = 0.005
"""Added to each bound: the machine may hold the writer up so long."""
_MEASURED_ROUNDS: Final = 8
_MEASURED_S: Final = 0.05


@dataclass(frozen=True, slots=True)
class Link:
    """How fast a device takes forces."""

    endpoint_hz: float | None
    """What the endpoint's interval allows, for whole forces."""
    measured_hz: float | None
    """What was measured when the device was set up."""
    limit_hz: float | None
    """What the configuration allows."""

    @property
    def rate_hz(self) -> float | None:
        """The least of them; None: nothing is known to hold it up."""
        return min(
            (rate for rate in (self.endpoint_hz, self.measured_hz, self.limit_hz) if rate is not None), default=None
        )

    def carried_hz(self, servo_hz: float) -> float | None:
        """Forces a second that reach the device of a servo at this rate; None: all of them."""
        rate_hz = self.rate_hz
        return None if rate_hz is None or rate_hz >= servo_hz else rate_hz


def link_of(plan: Plan, out_interval_s: float | None, measured_hz: float | None = None) -> Link:
    """How often a whole force, all of its reports, can be sent through an endpoint of this interval (None: unknown)."""
    count = max(1, len(plan.force))
    endpoint = None if not out_interval_s else 1.0 / (out_interval_s * count)
    limit = None if plan.write_interval_s <= 0.0 else 1.0 / (plan.write_interval_s * count)
    return Link(endpoint, measured_hz, limit)


def measured_force_hz(device: Device, plan: Plan) -> float | None:
    """Whole forces of zero that it took a second, the median of a few; None where there is none to send."""
    reports = [message.at_rest() for message in plan.force]
    took_s: list[float] = []
    begun = time.monotonic()
    while reports and len(took_s) < _MEASURED_ROUNDS and time.monotonic() - begun < _MEASURED_S:
        start = time.monotonic()
        for report in reports:
            device.write(report)
        took_s.append(time.monotonic() - start)
    return 1.0 / max(statistics.median(took_s), 1e-6) if took_s else None


def paced(plan: Plan, force_hz: float | None) -> Plan:
    """The plan with `restore_s` and `foreign_s` for a link that carries so many whole forces a second; None: the link
    does not hold anything up."""
    if plan.foreign_s is None:
        return plan
    report_s = 0.0 if force_hz is None else 1.0 / (force_hz * max(1, len(plan.force)))
    # What may be under way before the next report that restores something.
    strike = 0 if plan.periodic is None else lib.HD_DEVICE_EFFECT_MESSAGES
    held_up_s = (len(plan.force) + len(plan.renew) + 1 + strike) * report_s + SPARE_S
    count = max(1, len(plan.restore))
    gap_s = max((MOST_S - held_up_s) / count, report_s / SHARE, 1e-3)
    # On a link that is full, each pass has one such report, after the forces; some have the renewals as well.
    full_s = count * (len(plan.force) + 1) * report_s
    renewals = min(count, math.floor(full_s / plan.renew_s) + 1)
    full_s += renewals * len(plan.renew) * report_s + SPARE_S
    return replace(plan, restore_s=gap_s, foreign_s=max(max(count * gap_s, plan.foreign_s) + held_up_s, full_s))
