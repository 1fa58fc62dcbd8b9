"""Background threads, and child processes that end with them. RLIMIT_NPROC, a user's limit of processes, counts both.

libzmq also starts threads, and aborts the process if the system refuses one. So `check` must be called before.
"""

from __future__ import annotations

import functools
import os
import resource
import signal
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Final, TypeVar

from hapticd.base.errors import HapticdError

T = TypeVar("T")

THREAD_START_ERROR: Final = "can't start new thread"
"""Text of Python's RuntimeError when a thread cannot be started."""
CLIENT_THREADS: Final = 2
"""Threads of libzmq in a client: one for the connections, one that closes sockets."""
DAEMON_THREADS: Final = 16
"""Upper bound of the threads of a daemon, which has most while it drives a device and reloads its configuration."""
_PR_SET_PDEATHSIG: Final = 1
"""Option of prctl(2): the signal that a process gets when the thread that started it ends."""


def refusal_text() -> str:
    """Return the error text for a thread that the system refused to start."""
    limit, _ = resource.getrlimit(resource.RLIMIT_NPROC)
    of = "" if limit == resource.RLIM_INFINITY else f" of {limit} processes and threads"
    return f"the system refuses another thread: the user's limit{of} is reached (ulimit -u), or memory is short"


def check(count: int) -> None:
    """Raise HapticdError unless `count` threads can be started now."""
    end = threading.Event()
    started: list[threading.Thread] = []
    try:
        for _ in range(count):
            thread = threading.Thread(target=end.wait, name="check")
            thread.start()
            started.append(thread)
    except RuntimeError:
        raise HapticdError(refusal_text()) from None
    finally:
        end.set()
        for thread in started:
            thread.join()


@functools.cache
def check_client() -> None:
    """Raise HapticdError unless a client's threads can be started; after a success, later calls check nothing."""
    check(CLIENT_THREADS)


def in_background(name: str, work: Callable[[], T]) -> Future[T]:
    """Start `work` in a daemon thread, and return the future of its result or exception."""
    done: Future[T] = Future()

    def run() -> None:
        try:
            done.set_result(work())
        except BaseException as error:
            done.set_exception(error)

    threading.Thread(target=run, name=name, daemon=True).start()
    return done


def end_with_parent(parent: int, number: signal.Signals) -> Callable[[], None]:
    """Return a function with which a child of process `parent` gets a signal when the thread that started it ends."""
    import ctypes  # imported only here: it needs memory that is writable and executable

    prctl = ctypes.CDLL(None).prctl

    def bind() -> None:
        prctl(_PR_SET_PDEATHSIG, number)
        if os.getppid() != parent:
            os._exit(1)

    return bind
