"""The process's limit of file descriptors, and how many connections of clients it allows."""

from __future__ import annotations

import resource
from typing import Final

MAX_DESCRIPTORS: Final = 65536
"""The limit of file descriptors (RLIMIT_NOFILE) that the process sets, if its hard limit allows it."""
RESERVED_DESCRIPTORS: Final = 256
"""Descriptors kept from clients: for the device, signals, reloads, the flight recorder and the log."""
MAX_SOCKET_CONNECTIONS: Final = 1024
"""Largest number of connections to one socket."""
_SOCKET_COUNT: Final = 2
"""The daemon's sockets: command and telemetry."""


def raise_descriptor_limit() -> int:
    """Raise the limit of descriptors to at most MAX_DESCRIPTORS, and return the connections allowed per socket."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = MAX_DESCRIPTORS if hard == resource.RLIM_INFINITY else min(MAX_DESCRIPTORS, hard)
    if soft == resource.RLIM_INFINITY or soft >= wanted:
        return max_connections(MAX_DESCRIPTORS if soft == resource.RLIM_INFINITY else soft)
    resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
    return max_connections(wanted)


def max_connections(limit: int) -> int:
    """Return the number of connections allowed per socket, if the process may have `limit` descriptors."""
    return max(8, min(MAX_SOCKET_CONNECTIONS, (limit - RESERVED_DESCRIPTORS) // _SOCKET_COUNT))
