"""What the modules of clients share: sockets, their process, time-outs, warnings at the line of the caller."""

from __future__ import annotations

import math
import os
import sys
import warnings
from typing import Any, Final

import zmq

from hapticd.base.errors import HapticdError
from hapticd.system.paths import RuntimePaths

_OWN_MODULES: Final = (__package__, "contextlib")
"""Prefixes of modules that a warning skips to find the line of the caller."""


class Owner:
    """The process that created a client. A forked child has the client's sockets, but not the threads that serve them.

    The child must not even close sockets of asyncio: it shares the epoll object of the parent's event loop.
    """

    def __init__(self) -> None:
        self._process_id = os.getpid()

    @property
    def is_forked(self) -> bool:
        """Whether this process is a forked child of the owner."""
        return os.getpid() != self._process_id

    def refuse_fork(self) -> None:
        """Raise HapticdError in a forked child of the owner."""
        if self.is_forked:
            raise HapticdError(f"this client belongs to process {self._process_id}: connect again")


def connect_commands(socket: zmq.Socket[Any], place: RuntimePaths) -> None:
    """Connect a DEALER socket to the command socket of a daemon."""
    socket.setsockopt(zmq.LINGER, 0)
    # Queue no messages while no daemon is connected: a message for a dead daemon must not reach the next one.
    socket.setsockopt(zmq.IMMEDIATE, 1)
    socket.connect(place.command_endpoint)


def milliseconds(timeout_s: float) -> int:
    """Return a time-out in ms for ZeroMQ, rounded up, and at most the largest int32."""
    return min(math.ceil(timeout_s * 1e3), 2**31 - 1)


def warn(warning: Warning) -> None:
    """Issue a warning at the line that called the client: that of the nearest stack frame outside this package."""
    frame, level = sys._getframe(1), 2
    while frame.f_globals.get("__name__", "").startswith(_OWN_MODULES) and frame.f_back is not None:
        frame, level = frame.f_back, level + 1
    warnings.warn(warning, stacklevel=level)
