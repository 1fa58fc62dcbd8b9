"""Notifications of the daemon and of `hapticd web` to systemd: ready, watchdog, reloading, stopping, status line.

The protocol is that of sd_notify(3): a datagram to the socket that `$NOTIFY_SOCKET` names. If it is unset, nothing is
sent and every function returns False. A message that cannot be sent is logged; the caller need not react.
"""

from __future__ import annotations

import logging
import os
import socket
import time
from collections.abc import Callable
from typing import Final

STATUS_INTERVAL_S: Final = 1.0
"""Interval of updates of the status line, unless the watchdog needs a shorter one."""
_SEND_TIMEOUT_S: Final = 2.0
"""A message is dropped if the service manager does not read its socket for this long."""

_log = logging.getLogger("hapticd")


def ready(line: str = "") -> bool:
    """Notify systemd that a start or reload has ended; `line` is the status line that `systemctl status` shows."""
    return _send("READY=1", *_status_assignment(line))


def reloading() -> bool:
    """Notify systemd that a reload begins. `ready` must follow, even if the reload fails."""
    return _send("RELOADING=1", f"MONOTONIC_USEC={time.clock_gettime_ns(time.CLOCK_MONOTONIC) // 1000}")


def stopping() -> bool:
    """Notify systemd that the process is about to end in an orderly way."""
    return _send("STOPPING=1")


def status(line: str) -> bool:
    """Send the status line that `systemctl status` shows."""
    return _send(*_status_assignment(line))


def alive() -> bool:
    """Feed systemd's watchdog. Never blocks: returns False if the socket of the service manager is full."""
    return _send("WATCHDOG=1", wait_s=0.0)


def watchdog_s() -> float | None:
    """Return the interval of systemd's watchdog in s; None if it is not set, or is set for another process."""
    text, pid = os.environ.get("WATCHDOG_USEC", ""), os.environ.get("WATCHDOG_PID", "")
    if not text.isdecimal() or int(text) == 0 or (pid and pid != str(os.getpid())):
        return None
    return int(text) * 1e-6


class Watch:
    """Feeds systemd's watchdog while the servo runs, and updates the status line.

    The thread that the watchdog supervises calls the watch often.
    """

    def __init__(self, poll: Callable[[], tuple[int, str]], now: Callable[[], float] = time.monotonic) -> None:
        """Create a watch. `poll` returns the number of ticks that the servo has computed, and the status line."""
        self._poll, self._now = poll, now
        interval_s = watchdog_s()
        self._fed = interval_s is not None
        self._on = self._fed or bool(os.environ.get("NOTIFY_SOCKET"))
        self._every_s = STATUS_INTERVAL_S if interval_s is None else min(STATUS_INTERVAL_S, interval_s / 4.0)
        self._ticks, self._line = poll()[0], ""
        self._due_s = now() + self._every_s

    def __call__(self) -> None:
        """At each interval, feed the watchdog if the servo has advanced, and send the status line if it has changed."""
        if not self._on or self._now() < self._due_s:
            return
        self._due_s = self._now() + self._every_s
        ticks, line = self._poll()
        # Ticks and line are stored only after they were sent, so that a lost message is sent again.
        if self._fed and ticks != self._ticks and alive():
            self._ticks = ticks
        if line != self._line and status(line):
            self._line = line


def _status_assignment(line: str) -> tuple[str, ...]:
    return (f"STATUS={' '.join(line.split())}",) if line else ()


def _send(*assignments: str, wait_s: float = _SEND_TIMEOUT_S) -> bool:
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
        _log.warning("cannot send %s to systemd: %s", assignments[0], error.strerror or error)
        return False
    return True
