"""`hapticd doctor`: what of this machine is ready for the daemon, and what to do about the rest.

Nothing is changed: files are read, systemd and the daemon are asked, each with a time limit. What cannot be read is
reported as not known, never as well.
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
