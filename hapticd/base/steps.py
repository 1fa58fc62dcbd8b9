"""Long work as a generator, which yields between its parts, so that its thread can do something else meanwhile.

The daemon's command thread changes a scene in this way, and answers other requests in between (daemon/dispatch.py).
"""

from collections.abc import Generator
from typing import TypeAlias, TypeVar

T = TypeVar("T")

Steps: TypeAlias = Generator[None, None, T]
"""Generator that yields after each part of the work, a few milliseconds, and returns the result of the work."""


def finish(steps: Steps[T]) -> T:
    """Run a generator of long work to its end without pauses, and return the result of the work."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            result: T = end.value
            return result
