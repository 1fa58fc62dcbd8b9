"""What keeps a processor for long is computed in a separate process, while a long change is taken in.

A thread that computes shares the interpreter with the one that serves commands, which then waits for it at every system
call, up to 5 ms each (docs/adr/0031). A function marked `apart` is computed in the process instead, in threads that
said so by `beside`, and everywhere else where it is called. Both run the same code, and find the same bits.

The process is made once a change needs it, and ends with the change. It has nothing of the daemon's but one socket.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import wraps
from multiprocessing.connection import Connection
from time import monotonic
from typing import Any, Final, ParamSpec, TypeVar, cast

from hapticd.base import threads
from hapticd.base.errors import HapticdError

P = ParamSpec("P")
R = TypeVar("R")

HERE: Final = 8
"""So many are computed by the thread itself first: to make a process takes longer."""
ANSWER_S: Final = 30.0
"""None takes a tenth of a second; on a processor that many want, some seconds."""
_LOOK_S: Final = 0.1
_NICE: Final = 5
"""Whoever serves commands comes first."""


class ApartError(HapticdError):
    """The process could not be made, or did not answer."""


class Apart:
    """The process of one change. For one thread at a time."""

    def __init__(self, working: Callable[[], None]) -> None:
        """`working` is called often, while a result is waited for; what it raises ends that."""
        self._working = working
        self._here = 0
        self._ended = False
        self._process: subprocess.Popen[bytes] | None = None
        self._pipe: Connection | None = None

    def compute(self, function: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> R:
        """What a function marked `apart` returns, or what it raises. Raises ApartError, and what `working` does."""
        if self._here < HERE:
            self._here += 1
            return function(*args, **kwargs)
        if self._ended:  # a thread that was given up
            raise ApartError("the change is over")
        if self._pipe is None:
            self._make()
        assert self._pipe is not None
        try:
            self._pipe.send((function.__module__, function.__name__, args, kwargs))
            until = monotonic() + ANSWER_S
            while not self._pipe.poll(_LOOK_S):
                self._working()
                if monotonic() > until:
                    raise ApartError(f"the process that designs filters gave no answer within {ANSWER_S:g} s")
            result, failure = self._pipe.recv()
        except (EOFError, OSError):
            raise ApartError("the process that designs filters ended before it answered") from None
        if failure is not None:
            raise failure
        return cast(R, result)

    def end(self) -> None:
        """Ends the process, whatever it does; there is no other one."""
        self._ended = True
        if self._pipe is not None:
            self._pipe.close()
            self._pipe = None
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None

    def _make(self) -> None:
        # The modules of this very daemon: nothing is looked for where it happens to stand.
        program = f"import sys; sys.path[:] = {sys.path!r}; from hapticd.base.worker_process import serve; serve()"
        try:
            ours, its = socket.socketpair()
            with its:
                self._pipe = Connection(ours.detach())
                self._process = subprocess.Popen(
                    [sys.executable, "-I", "-c", program], stdin=its.fileno(), stdout=subprocess.DEVNULL
                )
        except OSError as error:
            self.end()
            reason = threads.refused() if isinstance(error, BlockingIOError) else os.strerror(error.errno or 0)
            raise ApartError(f"no process that designs filters: {reason}") from None


class _Thread(threading.local):
    """What a thread uses."""

    apart: Apart | None = None


_thread: Final = _Thread()


def apart(function: Callable[P, R]) -> Callable[P, R]:
    """Marks a function of a module whose arguments and results are plain data, and which takes milliseconds."""

    @wraps(function)
    def here_or_there(*args: P.args, **kwargs: P.kwargs) -> R:
        used = _thread.apart
        return function(*args, **kwargs) if used is None else used.compute(function, *args, **kwargs)

    return here_or_there


@contextmanager
def beside(working: Callable[[], None]) -> Iterator[None]:
    """What this thread computes meanwhile, it has computed apart if that is much."""
    made = Apart(working)
    try:
        with using(made):
            yield
    finally:
        made.end()


@contextmanager
def using(other: Apart | None) -> Iterator[None]:
    """This thread uses the process of another one, which waits for it meanwhile."""
    before, _thread.apart = _thread.apart, other
    try:
        yield
    finally:
        _thread.apart = before


def used() -> Apart | None:
    """What this thread uses."""
    return _thread.apart


def serve() -> None:
    """The process: computes what it is asked for, until nobody asks any more."""
    from importlib import import_module

    # The daemon has them blocked, and a terminal sends its interrupt to all.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_SETMASK, ())
    with suppress(OSError):  # which a service may not
        os.nice(_NICE)
    with Connection(os.dup(0)) as pipe, suppress(EOFError, OSError):
        while True:
            module, name, args, kwargs = pipe.recv()
            function: Any = getattr(import_module(module), name)
            answer: tuple[object, Exception | None]
            try:
                answer = function(*args, **kwargs), None
            except Exception as error:
                answer = None, error
            pipe.send(answer)
