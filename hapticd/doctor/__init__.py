"""`hapticd doctor`: what of this machine is ready for the daemon, and what to do about the rest.

Nothing is changed: files are read, systemd and the daemon are asked, each with a time limit. What cannot be read is
reported as not known, never as well.

    machine        the machine as the checks see it, and what a check finds
    kernel         how it is preempted, what it leaves to real-time tasks, its clock
    limits         the rights to SCHED_FIFO and locked memory
    processors     whether the servo has one for itself, how fast they run, how deep they sleep
    devices        joysticks: whether they may be driven, and who else has them
    service        the unit and the daemon, if they are there
    configuration  the configuration that the other checks go by
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final

from hapticd.doctor import devices, kernel, limits, processors, service
from hapticd.doctor.machine import Finding, Machine, Needs

CHECKS: Final[tuple[Callable[[Machine, Needs], Iterator[Finding]], ...]] = (
    kernel.preemption,
    kernel.throttling,
    kernel.group_budget,
    kernel.clock,
    limits.real_time,
    limits.memory,
    processors.isolation,
    processors.governor,
    processors.idle_states,
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
