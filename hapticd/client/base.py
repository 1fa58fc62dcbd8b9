"""What the modules of the clients share: how a socket is connected, which line a warning is about."""

from __future__ import annotations

import sys
import warnings
from typing import Any, Final

import zmq

from hapticd.system.paths import RuntimePaths

_OWN_MODULES: Final = (__package__, "contextlib")
"""Packages and modules whose lines no warning is about."""


def connect_commands(socket: zmq.Socket[Any], place: RuntimePaths) -> None:
    """Connects a DEALER socket to the commands of a daemon."""
    socket.setsockopt(zmq.LINGER, 0)
    # Nothing waits in a queue for a daemon that is not there: what was meant for a dead one must not reach the next.
    socket.setsockopt(zmq.IMMEDIATE, 1)
    socket.connect(place.command_endpoint)


def warn(warning: Warning) -> None:
    """Warns of the line that called the client, through however many functions of ours."""
    frame, level = sys._getframe(1), 2
    while frame.f_globals.get("__name__", "").startswith(_OWN_MODULES) and frame.f_back is not None:
        frame, level = frame.f_back, level + 1
    warnings.warn(warning, stacklevel=level)
