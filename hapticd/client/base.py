"""Functions that the modules of clients share: connecting a socket, time-outs, warnings at the line of the caller."""

from __future__ import annotations

import math
import sys
import warnings
from typing import Any, Final

import zmq

from hapticd.system.paths import RuntimePaths

_OWN_MODULES: Final = (__package__, "contextlib")
"""Prefixes of modules that a warning skips to find the line of the caller."""


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
