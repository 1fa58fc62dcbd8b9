"""What the readers of recordings share: how much memory a file may take, which files are opened, what is wrong in them.

A recording may come from anybody. What it claims to hold is compared with what it is, and with a limit, before there is
memory for it. The limit is what the caller says, or else 32 times the size of the file and at least 1 GiB, and never
more than nine tenths of the memory that is available. A sample has 112 bytes in a .npz, and 20 or more in a .mcap; it
takes 112 when it is loaded, and about 450 when it is rendered again.
"""

from __future__ import annotations

import io
import json
import os
import stat
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, Final

import numpy as np
import numpy.typing as npt

from hapticd.base import wording
from hapticd.base.core import SAMPLE_DTYPE
from hapticd.base.errors import HapticdError
from hapticd.base.yaml_source import one_line

Samples = npt.NDArray[np.void]

TEXTS: Final = frozenset(("config", "scene", "materials", "changes", "status", "recording", "flight"))
"""What stands beside the samples, by name; whatever else a file holds is not read."""

LEAST_LIMIT: Final = 1 << 30
TIMES_SIZE: Final = 32
_OF_AVAILABLE: Final = 0.9
JSON_TIMES: Final = 32
"""Bytes of memory for a byte of JSON: lists and maps of nothing take the most, 26."""
_LARGE_JSON: Final = 1 << 16
"""Bytes of JSON from which on what it takes is not counted: counting takes longer than reading."""
_BLOCK: Final = 1 << 20


class TooMuchMemoryError(HapticdError):
    """A file would take more memory than it may."""


class BadRecordingError(ValueError):
    """What is wrong with a file, in words that show nothing of what is in it."""


@dataclass(frozen=True, slots=True)
class Recorded:
    """What a file holds."""

    samples: Samples
    """(n,) records of `hapticd.SAMPLE_DTYPE`."""
    texts: Mapping[str, Any]
    """What stands beside them, by name: `status`, `config`, `scene`, `materials`, `changes`, `recording`, `flight`."""
    events: list[dict[str, Any]] = field(default_factory=list)
    """As in telemetry, in the order of the file."""
    truth: npt.NDArray[np.float64] | None = None
    """(n, 4): of a simulation, the handle's own x, y (m) and its velocity along x, y (m/s)."""


# ---- Memory ------------------------------------------------------------------------------------------------------


class Memory:
    """What reading a file, and rendering it again, may take."""

    def __init__(
        self, name: str, size: int, limit: int | None = None, sample_bytes: int = SAMPLE_DTYPE.itemsize
    ) -> None:
        """`size` of the file, bytes; `limit` where the caller gives one; `sample_bytes`, for each sample."""
        self._name = name
        self.limit = default_limit(size) if limit is None else limit
        self.sample_bytes = sample_bytes
        self._taken = 0

    def check(self, size: int, what: str) -> None:
        """Raises TooMuchMemoryError where there is no room for `size` bytes more."""
        if self._taken + size > self.limit:
            raise TooMuchMemoryError(
                f"{one_line(self._name)}: needs {wording.size(self._taken + size)} of memory with {what}, more than "
                f"the {wording.size(self.limit)} that it may take; --max-memory (in Python max_memory) raises that"
            )

    def take(self, size: int, what: str) -> None:
        """Has so much used from here on. Raises HapticdError."""
        self.check(size, what)
        self._taken += size

    def json(self, data: bytes | str, what: str) -> Any:
        """What a text holds. Raises HapticdError, ValueError."""
        self.check(JSON_TIMES * len(data), what)
        try:
            found = json.loads(data)
        except json.JSONDecodeError as error:
            where = f"line {error.lineno}, column {error.colno}"
            raise BadRecordingError(f"{what}: is no JSON: {error.msg} ({where})") from None
        except UnicodeDecodeError:
            raise BadRecordingError(f"{what}: is no Unicode") from None
        except (RecursionError, ValueError):
            raise BadRecordingError(f"{what}: is no JSON that is read: too deep, or a number too long") from None
        self.take(size_of(found) if len(data) < _LARGE_JSON else JSON_TIMES * len(data), what)
        return found

    def event(self, event: dict[str, Any]) -> dict[str, Any]:
        """The event, which is taken."""
        size = 240 + 56 * len(event)
        for value in event.values():
            if type(value) is str:
                size += 56 + (len(value) if value.isascii() else 4 * len(value))
            elif type(value) is list or type(value) is dict:
                size += size_of(value)
        self.take(size, "its events")
        return event


def size_of(tree: object) -> int:
    """Bytes that plain data takes, about; what stands there twice counts twice."""
    total, pending = 0, [tree]
    while pending:
        here = pending.pop()
        total += sys.getsizeof(here) + 16
        if type(here) is dict:
            pending += here.keys()
            pending += here.values()
        elif type(here) is list:
            pending += here
    return total


def default_limit(size: int) -> int:
    """Bytes that a file of `size` bytes may take."""
    limit = max(LEAST_LIMIT, TIMES_SIZE * size)
    available = _available()
    return limit if available is None else min(limit, int(_OF_AVAILABLE * available))


def _available() -> int | None:
    """Bytes of memory that programs can have without others being put aside."""
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            name, _, value = line.partition(":")
            if name == "MemAvailable":
                return 1024 * int(value.split()[0])
    except (OSError, ValueError, IndexError):
        pass
    return None


class Rows:
    """Samples that come in stretches, in one array that grows."""

    def __init__(self, memory: Memory) -> None:
        self._memory = memory
        self._rows = np.empty(0, SAMPLE_DTYPE)
        self._count = 0

    def append(self, rows: Samples) -> None:
        end = self._count + len(rows)
        if end > len(self._rows):
            size = end + end // 4
            self._memory.take((size - len(self._rows)) * SAMPLE_DTYPE.itemsize, "its samples")
            self._rows.resize(size, refcheck=False)
        self._memory.take(len(rows) * (self._memory.sample_bytes - SAMPLE_DTYPE.itemsize), "its samples")
        self._rows[self._count : end] = rows
        self._count = end

    def whole(self) -> Samples:
        self._rows.resize(self._count, refcheck=False)
        return self._rows


def samples_of(count: int, columns: Callable[[str], npt.NDArray[Any]]) -> Samples:
    """Records of the names that this version has, from columns. Raises ValueError where one is missing."""
    samples = np.empty(count, SAMPLE_DTYPE)
    for name in SAMPLE_DTYPE.names or ():
        try:
            column = columns(name)
        except (KeyError, ValueError, IndexError):
            raise BadRecordingError(f"its samples have no {name}") from None
        if column.dtype.kind not in "uif" or column.shape != samples[name].shape:
            raise BadRecordingError(f"{name} has another form than in this version")
        with np.errstate(invalid="ignore"):
            samples[name] = column
    return samples


# ---- Files -------------------------------------------------------------------------------------------------------


@contextmanager
def regular(path: Path) -> Iterator[tuple[IO[bytes], int]]:
    """A regular file, opened, and its size. A pipe would be waited for, and a device has no end. Raises HapticdError,
    OSError."""
    if stat.S_ISDIR((found := os.stat(path)).st_mode):
        raise HapticdError(f"{one_line(os.fspath(path))}: is a directory")
    if stat.S_ISREG(found.st_mode):
        with open(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as file:
            found = os.fstat(file.fileno())
            if stat.S_ISREG(found.st_mode):
                yield file, found.st_size
                return
    raise HapticdError(f"{one_line(os.fspath(path))}: is no regular file")


class Bounded(io.RawIOBase):
    """A file whose reads are short: a length of gigabytes that stands in it does not become memory first."""

    def __init__(self, file: IO[bytes], most: int, problem: str) -> None:
        """`problem`: what a longer read means."""
        self._file, self._most, self._problem = file, most, problem

    def read(self, size: int = -1, /) -> bytes:
        found = self._file.read(self._most + 1 if size < 0 else min(size, self._most + 1))
        if len(found) > self._most:
            raise BadRecordingError(self._problem)
        return found

    def seek(self, place: int, whence: int = io.SEEK_SET, /) -> int:
        return self._file.seek(place, whence)

    def tell(self) -> int:
        return self._file.tell()

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True


def fill(member: IO[bytes], into: memoryview) -> int:
    """Reads into memory that is there, piece by piece; how many bytes came."""
    at = 0
    while at < len(into):
        data = member.read(min(_BLOCK, len(into) - at))
        if not data:
            break
        into[at : at + len(data)] = data
        at += len(data)
    return at
