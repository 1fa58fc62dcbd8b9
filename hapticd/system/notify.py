"""What systemd hears of the daemon and of `hapticd web`: ready, alive, reloading, stopping, and a line of state.

The protocol is that of sd_notify(3): a datagram to the socket that `$NOTIFY_SOCKET` names. Where nothing is named,
nothing is sent, and every function says so by False. A message that cannot be sent is logged and changes nothing.
"""

from __future__ import annotations

import logging
import os
import socket
import time
from collections.abc import Callable
from typing import Final

LOOK_EVERY_S: Final = 1.0
"""The line of state follows what happens within this time."""
_SEND_S: Final = 2.0
"""A service manager that does not read for so long is not waited for."""

_log = logging.getLogger("hapticd")


def ready(line: str = "") -> bool:
    """The start is over, or a reload is; `line` is what `systemctl status` shows."""
    return _tell("READY=1", *_status(line))


def reloading() -> bool:
    """A reload begins; `ready` ends it, also where nothing was taken."""
    return _tell("RELOADING=1", f"MONOTONIC_USEC={time.clock_gettime_ns(time.CLOCK_MONOTONIC) // 1000}")


def stopping() -> bool:
    """An orderly end begins."""
    return _tell("STOPPING=1")


def status(line: str) -> bool:
    """The line of state."""
    return _tell(*_status(line))


def alive() -> bool:
    """Feeds the watchdog. Never waits: a manager that is busy gets it the next time."""
    return _tell("WATCHDOG=1", wait_s=0.0)


def watchdog_s() -> float | None:
    """The watchdog's interval; None where there is none, or it is another process's."""
    text, pid = os.environ.get("WATCHDOG_USEC", ""), os.environ.get("WATCHDOG_PID", "")
    if not text.isdecimal() or int(text) == 0 or (pid and pid != str(os.getpid())):
        return None
    return int(text) * 1e-6


class Watch:
    """Feeds the watchdog, but only while the servo ticks, and keeps the line of state. For the thread whose life the
    watchdog is to report, which calls it often."""

    def __init__(self, look: Callable[[], tuple[int, str]], now: Callable[[], float] = time.monotonic) -> None:
        """`look`: ticks rendered so far, and the line of state; called once in a while."""
        self._look, self._now = look, now
        interval_s = watchdog_s()
        self._fed = interval_s is not None
        self._on = self._fed or bool(os.environ.get("NOTIFY_SOCKET"))
        self._every_s = LOOK_EVERY_S if interval_s is None else min(LOOK_EVERY_S, interval_s / 4.0)
        self._ticks, self._line = look()[0], ""
        self._due_s = now() + self._every_s

    def __call__(self) -> None:
        """Tells what is due."""
        if not self._on or self._now() < self._due_s:
            return
        self._due_s = self._now() + self._every_s
        ticks, line = self._look()
        # The ticks that were reported are remembered only once they were sent: a message that was lost is made up for.
        if self._fed and ticks != self._ticks and alive():
            self._ticks = ticks
        if line != self._line and status(line):
            self._line = line


def _status(line: str) -> tuple[str, ...]:
    return (f"STATUS={' '.join(line.split())}",) if line else ()


def _tell(*assignments: str, wait_s: float = _SEND_S) -> bool:
    address = os.environ.get("NOTIFY_SOCKET", "")
    if not address or not assignments:
        return False
    if address.startswith("@"):
        address = "\0" + address[1:]
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as out:
            out.settimeout(wait_s)
            out.sendto("\n".join(assignments).encode(), address)
    except BlockingIOError:
        return False
    except OSError as error:
        _log.warning("systemd is not told %s: %s", assignments[0], error.strerror or error)
        return False
    return True
