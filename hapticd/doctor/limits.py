"""Rights of whoever asks: SCHED_FIFO and locked memory. A unit has its own, LimitRTPRIO and LimitMEMLOCK."""

from __future__ import annotations

import resource
from collections.abc import Iterator
from typing import Final

from hapticd.doctor.machine import Finding, Machine, Needs, capable

_CAP_IPC_LOCK: Final = 14
_CAP_SYS_NICE: Final = 23
LEAST_BYTES: Final = 256 << 20
"""More than a daemon with a large scene locks."""
_LIMITS: Final = "/etc/security/limits.d/hapticd.conf, and log in anew; or run the service (`hapticd install-service`)"


def real_time(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """Whether a daemon that is started from here may have its priority."""
    soft, _ = machine.limit(resource.RLIMIT_RTPRIO)
    if capable(machine, _CAP_SYS_NICE):
        yield Finding("rtprio", "ok", f"SCHED_FIFO {needs.priority} is allowed here, by CAP_SYS_NICE")
    elif soft == resource.RLIM_INFINITY or soft >= needs.priority:
        yield Finding("rtprio", "ok", f"SCHED_FIFO {needs.priority} is allowed here, by the limit rtprio")
    else:
        yield Finding(
            "rtprio",
            needs.without(),
            f"SCHED_FIFO {needs.priority} is not allowed here: the limit rtprio is {soft}",
            f"`YOU - rtprio {needs.priority}` in {_LIMITS}",
        )


def memory(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """Whether a daemon that is started from here may lock its memory."""
    soft, _ = machine.limit(resource.RLIMIT_MEMLOCK)
    if capable(machine, _CAP_IPC_LOCK):
        yield Finding("memlock", "ok", "memory may be locked here, by CAP_IPC_LOCK")
    elif soft == resource.RLIM_INFINITY:
        yield Finding("memlock", "ok", "memory may be locked here, without a limit")
    elif soft >= LEAST_BYTES:
        yield Finding("memlock", "ok", f"{soft >> 20} MiB of memory may be locked here")
    else:
        yield Finding(
            "memlock",
            needs.without(),
            f"only {soft >> 10} KiB of memory may be locked here: the rest may be paged out, and ticks wait for it",
            f"`YOU - memlock unlimited` in {_LIMITS}",
        )
