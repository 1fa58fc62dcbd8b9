"""How many descriptors the process may have, and how many of them clients may take."""

from __future__ import annotations

import resource
from typing import Final

ENOUGH: Final = 65536
RESERVE: Final = 256
"""Whatever clients do, so many are left for the device, signals, reloads, the flight recorder and the log."""
MOST_CONNECTIONS: Final = 1024
"""To one socket."""
_SOCKETS: Final = 2


def settle() -> int:
    """Lets the process have as many descriptors as it can use; how many connections each of its sockets may have."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = ENOUGH if hard == resource.RLIM_INFINITY else min(ENOUGH, hard)
    if soft == resource.RLIM_INFINITY or soft >= wanted:
        return connections(ENOUGH if soft == resource.RLIM_INFINITY else soft)
    resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
    return connections(wanted)


def connections(limit: int) -> int:
    """Of a process that may have `limit` descriptors."""
    return max(8, min(MOST_CONNECTIONS, (limit - RESERVE) // _SOCKETS))
