"""What the modules of the clients share: how a socket is connected, which line a warning is about, work in a thread."""

from __future__ import annotations

import sys
import threading
import warnings
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, Final, TypeVar

import zmq

from hapticd.system.paths import RuntimePaths

T = TypeVar("T")

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


def in_background(name: str, work: Callable[[], T]) -> Future[T]:
    """Does the work in a thread that dies with the process; what it returns or raises."""
    done: Future[T] = Future()

    def run() -> None:
        try:
            done.set_result(work())
        except BaseException as error:
            done.set_exception(error)

    threading.Thread(target=run, name=name, daemon=True).start()
    return done
