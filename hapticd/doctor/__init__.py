"""`hapticd doctor`: what of this machine is ready for the daemon, and what to do about the rest.

Nothing is changed: files are read, systemd and the daemon are asked, each with a time limit. What cannot be read is
reported as not known, never as well.

    machine   the machine as the checks see it, and what a check finds
    realtime  the kernel, the rights to SCHED_FIFO and locked memory, the processors
    devices   joysticks: whether they may be driven, and who else has them
    service   the configuration, the unit and the daemon, if they are there
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final

from hapticd.doctor import devices, realtime, service
from hapticd.doctor.machine import Finding, Machine, Needs

CHECKS: Final[tuple[Callable[[Machine, Needs], Iterator[Finding]], ...]] = (
    realtime.preemption,
    realtime.throttling,
    realtime.group_budget,
    realtime.clock,
    realtime.priority,
    realtime.memory,
    realtime.isolation,
    realtime.governor,
    realtime.idle_states,
    devices.permissions,
    devices.rule,
    devices.competitors,
    service.unit,
    service.daemon,
)


def diagnose(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """Every check, in order."""
    for check in CHECKS:
        yield from check(machine, needs)
