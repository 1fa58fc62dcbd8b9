"""The process that calls a user's function, and that can be killed at any moment.

Threads cannot be killed, and signals interrupt only the main thread. So each thread of a worker has a process for each
function. The process loads the module once, and is killed after a time-out or when the thread ends.

    to the process      a Function, then a SweepPoint for each call
    from the process    None or the reason why the module cannot be used; then (values, None) or (None, reason)
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
"""Time-out in s for starting Python and loading the module."""
_MAX_PROCESSES_PER_THREAD: Final = 4
"""Maximum number of function processes of a thread; the least recently used process is ended to start another."""


@dataclass(frozen=True, slots=True)
class Function:
    """A user's function with the source of its module."""

    module: str
    name: str
    source: str
    file: str
    """Path from which the source was read; it need not exist at the worker."""
    folder: str
    """Folder of the study, from which the module can import."""
    kinds: tuple[tuple[str, Kind], ...]
    """Name and kind of each returned column."""

    @property
    def call(self) -> str:
        """The function as `module:name`."""
        return f"{self.module}:{self.name}"


class FunctionProcess:
    """A process that calls one user's function. Only the thread that created the process may use it."""

    def __init__(self, function: Function) -> None:
        """Start a process for a function. Raises HapticdError (one line) if the module cannot be loaded or lacks it."""
        self.function = function
        program = (
            f"import sys; sys.path[:] = {sys.path!r}; from hapticd.sweeps.measures.function_host import serve; serve()"
        )
        try:
            near, far = socket.socketpair()
            with far:
                self._pipe = Connection(near.detach())
                # In a new session, so that processes that the function starts are killed with it.
                self._process = subprocess.Popen(
                    [sys.executable, "-I", "-c", program, str(os.getpid())],
                    stdin=far.fileno(),
                    stdout=subprocess.DEVNULL,
                    start_new_session=True,
                )
        except OSError as error:
            raise HapticdError(f"cannot start a process for {function.call}: {os.strerror(error.errno or 0)}") from None
        self._end = weakref.finalize(self, _end, self._process, self._pipe)
        timeout_text = f"its module was not loaded within {duration(MODULE_LOAD_TIMEOUT_S)}"
        why = self._exchange(function, MODULE_LOAD_TIMEOUT_S, timeout_text)
        if why is not None:
            self.end()
            raise HapticdError(why)

    @property
    def alive(self) -> bool:
        """Whether the process is running."""
        return self._end.alive and self._process.poll() is None

    def values(self, point: SweepPoint, timeout_s: float) -> Row:
        """Call the function for a point and return its values by column. Raises HapticdError (one line)."""
        timeout_text = f"timed out after {duration(timeout_s)} and was killed (timeout_s)"
        values, why = self._exchange(point, timeout_s, timeout_text)
        if why is not None:
            raise HapticdError(f"{self.function.call}: {why}")
        found: Row = values
        return found

    def end(self) -> None:
        """Kill the process."""
        self._end()

    def _exchange(self, message: object, timeout_s: float, timeout_text: str) -> Any:
        """Send a message to the process and return its answer; kill the process if none arrives within `timeout_s`.

        Raises HapticdError: with `timeout_text` after a time-out, with the exit status if the process has ended.
        """
        is_late = threading.Event()

        def stop() -> None:
            is_late.set()
            _kill(self._process)

        timer = threading.Timer(timeout_s, stop)
        timer.daemon = True
        timer.start()
        try:
            self._pipe.send(message)
            return self._pipe.recv()
        except (EOFError, OSError):
            pass
        finally:
            timer.cancel()
        code = self._process.wait()
        self.end()
        raise HapticdError(f"{self.function.call}: {timeout_text if is_late.is_set() else _ended(code)}")


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
    if process.returncode is None:  # otherwise the process id may already belong to another process
        _kill(process)
    process.wait()


class _Thread(threading.local):
    """The function processes of a thread, ordered by their last use."""

    def __init__(self) -> None:
        self.processes: OrderedDict[Function, FunctionProcess] = OrderedDict()


_thread: Final = _Thread()


def process_of(function: Function) -> FunctionProcess:
    """Return this thread's process for a function, and keep it for the next point. Raises HapticdError."""
    processes = _thread.processes
    known = processes.pop(function, None)
    if known is None or not known.alive:
        known = FunctionProcess(function)
    processes[function] = known
    while len(processes) > _MAX_PROCESSES_PER_THREAD:
        processes.popitem(last=False)[1].end()
    return known
