"""Defers SIGINT and SIGTERM until a command can end without losing rows or leaving processes."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Final

_ENDING_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM)
"""Signals that ask a command to end."""


@contextmanager
def noted_interrupts(note: Callable[[int], object]) -> Iterator[None]:
    """Replace the handlers of SIGINT and SIGTERM by `note`, which gets the signal number, while the context is active.

    Signals that the process ignores, for example under nohup, stay ignored. Only the main thread can set handlers; in
    other threads nothing changes.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def arrive(number: int, frame: FrameType | None) -> None:
        note(number)

    before = {number: signal.getsignal(number) for number in _ENDING_SIGNALS}
    for number, handler in before.items():
        if handler not in (signal.SIG_IGN, None):  # None: the handler was not set by Python
            signal.signal(number, arrive)
    try:
        yield
    finally:
        for number, handler in before.items():
            if handler is not None:
                signal.signal(number, handler)


@contextmanager
def deferred_interrupts() -> Iterator[None]:
    """Defer SIGINT and SIGTERM to the end of the context."""
    arrived: list[int] = []
    try:
        with noted_interrupts(arrived.append):
            yield
    finally:
        if arrived:
            signal.raise_signal(arrived[0])


def raise_interrupt(number: int) -> None:
    """Raise KeyboardInterrupt for SIGINT, and SystemExit(128 + number) for any other signal."""
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    raise SystemExit(128 + number)


@contextmanager
def sigterm_ends() -> Iterator[None]:
    """Make SIGTERM raise SystemExit(143), the exit code that shells expect, so that cleanup runs as after Ctrl-C."""

    def end(number: int, frame: FrameType | None) -> None:
        raise_interrupt(number)

    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL if before is None else before)
