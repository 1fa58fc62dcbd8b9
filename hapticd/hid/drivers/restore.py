"""How often the effects of a connection are restored, and how long an effect of another program lasts in their place.

Another program (a game, through the kernel's driver) may reset the device and upload an effect of its own under the
number of ours. A device that reports which effects play shows it. To any other device each part of our effects is sent
again and again: magnitude and start with every renewal, direction, type, gain, duration and envelope by the script
`restore`, one report after the forces of a pass.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

from hapticd.base.core import lib
from hapticd.hid.plan import Plan

MOST_S: Final = 0.1
"""An effect of another program lasts so long at most, where the link allows that."""
SHARE: Final = 1 / 3
"""At most this part of the reports that a link carries restores effects."""
SPARE_S: Final = 0.005
"""Added to each bound: the machine may hold the writer up so long."""


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
