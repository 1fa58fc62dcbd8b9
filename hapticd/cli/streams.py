"""Standard output and error of a command: what cannot be written ends it in one line, and never at its exit."""

from __future__ import annotations

import io
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hapticd.base.errors import HapticdError

if TYPE_CHECKING:
    from typing_extensions import Buffer


class OutputLost(HapticdError, OSError):
    """Nobody takes the command's output: a closed pipe, a full disk, a terminal that is gone.

    It has no `errno`: click and rich end a program without a word where they see that of a closed pipe.
    """


@dataclass(slots=True)
class Told:
    """What became of what was written."""

    lost: bool = False
    """The last that was to go to stderr did not arrive: there is nowhere to say so."""


class _Output(io.FileIO):
    """Says once that it cannot be written to, and loses the rest: what is flushed at the exit is no error any more."""

    def __init__(self, descriptor: int) -> None:
        super().__init__(descriptor, "wb", closefd=False)
        self._lost = False

    def write(self, data: Buffer, /) -> int:
        if not self._lost:
            try:
                return super().write(data)
            except OSError as error:
                self._lost = True
                raise OutputLost(f"standard output: cannot be written: {error.strerror}") from None
        return memoryview(data).nbytes


class _Errors(io.FileIO):
    """Loses what it cannot write: a daemon goes on without its log."""

    def __init__(self, descriptor: int, told: Told) -> None:
        super().__init__(descriptor, "wb", closefd=False)
        self._told = told

    def write(self, data: Buffer, /) -> int:
        try:
            written = super().write(data)
        except OSError:
            self._told.lost = True
            return memoryview(data).nbytes
        self._told.lost = False
        return written


@contextmanager
def guarded() -> Iterator[Told]:
    """Meanwhile `sys.stdout` raises OutputLost where it cannot be written, and `sys.stderr` nothing.

    Streams that somebody else put in their places are left as they are.
    """
    told = Told()
    before = sys.stdout, sys.stderr
    if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout is sys.__stdout__:
        sys.stdout.flush()
        sys.stdout = _text(sys.stdout, _Output(sys.stdout.fileno()))
    if isinstance(sys.stderr, io.TextIOWrapper) and sys.stderr is sys.__stderr__:
        sys.stderr = _text(sys.stderr, _Errors(sys.stderr.fileno(), told))
    try:
        yield told
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
