"""Standard output and error of a command: a failed write is reported in one line, without a traceback."""

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
    """Standard output cannot be written: a full disk, a closed terminal.

    `errno` is not set: click and rich exit without a message if an exception has the errno of a closed pipe.
    """


class ReaderGone(OutputLost):
    """Standard output is a pipe that nobody reads any more, as in `hapticd schema | head`: no message is printed."""


class _Stream(io.FileIO):
    """An output stream that discards data that cannot be written, so that a daemon continues without its log.

    With `raises` the first failed write raises OutputLost. Later ones do not, since Python flushes again at the exit.
    """

    def __init__(self, descriptor: int, raises: bool) -> None:
        super().__init__(descriptor, "wb", closefd=False)
        self._raises = raises
        self.lost = False
        """Whether the last write failed."""

    def write(self, data: Buffer, /) -> int:
        """Write `data`, or discard `data` if writing fails; return the length of `data` in bytes."""
        try:
            written = super().write(data)
        except OSError as error:
            before, self.lost = self.lost, True
            if self._raises and not before:
                if isinstance(error, BrokenPipeError):
                    raise ReaderGone from None
                raise OutputLost(f"standard output: cannot be written: {error.strerror}") from None
            return memoryview(data).nbytes
        self.lost = False
        return written


@contextmanager
def guarded() -> Iterator[Callable[[], bool]]:
    """While the context is active, make failed writes to `sys.stdout` raise OutputLost; ignore those to `sys.stderr`.

    Yields a function that returns whether the last write to stderr failed, for the exit code. A stream that the caller
    has replaced is not changed.
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
