"""Takes in what takes long, beside the thread that serves commands: one request at a time, with its progress.

A thread, not a process: what is taken in is shared with the servo's tables (docs/adr/0025). The filters of many
textures are designed by a process that ends with the change (base/worker_process.py).
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from time import monotonic_ns
from typing import Final

from hapticd.base import worker_process
from hapticd.base.errors import HapticdError
from hapticd.base.garbage_collector import uncollected

END_S: Final = 2.0
"""So long the end waits for what is given up; it looks whether it is many times a second."""


class GivenUpError(HapticdError):
    """The daemon ends: what was being taken in is given up, and nothing of it is in force."""


class Work:
    """What is being taken in, and how far it is. Written by the thread that does it, read by any."""

    def __init__(self, method: str, ending: threading.Event) -> None:
        self.method = method
        self.started_ns = monotonic_ns()
        self.done = 0
        """Filters designed so far."""
        self.of = 0
        """Filters that are to be designed, as far as it is known."""
        self._ending = ending

    def step(self) -> None:
        """Called often by who does it. Raises GivenUpError."""
        if self._ending.is_set():
            raise GivenUpError("the daemon ends")

    def status(self) -> dict[str, object]:
        """What `get_status` says of it."""
        return {"method": self.method, "started_ns": self.started_ns, "filters_done": self.done, "filters": self.of}


class Intake:
    """At most one piece of work, in a separate thread. Only `end` and `work` are for any thread."""

    def __init__(self) -> None:
        self.wake: Callable[[], None] = lambda: None
        """Has the thread that serves commands call `finished`."""
        self.work: Work | None = None
        """What is being taken in."""
        self.ending = threading.Event()
        self._thread: threading.Thread | None = None
        self._finished: deque[Callable[[], object]] = deque()

    def begin(self, method: str, do: Callable[[Work], Callable[[], object]]) -> None:
        """Has a thread `do` it, which must not raise; what it returns is called by `finished`. Nothing is under way."""
        assert self.work is None
        self.work = work = Work(method, self.ending)

        def run() -> None:
            with uncollected(), worker_process.beside(work.step):
                self._finished.append(do(work))
            if not self.ending.is_set():
                self.wake()

        # The end does not wait for ever for one that hangs: it is a daemon's thread.
        self._thread = threading.Thread(target=run, name="intake", daemon=True)
        self._thread.start()

    def finished(self) -> None:
        """Does what is left to do of work that is over. For the thread that serves commands."""
        while self._finished:
            rest = self._finished.popleft()
            self.work = None
            rest()

    def end(self) -> None:
        """Has what is under way give up. For any thread."""
        self.ending.set()

    def join(self) -> None:
        """Waits, at most END_S, until what was given up is."""
        if self._thread is not None:
            self._thread.join(END_S)
