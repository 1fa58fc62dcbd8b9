"""Whether threads can be started: a user's limit of processes (RLIMIT_NPROC) counts each of them.

libzmq starts threads, too, and aborts the process where one is refused, so this is asked before it does.
"""

from __future__ import annotations

import functools
import resource
import threading
from typing import Final

from hapticd.base.errors import HapticdError

REFUSED: Final = "can't start new thread"
"""What Python's own RuntimeError says."""
CLIENT: Final = 2
"""Threads of libzmq: one for the connections, one that closes sockets."""
DAEMON: Final = 16
"""More than the daemon has with a device, and while it reads its configuration again."""


def refused() -> str:
    """One line for a thread that could not be started."""
    limit, _ = resource.getrlimit(resource.RLIMIT_NPROC)
    of = "" if limit == resource.RLIM_INFINITY else f" of {limit} processes and threads"
    return f"the system refuses another thread: the user's limit{of} is reached (ulimit -u), or memory is short"


def check(count: int) -> None:
    """Raises HapticdError unless `count` threads can be started now."""
    end = threading.Event()
    started: list[threading.Thread] = []
    try:
        for _ in range(count):
            thread = threading.Thread(target=end.wait, name="check")
            thread.start()
            started.append(thread)
    except RuntimeError:
        raise HapticdError(refused()) from None
    finally:
        end.set()
        for thread in started:
            thread.join()


@functools.cache
def check_client() -> None:
    """As `check`, of a client's; once it went well it is not asked again."""
    check(CLIENT)
