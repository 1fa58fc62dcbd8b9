"""Work that pauses: a generator yields between its parts, so that its thread can do something else there.

The daemon's command thread changes a scene in this way, and answers other requests in the pauses
(daemon/dispatch.py). Whoever has nothing else to do there calls `finish`.
"""

from collections.abc import Generator
from typing import TypeAlias, TypeVar

T = TypeVar("T")

Steps: TypeAlias = Generator[None, None, T]
"""Yields after each part, which takes milliseconds, and returns the result."""


def finish(steps: Steps[T]) -> T:
    """Does all parts, one after the other; the result."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            result: T = end.value
            return result
