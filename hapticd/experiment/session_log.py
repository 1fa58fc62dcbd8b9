"""The log of a session: one record per line, appended and synced to disk before the session continues.

A line is a JSON object that ends with the checksum of the file up to it:

    {"record":0,"kind":"session_started",...,"crc32":"1a2b3c4d"}

`record` counts from 0. The checksum is the CRC-32 of the line up to the comma before `crc32`, starting with the
checksum of the previous line, so it detects a changed, removed or moved line. If the last line is incomplete because
the process was killed, it is replaced by a record `line_dropped` with its text, and reported. Damage before the last
line is an error.
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
from typing import Final, Self, TypeAlias

from hapticd.base.errors import HapticdError
from hapticd.base.files import check_regular
from hapticd.base.yaml_source import Json

_CHECKSUM_KEY: Final = b',"crc32":"'
"""Text before the checksum of a line."""
_LINE_ENDING: Final = b'"}'
"""Text after the checksum of a line."""
_MAX_KEPT_TORN_BYTES: Final = 4096
"""A record `line_dropped` has at most this many bytes of the incomplete line that it replaces."""

Record = dict[str, Json]
"""A record without its checksum: its number `record`, its `kind`, and the members of this kind."""


@dataclass(frozen=True, slots=True)
class Contents:
    """The content of a session's log: its records, and an incomplete last line."""

    records: tuple[Record, ...]
    size: int
    """Number of bytes of the valid lines."""
    crc: int
    """CRC-32 of the last valid line."""
    torn: bytes
    """The incomplete line after the valid lines, or empty."""


def encoded(record: Mapping[str, Json], crc: int) -> tuple[bytes, int]:
    r"""Return the line of a record, including \n, and the line's checksum. `crc` is the checksum of the previous line.

    Raises HapticdError if the record cannot be written as JSON.
    """
    try:
        text = json.dumps(record, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
        body = text.encode()
    except (TypeError, ValueError) as error:
        raise HapticdError(f"this record cannot be written to the log: {error}") from None
    body = body.removesuffix(b"}")
    checksum = zlib.crc32(body, crc)
    return b"%s%s%08x%s\n" % (body, _CHECKSUM_KEY, checksum, _LINE_ENDING), checksum


def decoded(data: bytes, name: str) -> Contents:
    """Decode `data`, the content of a log. `name` is its file name, for errors.

    Raises HapticdError, with the line's number, for a damaged line before the last one.
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
                    f"{name}:{len(records) + 1}: damaged record (wrong checksum) before the last line; "
                    "restore the file from a copy"
                )
            return Contents(tuple(records), at, crc, data[at:])
        record, crc = found
        records.append(record)
        at = end + 1
    return Contents(tuple(records), at, crc, b"")


def _record(line: bytes, crc: int, number: int) -> tuple[Record, int] | None:
    """Return the record in a line, and the line's checksum, or None if the line is damaged or not record `number`."""
    body, mark, rest = line.rpartition(_CHECKSUM_KEY)
    checksum = zlib.crc32(body, crc)
    if not mark or rest != b"%08x%s" % (checksum, _LINE_ENDING):
        return None
    try:
        record = json.loads(body + b"}")
    except ValueError:
        return None
    return (record, checksum) if isinstance(record, dict) and record.get("record") == number else None


def read_log(path: Path) -> Contents:
    """Read the log at `path` without changing it. Raises HapticdError if it is damaged or cannot be read."""
    return decoded(read_file(path), str(path))


def read_file(path: Path) -> bytes:
    """Return the content of a file of a session. Raises HapticdError if it cannot be read."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise HapticdError(f"{path}: cannot be read: {error.strerror}") from None


def lines_of(records: Iterable[Mapping[str, Json]]) -> bytes:
    """Return the content of a log with these records. Raises HapticdError if one cannot be written as JSON."""
    lines, crc = [], 0
    for record in records:
        line, crc = encoded(record, crc)
        lines.append(line)
    return b"".join(lines)


class LogInMemory:
    """A log in memory, for a simulated session that is written at its end or not at all."""

    def __init__(self) -> None:
        self.records: list[Record] = []
        self.dropped: str | None = None
        self.appended: list[Record] = []

    def append(self, kind: str, **members: Json) -> Record:
        """Append a record to the log, and return it with its number."""
        record: Record = {"record": len(self.appended), "kind": kind, **members}
        self.appended.append(record)
        return record

    def close(self) -> None:
        """Do nothing: a log in memory has no file to close."""


class SessionLog:
    """The log of a session in a file, which is locked while it is open. `append` returns when a record is on disk."""

    def __init__(self, path: Path) -> None:
        """Open or create the log. A record `line_dropped` replaces an incomplete last line.

        Raises HapticdError if another process has the log open, or if the log is damaged or cannot be written.
        """
        self.path = path
        self.dropped: str | None = None
        """Message that an incomplete last line was removed from the log, or None."""
        check_regular(path)
        try:
            self._fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)
        except OSError as error:
            raise HapticdError(f"{path}: cannot be written: {error.strerror}") from None
        try:
            self._lock()
            contents = decoded(_read_all(self._fd), str(path))
            self.records: list[Record] = list(contents.records)
            """Records of the log when it was opened, with a new `line_dropped`. Later ones are not added."""
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
        """Append a record to the log, wait until it is on disk (fsync), and return it with its number.

        Raises HapticdError, and leaves the log unchanged, if the record cannot be written.
        """
        if self._fd < 0:
            raise HapticdError(f"{self.path}: the log is closed")
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
        """Close the log's file and release its lock."""
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
            f"{self.path}:{len(self.records) + 1}: removed the incomplete last line ({len(torn)} bytes); "
            "its trial is repeated"
        )
        text = torn[:_MAX_KEPT_TORN_BYTES].decode("utf-8", "backslashreplace")
        # If the process is killed meanwhile, the incomplete line is gone, or the new record is removed in turn.
        os.ftruncate(self._fd, self._size)
        self.records.append(self.append("line_dropped", bytes=len(torn), text=text))


Log: TypeAlias = SessionLog | LogInMemory


def _read_all(fd: int) -> bytes:
    parts, at = [], 0
    while part := os.pread(fd, 1 << 20, at):
        parts.append(part)
        at += len(part)
    return b"".join(parts)


def sync_folder(folder: Path) -> None:
    """Sync the directory entries of a folder to disk. Raises OSError."""
    fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
