"""A process that calls a user's function, so that it can be ended whatever it does.

A thread cannot be ended, and an alarm is the main thread's: code that never returns to Python would keep a worker for
ever. So each thread of a worker has a process for a function, which loads the module once, and is killed where an
answer is late, or with the thread.

    to the process      a Function; then one SweepPoint after the other
    from the process    a text that says why the module cannot be used, or None; then (values, None) or (None, why)
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import weakref
from collections import OrderedDict
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, Final

from hapticd.base.errors import HapticdError
from hapticd.base.wording import duration
from hapticd.sweeps.columns import Kind, Row
from hapticd.sweeps.measures.sweep_point import SweepPoint

MODULE_LOAD_TIMEOUT_S: Final = 60.0
"""To start Python and to load the module."""
_MAX_PROCESSES_PER_THREAD: Final = 4
"""Functions that a thread has processes for."""


@dataclass(frozen=True, slots=True)
class Function:
    """A function, as a process needs it."""

    module: str
    name: str
    source: str
    file: str
    """Where the source was found; on another machine it may not be there."""
    folder: str
    """Of the study: what the module imports may stand there."""
    kinds: tuple[tuple[str, Kind], ...]

    @property
    def call(self) -> str:
        """As the study writes it."""
        return f"{self.module}:{self.name}"


class FunctionProcess:
    """For the thread that makes it."""

    def __init__(self, function: Function) -> None:
        """Raises HapticdError (one line) where the module cannot be loaded or has no such function."""
        self.function = function
        program = (
            f"import sys; sys.path[:] = {sys.path!r}; from hapticd.sweeps.measures.function_host import serve; serve()"
        )
        try:
            ours, its = socket.socketpair()
            with its:
                self._pipe = Connection(ours.detach())
                # A session of its own: what the function has started is ended with it.
                self._process = subprocess.Popen(
                    [sys.executable, "-I", "-c", program, str(os.getpid())],
                    stdin=its.fileno(),
                    stdout=subprocess.DEVNULL,
                    start_new_session=True,
                )
        except OSError as error:
            raise HapticdError(f"no process for a function: {os.strerror(error.errno or 0)}") from None
        self._end = weakref.finalize(self, _end, self._process, self._pipe)
        why = self._asked(
            function, MODULE_LOAD_TIMEOUT_S, f"its module was not loaded within {duration(MODULE_LOAD_TIMEOUT_S)}"
        )
        if why is not None:
            self.end()
            raise HapticdError(why)

    @property
    def alive(self) -> bool:
        """Whether it can be asked."""
        return self._end.alive and self._process.poll() is None

    def values(self, point: SweepPoint, timeout_s: float) -> Row:
        """What the function gives for a point, by column. Raises HapticdError (one line)."""
        late = f"gave nothing within {duration(timeout_s)}, and was ended (timeout_s)"
        values, why = self._asked(point, timeout_s, late)
        if why is not None:
            raise HapticdError(f"{self.function.call}: {why}")
        found: Row = values
        return found

    def end(self) -> None:
        """Ends it, whatever it does."""
        self._end()

    def _asked(self, question: object, most_s: float, late: str) -> Any:
        """The answer; a process that gives none in time is ended, and so is one that lost its own."""
        is_late = threading.Event()

        def stop() -> None:
            is_late.set()
            _kill(self._process)

        timer = threading.Timer(most_s, stop)
        timer.daemon = True
        timer.start()
        try:
            self._pipe.send(question)
            return self._pipe.recv()
        except (EOFError, OSError):
            pass
        finally:
            timer.cancel()
        code = self._process.wait()
        self.end()
        raise HapticdError(f"{self.function.call}: {late if is_late.is_set() else _ended(code)}")


def _ended(code: int) -> str:
    if code >= 0:
        return f"ended its process with exit code {code}"
    with suppress(ValueError):
        return f"its process ended with {signal.Signals(-code).name}"
    return f"its process ended with signal {-code}"


def _kill(process: subprocess.Popen[bytes]) -> None:
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)


def _end(process: subprocess.Popen[bytes], pipe: Connection) -> None:
    pipe.close()
    if process.returncode is None:  # else its number may be another's by now
        _kill(process)
    process.wait()


class _Thread(threading.local):
    """The processes of a thread, the one used last at the end."""

    def __init__(self) -> None:
        self.processes: OrderedDict[Function, FunctionProcess] = OrderedDict()


_thread: Final = _Thread()


def process_of(function: Function) -> FunctionProcess:
    """This thread's process for a function, which is kept for the next point. Raises HapticdError."""
    processes = _thread.processes
    known = processes.pop(function, None)
    if known is None or not known.alive:
        known = FunctionProcess(function)
    processes[function] = known
    while len(processes) > _MAX_PROCESSES_PER_THREAD:
        processes.popitem(last=False)[1].end()
    return known
