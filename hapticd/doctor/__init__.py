"""`hapticd doctor`: checks whether this machine is ready for the daemon, and says what to do if it is not.

The checks change nothing. They read files and query systemd and the daemon, each with a time limit. A check that cannot
read what it needs reports "not known", never "ok".

    machine   access to the machine for the checks (Machine), and the result of a check (Finding)
    realtime  the kernel, the rights to SCHED_FIFO and locked memory, the processors
    devices   joysticks: whether they may be driven, and which other programs use them
    service   the configuration, the systemd unit and the running daemon
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final

from hapticd.doctor import devices, realtime, service
from hapticd.doctor.machine import Finding, Machine, Needs

ALL_CHECKS: Final[tuple[Callable[[Machine, Needs], Iterator[Finding]], ...]] = (  # in the order of the output
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
    """Run every check in the order of `ALL_CHECKS`, and yield the results."""
    for check in ALL_CHECKS:
        yield from check(machine, needs)
