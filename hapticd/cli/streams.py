"""Standard output and error of a command: what cannot be written ends it in one line, and never at its exit."""

from __future__ import annotations

import io
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from hapticd.base.errors import HapticdError

if TYPE_CHECKING:
    from typing_extensions import Buffer


class OutputLost(HapticdError, OSError):
    """Nobody takes the command's output: a closed pipe, a full disk, a terminal that is gone.

    It has no `errno`: click and rich end a program without a word where they see that of a closed pipe.
    """


class _Stream(io.FileIO):
    """What cannot be written to it is lost, as a daemon goes on without its log; `raises`: the first time it says so,
    and what is flushed at the exit is no error any more."""

    def __init__(self, descriptor: int, raises: bool) -> None:
        super().__init__(descriptor, "wb", closefd=False)
        self._raises = raises
        self.lost = False
        """What was written last did not arrive."""

    def write(self, data: Buffer, /) -> int:
        try:
            written = super().write(data)
        except OSError as error:
            before, self.lost = self.lost, True
            if self._raises and not before:
                raise OutputLost(f"standard output: cannot be written: {error.strerror}") from None
            return memoryview(data).nbytes
        self.lost = False
        return written


@contextmanager
def guarded() -> Iterator[Callable[[], bool]]:
    """Meanwhile `sys.stdout` raises OutputLost where it cannot be written, and `sys.stderr` nothing; the function that
    is given returns whether the last line for stderr was lost, as there is nowhere to say so.

    Streams that somebody else put in their places are left as they are.
    """
    before, errors = (sys.stdout, sys.stderr), None
    if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout is sys.__stdout__:
        sys.stdout.flush()
        sys.stdout = _text(sys.stdout, _Stream(sys.stdout.fileno(), raises=True))
    if isinstance(sys.stderr, io.TextIOWrapper) and sys.stderr is sys.__stderr__:
        errors = _Stream(sys.stderr.fileno(), raises=False)
        sys.stderr = _text(sys.stderr, errors)
    try:
        yield lambda: errors is not None and errors.lost
    finally:
        for stream in (sys.stdout, sys.stderr):
            if stream is not None:
                with suppress(OSError):
                    stream.flush()
        sys.stdout, sys.stderr = before


def _text(like: io.TextIOWrapper, raw: io.FileIO) -> io.TextIOWrapper:
    return io.TextIOWrapper(
        io.BufferedWriter(raw),
        like.encoding,
        like.errors,
        line_buffering=like.line_buffering,
        write_through=like.write_through,
    )
