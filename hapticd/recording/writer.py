"""Writer of recordings: a .npz that numpy.load reads without pickle.

Samples are appended to a hidden partial file in the target's folder, so that memory stays bounded for any length of a
recording. At the end this file becomes the archive, with the samples as its first member. Their header, with number
and checksum, is written into room that was reserved in front of them. Events and texts follow; before the end they are
in a second partial file, the notes, one JSON value per line. Last, the archive is renamed to the target.

On a full disk the newest samples are dropped, so that the recording can be finished. The partial files stay if the
process is killed, if the archive cannot be renamed, or if writing fails for another reason; recovery.py makes a
recording of them. Any other failed recording leaves no file.

docs/reference/recordings.md describes the content of a recording.
"""

from __future__ import annotations

import errno
import fcntl
import io
import json
import os
import re
import shlex
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO, Final, NoReturn, Self, TypeAlias

import numpy as np
import numpy.typing as npt

from hapticd.base.errors import HapticdError
from hapticd.base.files import check_new, create, rename_to_free_name, temporary_path
from hapticd.recording.event_columns import columns_of, dtype_of, rows_of

Samples: TypeAlias = npt.NDArray[np.void]
Texts: TypeAlias = Mapping[str, object]

NOTES_ENDING: Final = ".notes"
"""Ending of the second partial file of a recording, the notes: events and texts."""
_WRITE_BLOCK_SAMPLES: Final = 10_000
"""Number of samples that `RecordingWriter.write_all` writes at once."""
_DROPPED_BLOCK_BYTES: Final = 1 << 18
"""Bytes of samples that are dropped at once on a full disk."""
_CHECKSUM_BLOCK_BYTES: Final = 1 << 20
"""Bytes that are read at once when the checksum is computed."""
_SAMPLE_ALIGNMENT_BYTES: Final = 64
"""Samples begin at a multiple of 64 bytes, so that they can be mapped into memory."""
_FIELD_FORMAT: Final = re.compile("[<>|]?[iuf][1248]")
"""numpy format of a field of samples: a plain number."""
_DISK_FULL_ERRORS: Final = frozenset((errno.ENOSPC, errno.EDQUOT, errno.EFBIG))
"""Errors of a full disk, an exceeded quota or a file of the maximum size."""


class DiskFullError(HapticdError):
    """The disk is full. The samples written before are complete, and the recording can still be finished."""


class RecordingWriter:
    """Writer of a recording, a context manager.

    At the end of the `with` block, an unfinished recording is deleted; if finishing failed, its partial files stay for
    `hapticd record --recover`. Methods raise DiskFullError on a full disk, HapticdError for other failures.
    """

    def __init__(self, target: str | os.PathLike[str], overwrite: bool = False, *, resume: Path | None = None) -> None:
        """Begin a recording, or resume one from `resume`, the partial file of a killed process.

        Raises HapticdError if the target cannot be written, or exists and `overwrite` is False. With `resume`, raises
        BlockingIOError if that process still runs, and OSError or one of READING_ERRORS for an unreadable file.
        """
        self._name = os.fspath(target)
        self.target = Path(os.path.realpath(target))
        """Path of the recording: the given one, after `finish` the actual one."""
        self.displaced = False
        """Whether the finished recording has another name, because another program had created the target."""
        self.count = 0
        """Number of samples written."""
        self.event_count = 0
        self.last_tick, self.last_time_ns = -1, 0
        self.texts: dict[str, object] = {}
        self.about: dict[str, object] = {}
        """Known members of the text `recording`, with which a recovered recording is completed."""
        self._overwrite = overwrite
        self._dtype: np.dtype[np.void] = np.dtype([])
        self._start = self._header_size = 0
        self._gave_up_samples = False
        self._keep_partial_files = resume is not None
        if resume is None:
            check_new(target, overwrite)
            if self.target.exists() and not os.access(self.target, os.W_OK):
                raise HapticdError(f"{self._name}: exists and is not writable")
        part = resume or temporary_path(self.target)
        self._files: list[_PartialFile] = []
        try:
            for path in (part, part.with_suffix(NOTES_ENDING)):
                self._files.append(_PartialFile(path, resume is not None))
            self._part, self._notes = self._files
            if resume is not None:
                self._resume()
        except OSError as error:
            if resume is None:
                self._fail(error)
            self._close()
            raise
        except BaseException:
            self._close()
            raise

    @property
    def written_bytes(self) -> int:
        """Bytes in the partial files. Other threads may read this property."""
        return self._part.size + self._notes.size

    def begin(self, texts: Texts, about: Texts | None = None) -> None:
        """Write the texts that are known at the start, for a recovered recording, too.

        `about` has the known members of the text `recording`.
        """
        self.texts, self.about = dict(texts), dict(about or {})
        self._note("texts", self.texts)
        self._note("about", self.about)

    def write(self, samples: Samples) -> None:
        """Append samples to the recording; all must have the same dtype."""
        if not self._dtype.names:
            self._dtype = samples.dtype
            self._note("dtype", np.lib.format.dtype_to_descr(samples.dtype))
            self._leave_room()
            self._note("start", self._start)
        elif self._dtype != samples.dtype:
            raise HapticdError("the daemon changed the format of its samples; record again")
        if len(samples):
            with self._naming_errors():
                if not self._part.size:
                    self._part.cut(self._start)
                self._part.append(samples.tobytes())
            self.count += len(samples)
            self.last_tick, self.last_time_ns = int(samples["tick"][-1]), int(samples["time_ns"][-1])

    def write_event(self, event: Texts) -> None:
        """Append an event to the recording."""
        self._note("event", event)
        self.event_count += 1

    def write_change(self, change: Texts) -> None:
        """Append a change or an action of a command to the list `changes` of the recording."""
        self._note("change", change)

    def write_all(self, texts: Texts, changes: Iterable[Texts], samples: Samples, events: Iterable[Texts]) -> None:
        """Write the texts, changes, samples and events of a recording. The caller must then call `finish`."""
        self.begin(texts)
        for change in changes:
            self.write_change(change)
        for first in range(0, len(samples), _WRITE_BLOCK_SAMPLES):
            self.write(samples[first : first + _WRITE_BLOCK_SAMPLES])
        for event in events:
            self.write_event(event)

    def finish(
        self, texts: Callable[[], Texts] | Texts | None = None, arrays: Mapping[str, npt.NDArray[Any]] | None = None
    ) -> None:
        """Add `texts`, as JSON, and `arrays` to the recording, complete the archive, and rename it to the target.

        On a full disk, the newest samples are dropped until the archive fits; a function `texts` is then called again.
        """
        while True:
            try:
                self._finish(self.texts | dict((texts() if callable(texts) else texts) or {}), arrays or {})
                return
            except OSError as error:
                if error.errno not in _DISK_FULL_ERRORS or self._keep_partial_files or not self._give_up_newest():
                    self._fail(error)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._close()

    # ---- The archive -------------------------------------------------------------------------------------------------

    def _leave_room(self, start: int | None = None) -> None:
        """Reserve room for the headers in front of the samples. `start` is the samples' offset in a resumed file."""
        outer = len(_zip_info(0, 0).FileHeader(zip64=True))
        needed = outer + len(_npy_header(self._dtype, 10**18))
        self._start = needed + -needed % _SAMPLE_ALIGNMENT_BYTES if start is None else max(start, needed)
        self._header_size = self._start - outer

    @property
    def _end(self) -> int:
        """Offset in bytes of the end of the samples within the partial file."""
        return self._start + self.count * self._dtype.itemsize

    def _finish(self, texts: Texts, arrays: Mapping[str, npt.NDArray[Any]]) -> None:
        """Complete the archive and rename it to the target. After an OSError, the recording is unfinished as before."""
        if not self._start:
            self._leave_room()
        self._part.cut(self._end)
        notes_size = self._notes.size
        self._notes.append(_line("ends_after", self.count))
        changes = list(self._read_notes("change"))
        named = dict(texts) | ({"changes": changes} if changes else {})
        members = {**arrays, **{name: np.array(json.dumps(value)) for name, value in named.items()}}
        header = _npy_header(self._dtype, self.count, self._header_size)
        info = _zip_info(self._header_size + self._end - self._start, self._checksum(header))
        try:
            with _closing(open(self._part.path, "r+b")) as file:
                file.seek(self._end)
                with zipfile.ZipFile(file, "w") as archive:
                    archive.infolist().append(info)
                    self._write_events(archive)
                    for name, array in members.items():
                        with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                            np.lib.format.write_array(member, array, allow_pickle=False)
                file.seek(0)
                file.write(info.FileHeader(zip64=True) + header)
                file.flush()
                os.fsync(file.fileno())
            self._part.check_there()
            placed = rename_to_free_name(self._part.path, self.target, self._overwrite)
        except OSError:
            self._part.cut(self._end)
            self._notes.cut(notes_size)
            raise
        self.displaced, self.target = placed != self.target, placed
        self._keep_partial_files = False

    def _checksum(self, header: bytes) -> int:
        checksum = zlib.crc32(header)
        for at in range(self._start, self._end, _CHECKSUM_BLOCK_BYTES):
            checksum = zlib.crc32(self._part.read(at, min(_CHECKSUM_BLOCK_BYTES, self._end - at)), checksum)
        return checksum

    def _write_events(self, archive: zipfile.ZipFile) -> None:
        """Write the events into the archive, compressed, in blocks of about ROW_BLOCK_BYTES."""
        total, columns = columns_of(self._read_events())
        info = zipfile.ZipInfo("events.npy")
        info.compress_type = zipfile.ZIP_DEFLATED
        with archive.open(info, "w", force_zip64=True) as member:
            member.write(_npy_header(dtype_of(columns), total))
            for rows in rows_of(self._read_events(), columns):
                member.write(rows.tobytes())

    def _read_events(self) -> Iterator[dict[str, Any]]:
        """Yield the events from the notes, without those of dropped samples."""
        for event in self._read_notes("event"):
            if not self._gave_up_samples or int(event.get("tick", 0)) <= self.last_tick:
                yield event

    # ---- Full disk, and killed process -------------------------------------------------------------------------------

    def _give_up_newest(self) -> bool:
        """Drop the newest samples to make room on the disk; return whether any samples remain."""
        if self.count == 0:
            return False
        self._keep(max(0, self.count - _DROPPED_BLOCK_BYTES // self._dtype.itemsize))
        return self.count > 0

    def _keep(self, count: int) -> None:
        """Truncate the partial file to its first `count` samples."""
        self.count = count
        self._part.cut(self._end)
        if count:
            last = np.frombuffer(self._part.read(self._end - self._dtype.itemsize, self._dtype.itemsize), self._dtype)
            self.last_tick, self.last_time_ns = int(last["tick"][0]), int(last["time_ns"][0])
        self._gave_up_samples = True
        self.event_count = sum(1 for _ in self._read_events())

    def _resume(self) -> None:
        """Read the partial files of a killed process. Raises one of READING_ERRORS for damaged content."""
        for texts in self._read_notes("texts"):
            self.texts = texts
        for about in self._read_notes("about"):
            self.about = about
        for description in self._read_notes("dtype"):
            fields = [(name, form, *map(tuple, rest)) for name, form, *rest in description]
            if not all(_FIELD_FORMAT.fullmatch(form) for _, form, *_ in fields):
                raise ValueError("a field of samples is not a plain number")
            self._dtype = np.dtype(fields)
            # In files of earlier versions samples begin right after the headers, without a note of their offset.
            self._leave_room(next(self._read_notes("start"), 0))
        if self._dtype.names:
            written = max(0, self._part.size - self._start) // self._dtype.itemsize
            # If the process was killed in `finish`, other members of the archive may follow the samples.
            self._keep(min([written, *self._read_notes("ends_after")]))

    def _note(self, tag: str, value: object) -> None:
        with self._naming_errors():
            self._notes.append(_line(tag, value))

    def _read_notes(self, wanted: str) -> Iterator[Any]:
        for line in self._notes.lines():
            tag, value = json.loads(line)
            if tag == wanted:
                yield value

    @contextmanager
    def _naming_errors(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            if error.errno in _DISK_FULL_ERRORS:
                raise DiskFullError(f"{self._name}: cannot be written: {error.strerror}") from None
            self._fail(error)

    def _fail(self, error: OSError) -> NoReturn:
        message = f"{self._name}: cannot be written: {error.strerror}"
        # Unless the disk is full, partial files stay: they may hold an hour of samples.
        if self.count and error.errno not in _DISK_FULL_ERRORS and self._part.is_there():
            self._keep_partial_files = True
            command = f"hapticd record --recover {shlex.quote(self._name)}"
            message += f"; the samples are kept, and `{command}` makes a recording of them"
        self._close()
        raise HapticdError(message) from None

    def discard(self) -> None:
        """Delete the partial files of the recording, also those of a killed process."""
        self._keep_partial_files = False
        self._close()

    def _close(self) -> None:
        for file in self._files:
            file.close(delete=not self._keep_partial_files)


class _PartialFile:
    """A partial file, locked as long as its process runs. Data are appended completely or not at all."""

    def __init__(self, path: Path, resume: bool) -> None:
        """Create a file, or with `resume` open an existing one.

        Raises BlockingIOError if another process has locked the file, OSError for other failures.
        """
        self.path = path
        self._file: BinaryIO = open(path, "r+b", 0) if resume else create(path, buffering=0)  # noqa: SIM115
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            self._file.close()
            raise
        self.size = os.fstat(self._file.fileno()).st_size

    def append(self, data: bytes) -> None:
        """Append data to the partial file. After an OSError, the file is unchanged."""
        remaining, at = memoryview(data), self.size
        try:
            while remaining:
                written = os.pwrite(self._file.fileno(), remaining, at)
                at, remaining = at + written, remaining[written:]
        except OSError:
            os.ftruncate(self._file.fileno(), self.size)
            raise
        self.size = at
        self.check_there()

    def check_there(self) -> None:
        """Raise OSError if another program removed the partial file."""
        if not self.is_there():
            raise FileNotFoundError(errno.ENOENT, "it was removed while it was being written")

    def is_there(self) -> bool:
        return os.fstat(self._file.fileno()).st_nlink > 0

    def read(self, at: int, size: int) -> bytes:
        return os.pread(self._file.fileno(), size, at)

    def cut(self, size: int) -> None:
        os.ftruncate(self._file.fileno(), size)
        self.size = size

    def lines(self) -> Iterator[bytes]:
        """Yield the complete lines of the partial file."""
        with open(self.path, "rb") as file:
            yield from (line for line in file if line.endswith(b"\n"))

    def close(self, delete: bool) -> None:
        if not self._file.closed:
            if delete:
                with suppress(OSError):
                    self.path.unlink(missing_ok=True)
            self._file.close()


@contextmanager
def _closing(file: BinaryIO) -> Iterator[BinaryIO]:
    """Close a file at the end of a `with` block; after an error in the block, ignore an error of closing."""
    try:
        yield file
    except BaseException:
        with suppress(OSError):
            file.close()
        raise
    file.close()


def _line(tag: str, value: object) -> bytes:
    return json.dumps([tag, value]).encode() + b"\n"


def _npy_header(dtype: np.dtype[Any], count: int, size: int = 0) -> bytes:
    """Return the header of a .npy file with `count` records, padded to at least `size` bytes."""
    file = io.BytesIO()
    header = {"descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False, "shape": (count,)}
    np.lib.format.write_array_header_1_0(file, header)
    written = file.getvalue()
    size = max(size, len(written))
    return written[:8] + (size - 10).to_bytes(2, "little") + written[10:-1].ljust(size - 11) + b"\n"


def _zip_info(size: int, checksum: int) -> zipfile.ZipInfo:
    """Return the entry of an archive for its first member, the samples. Its header always has the same length."""
    info = zipfile.ZipInfo("samples.npy")
    info.header_offset, info.CRC = 0, checksum
    info.file_size = info.compress_size = size
    return info
