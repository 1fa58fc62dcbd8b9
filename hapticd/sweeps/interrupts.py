"""SIGINT and SIGTERM, handled where nothing is half done: no row is lost then, and no process left over."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Final

_ENDING_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def noted_interrupts(note: Callable[[int], object]) -> Iterator[None]:
    """Meanwhile they do nothing but call `note` with their number. What is ignored stays so, as under nohup.

    Threads other than the main one get no signals anyway.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def arrive(number: int, frame: FrameType | None) -> None:
        note(number)

    before = {number: signal.getsignal(number) for number in _ENDING_SIGNALS}
    for number, handler in before.items():
        if handler not in (signal.SIG_IGN, None):  # None: somebody else than Python has set it
            signal.signal(number, arrive)
    try:
        yield
    finally:
        for number, handler in before.items():
            if handler is not None:
                signal.signal(number, handler)


@contextmanager
def deferred_interrupts() -> Iterator[None]:
    """What arrives meanwhile is handled at the end."""
    arrived: list[int] = []
    try:
        with noted_interrupts(arrived.append):
            yield
    finally:
        if arrived:
            signal.raise_signal(arrived[0])


def raise_interrupt(number: int) -> None:
    """Ends as a signal would: Ctrl-C by KeyboardInterrupt, others with exit code 128 and their number."""
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    raise SystemExit(128 + number)


@contextmanager
def sigterm_ends() -> Iterator[None]:
    """SIGTERM ends the process as Ctrl-C does, but with exit code 143, as a shell would have it."""

    def end(number: int, frame: FrameType | None) -> None:
        raise_interrupt(number)

    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL if before is None else before)
