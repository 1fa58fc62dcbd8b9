"""Work in a thread, and whether threads can be started: a user's limit of processes (RLIMIT_NPROC) counts each of them.

libzmq starts threads, too, and aborts the process where one is refused, so `check` is called before it does.
"""

from __future__ import annotations

import functools
import resource
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Final, TypeVar

from hapticd.base.errors import HapticdError

T = TypeVar("T")

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


def in_background(name: str, work: Callable[[], T]) -> Future[T]:
    """Starts the work in a thread that does not hold up the end of the process; the future of what it returns or
    raises."""
    done: Future[T] = Future()

    def run() -> None:
        try:
            done.set_result(work())
        except BaseException as error:
            done.set_exception(error)

    threading.Thread(target=run, name=name, daemon=True).start()
    return done
