"""The log of a session: one record a line, appended and on disk before anything goes on.

A line is a JSON object that ends in the checksum of all that stands before it in the file:

    {"record":0,"kind":"session_started",...,"crc32":"1a2b3c4d"}

`record` counts from 0. The checksum is CRC-32 of the line up to the comma before `crc32`, and begins with the checksum
of the line before. So a line that was changed, removed or moved is found. A last line that was torn when the process
was killed is cut off, kept in a record `line_dropped`, and reported. Damage before the last line is refused: nobody
knows what stood there.
"""

from __future__ import annotations

import fcntl
import json
import os
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Final, Protocol, Self

from hapticd.base.errors import HapticdError
from hapticd.base.files import check_regular
from hapticd.base.yaml_source import Json

_MARK: Final = b',"crc32":"'
_END: Final = b'"}'
_SHOWN: Final = 4096
"""Bytes of a torn line that are kept."""

Record = dict[str, Json]
"""One record: `record`, `kind` and what belongs to that kind; without its checksum."""


@dataclass(frozen=True, slots=True)
class Contents:
    """What a log holds."""

    records: tuple[Record, ...]
    size: int
    """Bytes of the sound lines."""
    crc: int
    """The checksum of the last one."""
    torn: bytes
    """What stands after them; empty where nothing does."""


def encoded(record: Mapping[str, Json], crc: int) -> tuple[bytes, int]:
    """The line of a record, with its end, and its checksum; `crc` is that of the line before.

    Raises HapticdError for what JSON cannot hold.
    """
    try:
        text = json.dumps(record, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
        body = text.encode()
    except (TypeError, ValueError) as error:
        raise HapticdError(f"the log cannot hold this record: {error}") from None
    body = body.removesuffix(b"}")
    checksum = zlib.crc32(body, crc)
    return b"%s%s%08x%s\n" % (body, _MARK, checksum, _END), checksum


def decoded(data: bytes, name: str) -> Contents:
    """The records of a log. `name` is that of the file, for errors.

    Raises HapticdError for a damaged line that is not the last one: one line, with the line's number.
    """
    records: list[Record] = []
    crc, at = 0, 0
    while at < len(data):
        end = data.find(b"\n", at)
        line = data[at:] if end < 0 else data[at:end]
        found = None if end < 0 else _record(line, crc, len(records))
        if found is None:
            if 0 <= end < len(data) - 1:
                raise HapticdError(
                    f"{name}:{len(records) + 1}: is damaged (its checksum does not fit), and records follow; "
                    "restore the file from a copy"
                )
            return Contents(tuple(records), at, crc, data[at:])
        record, crc = found
        records.append(record)
        at = end + 1
    return Contents(tuple(records), at, crc, b"")


def _record(line: bytes, crc: int, number: int) -> tuple[Record, int] | None:
    """The record of a line and its checksum; None where the line is not what was written."""
    body, mark, rest = line.rpartition(_MARK)
    checksum = zlib.crc32(body, crc)
    if not mark or rest != b"%08x%s" % (checksum, _END):
        return None
    try:
        record = json.loads(body + b"}")
    except ValueError:
        return None
    return (record, checksum) if isinstance(record, dict) and record.get("record") == number else None


def read_log(path: Path) -> Contents:
    """The records of the log at `path`, which is not changed. Raises HapticdError."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise HapticdError(f"{path}: cannot be read: {error.strerror}") from None
    return decoded(data, str(path))


def lines_of(records: Iterable[Mapping[str, Json]]) -> bytes:
    """A whole log. Raises HapticdError for what JSON cannot hold."""
    lines, crc = [], 0
    for record in records:
        line, crc = encoded(record, crc)
        lines.append(line)
    return b"".join(lines)


class Log(Protocol):
    """What a session that runs needs of its log."""

    records: list[Record]
    """What was there when the log was opened."""
    dropped: str | None

    def append(self, kind: str, **members: Json) -> Record:
        """Keeps a record, which has its number then. Raises HapticdError where it cannot be kept."""

    def close(self) -> None:
        """Ends the writing."""


class LogInMemory:
    """A log that nobody would miss: of a session that is simulated, and written as a whole or not at all."""

    def __init__(self) -> None:
        self.records: list[Record] = []
        self.dropped: str | None = None
        self.appended: list[Record] = []

    def append(self, kind: str, **members: Json) -> Record:
        record: Record = {"record": len(self.appended), "kind": kind, **members}
        self.appended.append(record)
        return record

    def close(self) -> None: ...


class SessionLog:
    """A log that is written: locked while it is, each record on disk when `append` returns."""

    def __init__(self, path: Path) -> None:
        """Opens the log, or makes it. What is torn at its end is cut off and kept in a record.

        Raises HapticdError where another process writes it, where it is damaged, or cannot be written.
        """
        self.path = path
        self.dropped: str | None = None
        """One line that says what was cut off; None: nothing was."""
        check_regular(path)
        try:
            self._fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)
        except OSError as error:
            raise HapticdError(f"{path}: cannot be written: {error.strerror}") from None
        try:
            self._lock()
            contents = decoded(_whole(self._fd), str(path))
            self.records: list[Record] = list(contents.records)
            """What was there when the log was opened. What is appended is on disk and not kept."""
            self._count = len(self.records)
            self._size, self._crc = contents.size, contents.crc
            if contents.torn:
                self._drop(contents.torn)
            sync_folder(path.parent)
        except OSError as error:
            os.close(self._fd)
            raise HapticdError(f"{path}: cannot be written: {error.strerror}") from None
        except BaseException:
            os.close(self._fd)
            raise

    def append(self, kind: str, **members: Json) -> Record:
        """Writes a record, which is on disk (fsync) when this returns.

        Raises HapticdError where it cannot be written. Then the log is as it was before.
        """
        if self._fd < 0:
            raise HapticdError(f"{self.path}: is closed")
        record: Record = {"record": self._count, "kind": kind, **members}
        line, crc = encoded(record, self._crc)
        try:
            self._put(line)
            os.fsync(self._fd)
        except OSError as error:
            os.ftruncate(self._fd, self._size)
            raise HapticdError(f"{self.path}: cannot be written: {error.strerror}") from None
        self._size, self._crc = self._size + len(line), crc
        self._count += 1
        return record

    def close(self) -> None:
        """Ends the writing; another process may go on."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _lock(self) -> None:
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise HapticdError(f"{self.path}: another process runs this session; end it first") from None

    def _put(self, line: bytes) -> None:
        rest, at = memoryview(line), self._size
        while rest:
            written = os.pwrite(self._fd, rest, at)
            at, rest = at + written, rest[written:]

    def _drop(self, torn: bytes) -> None:
        self.dropped = (
            f"{self.path}:{len(self.records) + 1}: the last line was torn ({len(torn)} bytes) and was dropped; "
            "the trial that it was of runs again"
        )
        text = torn[:_SHOWN].decode("utf-8", "backslashreplace")
        # Its record goes in the place of the line in one write: if that is torn too, it is dropped the next time.
        os.ftruncate(self._fd, self._size)
        self.records.append(self.append("line_dropped", bytes=len(torn), text=text))


def _whole(fd: int) -> bytes:
    parts, at = [], 0
    while part := os.pread(fd, 1 << 20, at):
        parts.append(part)
        at += len(part)
    return b"".join(parts)


def sync_folder(folder: Path) -> None:
    """Has the names in a folder on disk. Raises OSError."""
    fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
