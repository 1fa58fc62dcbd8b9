"""Files of samples and events, as they are written.

What comes goes into a part file beside the target, so that memory stays bounded however long a recording is; the
target is put in place at the end, whole, by a rename. A part is in the form of the target from its first byte on, so
that the end needs no second copy. Events and what is said once go into a second part, the notes, one JSON value a line.
A file that is there is replaced only with `overwrite`. Without it, a file that appears while the recording is made
keeps its name, and the recording takes the next free one (`tap-2.npz`).

What fails leaves no file and changes none, with two exceptions. A disk that is full takes no more, but what is on it is
finished: samples at the end make room for what else belongs to the file. A process that was killed leaves its parts,
and so does one whose file could not get its name, or not be written any further; recovery.py makes a file of them.

.npz   `samples` (structured, one a tick), `events` (structured, one column for each key that occurs), and JSON texts;
       read by numpy.load without pickle
.csv   samples, one row a tick, vectors in two columns (`position_m_x`, `position_m_y`); events in a second file,
       `NAME.events.csv`, and the texts in a third, `NAME.about.json`
.mcap  see mcap.py

The section Files of docs/protocol.md says what each of them holds.
"""

from __future__ import annotations

import csv
import errno
import io
import json
import os
import re
import shlex
import zipfile
import zlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from itertools import count as numbers
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Final, NoReturn, Self, TypeAlias

import numpy as np
import numpy.typing as npt

from hapticd.base.errors import HapticdError
from hapticd.base.files import is_there, numbered
from hapticd.base.partial_files import Folder, Part, new_stem, resolved
from hapticd.recording.event_columns import NO_TIME, cell_of, columns_of, dtype_of, event_array, rows_of

__all__ = ["NO_TIME", "DiskFullError", "Samples", "Sink", "event_array", "open_sink"]

Samples: TypeAlias = npt.NDArray[np.void]

_AXES = ("x", "y")
_CHECK_EVERY: Final = 1 << 18
"""Bytes of samples after which there is a place that a full disk may fall back to."""
_ROW: Final = re.compile(rb"[-+0-9.eE,naif]+\n")
"""What a row of numbers is made of."""
_FIELD: Final = re.compile("[<>|]?[iuf][1248]")
_FULL: Final = frozenset((errno.ENOSPC, errno.EDQUOT, errno.EFBIG))


class DiskFullError(HapticdError):
    """The disk takes no more. What was written before is whole, and can be finished."""


class Sink(ABC):
    """A file in the making; what was not finished when its `with` ends is thrown away, unless it could not be finished.

    Its methods raise HapticdError where the disk does not take what is written; DiskFullError where it is only full.
    """

    def __init__(self, target: str | os.PathLike[str], *, overwrite: bool = False, left: str | None = None) -> None:
        """`left`: the parts that a process left when it was killed, by the stem of their names, are taken up.

        Raises HapticdError where the target cannot be written, or is there already and not to be replaced; with `left`
        BlockingIOError where the process still lives, and OSError and ValueError where they cannot be read.
        """
        self.target = resolved(target)
        """Where it goes; once it is finished, where it is."""
        self.displaced = False
        """Another file had appeared at the target, so that it has another name."""
        self._overwrite = overwrite
        self.count = 0
        """Samples written."""
        self.event_count = 0
        self.last_tick = -1
        self.last_time_ns = 0
        self.texts: dict[str, object] = {}
        self.about: dict[str, object] = {}
        """What of `recording` is known at the start."""
        self._stem = new_stem(self.target) if left is None else left
        self._name = os.fspath(target)
        self._dtype: np.dtype[np.void] | None = None
        self._parts: list[Part] = []
        self._shortened = False
        self._kept = left is not None
        """The parts stay, whatever happens."""
        self.torn = 0
        """Bytes at the end of what was taken up that are no whole sample or record."""
        if self.target.is_dir():
            raise HapticdError(f"{self._name}: is a directory")
        if left is None and self.target.exists() and not os.access(self.target, os.W_OK):
            raise HapticdError(f"{self._name}: may not be overwritten")
        if left is None and not overwrite:
            self.refuse_taken(target)
        try:
            self._folder = Folder(self.target.parent)
        except OSError as error:
            raise HapticdError(f"{self._name}: cannot be written: {error.strerror}") from None
        try:
            self._part = self._open_part("part", left is not None)
            self._notes = self._open_part("notes", left is not None)
            if left is not None:
                self._take_up()
        except OSError as error:
            if left is None:
                self._fail(error)
            self._discard()
            raise
        except ValueError:
            self._discard()
            raise

    # ---- What each form does ---------------------------------------------------------------------------------------

    @staticmethod
    def files_of(target: Path) -> list[Path]:
        """The files of a recording of this name, itself last."""
        return [target]

    @classmethod
    def refuse_taken(cls, target: str | os.PathLike[str]) -> None:
        """Raises HapticdError where a file of a recording of this name is there already."""
        place = resolved(target)
        for path in reversed(cls.files_of(place)):
            if os.path.lexists(path):
                name = os.fspath(target)
                raise is_there(name if path == place else os.path.join(os.path.dirname(name), path.name))

    @abstractmethod
    def _write(self, samples: Samples) -> None:
        """Appends them whole, or raises OSError and leaves what there was."""

    @abstractmethod
    def _finish(self, texts: Mapping[str, object], arrays: Mapping[str, npt.NDArray[Any]]) -> None:
        """Raises OSError, and can then be called again."""

    @abstractmethod
    def _shorten(self) -> bool:
        """Gives up the newest samples to make room; False where there are none."""

    @abstractmethod
    def _resume(self) -> int:
        """Finds out what the part holds; how many of its bytes are whole. Raises ValueError and others for what is none
        of ours."""

    # ---- What they share -------------------------------------------------------------------------------------------

    def begin(self, texts: Mapping[str, object], about: Mapping[str, object] | None = None) -> None:
        """What is known at the start, by name, and of the text `recording`; it is in the file also where the recording
        is killed."""
        self.texts, self.about = dict(texts), dict(about or {})
        self._note("texts", self.texts)
        self._note("about", self.about)

    def write(self, samples: Samples) -> None:
        """Appends samples; all have one dtype."""
        if self._dtype is None:
            self._dtype = samples.dtype
            self._note("dtype", np.lib.format.dtype_to_descr(samples.dtype))
        elif self._dtype != samples.dtype:
            raise HapticdError("the daemon changed the form of its samples; record again")
        if len(samples):
            with self._telling():
                self._write(samples)
            self.count += len(samples)
            self.last_tick, self.last_time_ns = last_of(samples)

    def write_event(self, event: Mapping[str, object]) -> None:
        """Appends an event."""
        self._note("event", event)
        self.event_count += 1

    def write_change(self, change: Mapping[str, object]) -> None:
        """Appends what a command changed."""
        self._note("change", change)

    def write_status(self, status: Mapping[str, object]) -> None:
        """Appends a status, where the form has a place for it."""
        return

    def finish(
        self,
        texts: Callable[[], Mapping[str, object]] | Mapping[str, object] | None = None,
        arrays: Mapping[str, npt.NDArray[Any]] | None = None,
    ) -> None:
        """Puts the target in place, with `texts` as JSON and `arrays` as they are where the format can.

        `texts` may be a function, which is called again once samples were given up.
        """
        while True:
            try:
                if self.torn:
                    self._part.cut(self._part.size)
                found = texts() if callable(texts) else texts
                self._finish(self.texts | dict(found or {}), arrays or {})
                return
            except OSError as error:
                if error.errno not in _FULL or self._kept or not self._shorten():
                    self._fail(error)
                self._shortened = True
                self._recount()

    def _put(self, parts: Mapping[Path, Part]) -> None:
        """Gives parts, which the disk has all of then, their names among files_of(target); raises OSError, and none has
        its name."""
        for part in parts.values():
            os.fsync(part.fd)
        for number in numbers(1):
            names = dict(zip(self.files_of(self.target), self.files_of(numbered(self.target, number)), strict=True))
            placed: dict[str, Part] = {}
            try:
                for path, part in parts.items():
                    before = part.name
                    part.name_it(names[path].name, self._overwrite)
                    placed[before] = part
            except OSError as error:
                for before, part in placed.items():
                    part.rename_back(before)
                if isinstance(error, FileExistsError):
                    continue
                raise
            folder = self._folder.where()
            self.displaced = number > 1 or folder != self._folder.path
            self.target = folder / names[self.target].name
            for part in parts.values():
                part.close()
            return

    def read_events(self) -> Iterator[dict[str, Any]]:
        """Those of the samples that there are; all where no sample was given up."""
        for event in self._noted("event"):
            if not self._shortened or int(event.get("tick", 0)) <= self.last_tick:
                yield event

    def _recount(self) -> None:
        """Counts what there is, after samples were given up."""
        self.event_count = sum(1 for _ in self.read_events())

    def _note(self, tag: str, value: object) -> None:
        with self._telling():
            self._notes.append(json.dumps([tag, value]).encode() + b"\n")

    def _noted(self, wanted: str) -> Iterator[Any]:
        for line in self._notes.lines():
            tag, value = json.loads(line)
            if tag == wanted:
                yield value

    def _all_texts(self, texts: Mapping[str, object]) -> dict[str, object]:
        changes = list(self._noted("change"))
        return dict(texts) | ({"changes": changes} if changes else {})

    def _take_up(self) -> None:
        for texts in self._noted("texts"):
            self.texts = texts
        for about in self._noted("about"):
            self.about = about
        for description in self._noted("dtype"):
            fields = [(name, form, *map(tuple, rest)) for name, form, *rest in description]
            if not all(_FIELD.fullmatch(form) for _, form, *_ in fields):
                raise ValueError("a field of samples is no plain number")
            self._dtype = np.dtype(fields)
        if self._dtype is not None:
            size = self._part.size
            self._part.size = self._resume()
            self.torn = max(size - self._part.size, 0)
            self._shortened = True
            self._recount()

    @contextmanager
    def _telling(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            if error.errno in _FULL:
                raise DiskFullError(f"{self._name}: cannot be written: {error.strerror}") from None
            self._fail(error)

    def _fail(self, error: OSError) -> NoReturn:
        told = f"{self._name}: cannot be written: {error.strerror}"
        # A disk that is full has no room for what was not finished; elsewhere it may be all that there is of an hour.
        if self.count and error.errno not in _FULL and self._part.is_there():
            self._kept = True
            told += f"; what was recorded is kept, and `hapticd recover {shlex.quote(self._name)}` makes a file of it"
        self._discard()
        raise HapticdError(told) from None

    def _remove(self, name: str) -> None:
        with suppress(FileNotFoundError):
            os.unlink(name, dir_fd=self._folder.fd)

    def _open_part(self, kind: str, resume: bool = False) -> Part:
        part = Part(self._folder, f"{self._stem}.{kind}", resume)
        self._parts.append(part)
        return part

    def discard(self) -> None:
        """Throws away what is not finished, also what was taken up."""
        self._kept = False
        self._discard()

    def _discard(self) -> None:
        for part in self._parts:
            if self._kept:
                part.close()
            else:
                part.discard()
        self._folder.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._discard()


# ---- .npz --------------------------------------------------------------------------------------------------------


class NpzSink(Sink):
    """The .npz form: an archive whose first member is the samples, so that they are where they belong at once.

    Their header is written anew at the end, when their number and checksum are known.
    """

    _MEMBER: Final = "samples.npy"
    _checksum: int
    _checks: list[tuple[int, int, int, int]]
    """Size of the part, checksum, last tick and last time at places that a full disk may fall back to."""

    def _write(self, samples: Samples) -> None:
        if self.count == 0:
            self._lay_out(samples.dtype)
        data = samples.tobytes()
        self._part.append(data)
        self._checksum = zlib.crc32(data, self._checksum)
        if self._part.size - self._checks[-1][0] >= _CHECK_EVERY:
            self._checks.append((self._part.size, self._checksum, *last_of(samples)))

    def _lay_out(self, dtype: np.dtype[np.void]) -> None:
        self._itemsize = dtype.itemsize
        self._npy_size = len(_npy_header(dtype, 10**18, 0))
        self._start = len(_local_header(self._MEMBER, 0, 0)) + self._npy_size
        if self._part.size < self._start:
            self._part.cut(self._start)
        self._checksum = 0
        self._checks = [(self._start, 0, -1, 0)]

    def _finish(self, texts: Mapping[str, object], arrays: Mapping[str, npt.NDArray[Any]]) -> None:
        dtype = self._dtype or np.dtype([])
        if self.count == 0:
            self._lay_out(dtype)
        members = {**arrays}
        members |= {name: np.array(json.dumps(value)) for name, value in self._all_texts(texts).items()}
        size = self._part.size
        header = _npy_header(dtype, self.count, self._npy_size)
        checksum = crc32_of_both(zlib.crc32(header), self._checksum, size - self._start)
        try:
            with _closing(open(self._part.descriptor(), "r+b")) as file:
                file.seek(size)
                with zipfile.ZipFile(file, "w") as archive:
                    info = zipfile.ZipInfo(self._MEMBER)
                    info.header_offset, info.CRC = 0, checksum
                    info.file_size = info.compress_size = self._npy_size + size - self._start
                    archive.infolist().append(info)
                    self._write_events(archive)
                    for name, array in members.items():
                        with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                            np.lib.format.write_array(member, array, allow_pickle=False)
            self._part.put(0, _local_header(self._MEMBER, info.file_size, checksum) + header)
            self._put({self.target: self._part})
        except OSError:
            self._part.cut(size)
            raise

    def _write_events(self, archive: zipfile.ZipFile) -> None:
        """Row by row: one long mark makes every row as long, which compression then takes away again."""
        total, columns = columns_of(self.read_events())
        info = zipfile.ZipInfo("events.npy")
        info.compress_type = zipfile.ZIP_DEFLATED
        with archive.open(info, "w", force_zip64=True) as member:
            member.write(_npy_header(dtype_of(columns), total, 0))
            for rows in rows_of(self.read_events(), columns):
                member.write(rows.tobytes())

    def _shorten(self) -> bool:
        if self.count == 0:
            return False
        if self._part.size == self._checks[-1][0]:
            self._checks.pop()
        size, self._checksum, self.last_tick, self.last_time_ns = self._checks[-1]
        self._part.cut(size)
        self.count = (size - self._start) // self._itemsize
        return self.count > 0

    def _resume(self) -> int:
        assert self._dtype is not None
        self._lay_out(self._dtype)
        count = (self._part.size - self._start) // self._itemsize
        with open(self._part.descriptor(), "rb") as file:
            file.seek(self._start)
            while self.count < count:
                data = file.read(self._itemsize * min(8192, count - self.count))
                if not data:
                    break
                self.count += len(data) // self._itemsize
                self._checksum = zlib.crc32(data, self._checksum)
                last = np.frombuffer(data[-self._itemsize :], self._dtype)
                self._checks.append((file.tell(), self._checksum, *last_of(last)))
        self.last_tick, self.last_time_ns = self._checks[-1][2:]
        return self._start + self.count * self._itemsize


def last_of(samples: Samples) -> tuple[int, int]:
    """Tick and time of the last one."""
    return int(samples["tick"][-1]), int(samples["time_ns"][-1])


@contextmanager
def _closing(file: IO[bytes]) -> Iterator[IO[bytes]]:
    """Closes a file; where it failed before, a full disk may refuse again what closing would still write."""
    try:
        yield file
    except BaseException:
        with suppress(OSError):
            file.close()
        raise
    file.close()


def _npy_header(dtype: np.dtype[Any], count: int, size: int) -> bytes:
    """The header of a .npy file of (count,) records, of `size` bytes at least."""
    file = io.BytesIO()
    header = {"descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False, "shape": (count,)}
    np.lib.format.write_array_header_1_0(file, header)
    written = file.getvalue()
    size = max(size, len(written))
    return written[:8] + (size - 10).to_bytes(2, "little") + written[10:-1].ljust(size - 11) + b"\n"


def _local_header(name: str, size: int, checksum: int) -> bytes:
    """What stands before a member of an archive; of one length, whatever the size."""
    info = zipfile.ZipInfo(name)
    info.file_size = info.compress_size = size
    info.CRC = checksum
    return info.FileHeader(zip64=True)


def crc32_of_both(first: int, second: int, length: int) -> int:
    """The CRC-32 of two stretches of bytes, one after the other, from that of each; `length`, bytes of the second.

    CRC-32 is the remainder of a polynomial over GF(2); appending n bytes multiplies that by x^(8n).
    """
    power, square = 1 << 31, 1 << 30  # 1 and x: the highest bit is the lowest power
    length *= 8
    while length:
        if length & 1:
            power = _times(power, square)
        square = _times(square, square)
        length >>= 1
    return _times(first, power) ^ second


def _times(a: int, b: int) -> int:
    """The product of two polynomials over GF(2), modulo that of CRC-32."""
    product = 0
    for bit in range(31, -1, -1):
        if a >> bit & 1:
            product ^= b
        b = b >> 1 ^ (0xEDB88320 if b & 1 else 0)
    return product


# ---- .csv --------------------------------------------------------------------------------------------------------


class CsvSink(Sink):
    """The .csv form; arrays have no place in it."""

    _checks: list[tuple[int, int, int, int]]
    """Size of the part, samples, last tick and last time at places that a full disk may fall back to."""

    def _write(self, samples: Samples) -> None:
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        if self.count == 0:
            self._part.cut(0)
            self._checks = [(0, 0, -1, 0)]
            writer.writerow(_csv_names(samples.dtype))
        columns: list[list[object]] = []
        for name in samples.dtype.names or ():
            values = samples[name].reshape(len(samples), -1)
            columns += [values[:, index].tolist() for index in range(values.shape[1])]
        writer.writerows(zip(*columns, strict=True))
        self._part.append(text.getvalue().encode())
        if self._part.size - self._checks[-1][0] >= _CHECK_EVERY:
            self._checks.append((self._part.size, self.count + len(samples), *last_of(samples)))

    @staticmethod
    def files_of(target: Path) -> list[Path]:
        return [target.with_name(f"{target.stem}.{ending}") for ending in ("events.csv", "about.json")] + [target]

    def _finish(self, texts: Mapping[str, object], arrays: Mapping[str, npt.NDArray[Any]]) -> None:
        events, about, samples = self.files_of(self.target)
        made: dict[Path, Part] = {}
        try:
            made[events] = self._make("events", self._events_text())
            told = self._all_texts(texts)
            if told:
                made[about] = self._make("about", [json.dumps(told, indent=1) + "\n"])
            self._put({**made, samples: self._part})
            if not told and self._overwrite:
                self._remove(about.name)  # it told of the recording that was replaced
        except OSError:
            for part in made.values():
                part.discard()
            raise

    def _make(self, kind: str, texts: Iterable[str]) -> Part:
        part = self._open_part(kind)
        try:
            for text in texts:
                part.append(text.encode())
        except OSError:
            part.discard()
            raise
        return part

    def _events_text(self) -> Iterator[str]:
        # What every event has, so that a file without events has its line of names, too.
        always = ("event", "tick", "time_ns")
        names = list(dict.fromkeys((*always, *(name for event in self.read_events() for name in event))))
        lines = _Lines()
        writer = csv.DictWriter(lines, names, lineterminator="\r\n")
        writer.writeheader()
        for event in self.read_events():
            if lines.size >= _CHECK_EVERY:
                yield lines.take()
            writer.writerow({name: cell_of(name, value) for name, value in event.items()})
        yield lines.take()

    def _shorten(self) -> bool:
        if self.count == 0:
            return False
        if self._part.size == self._checks[-1][0]:
            self._checks.pop()
        size, self.count, self.last_tick, self.last_time_ns = self._checks[-1]
        self._part.cut(size)
        return self.count > 0

    def _resume(self) -> int:
        lines = self._part.lines()
        head = next(lines, b"")
        names = head.decode().strip().split(",")
        self._checks = [(0, 0, -1, 0)]
        tick, time = names.index("tick"), names.index("time_ns")
        size = len(head)
        for line in lines:
            cells = line.split(b",")
            if len(cells) != len(names) or not _ROW.fullmatch(line):
                break
            size += len(line)
            self.count += 1
            self.last_tick, self.last_time_ns = int(cells[tick]), int(cells[time])
            if size - self._checks[-1][0] >= _CHECK_EVERY:
                self._checks.append((size, self.count, self.last_tick, self.last_time_ns))
        return size


class _Lines:
    """What a csv.writer whose rows end in CR LF has written, with LF alone: so it quotes a CR within a text."""

    def __init__(self) -> None:
        self._rows: list[str] = []
        self.size = 0

    def write(self, row: str) -> None:
        self._rows.append(row.removesuffix("\r\n") + "\n")
        self.size += len(row)

    def take(self) -> str:
        text = "".join(self._rows)
        self._rows, self.size = [], 0
        return text


def _csv_names(dtype: np.dtype[Any]) -> list[str]:
    names = []
    for name in dtype.names or ():
        shape = dtype[name].shape
        names += [name] if not shape else [f"{name}_{axis}" for axis in _AXES[: shape[0]]]
    return names


# ---- By name -----------------------------------------------------------------------------------------------------


def form_of(target: str | os.PathLike[str]) -> type[Sink]:
    """Raises HapticdError for an ending that is none of ours."""
    match Path(target).suffix.lower():
        case ".npz":
            return NpzSink
        case ".csv":
            return CsvSink
        case ".mcap":
            from hapticd.recording.mcap_writer import McapSink

            return McapSink
        case _:
            raise HapticdError(f"{os.fspath(target)}: must end in .npz, .csv or .mcap")


def open_sink(target: str | os.PathLike[str], overwrite: bool = False) -> Sink:
    """The sink for a target, by its ending. Raises HapticdError for another, an unwritable target, and, without
    `overwrite`, for one that is there already."""
    return form_of(target)(target, overwrite=overwrite)


def check_target(target: str | os.PathLike[str], overwrite: bool) -> None:
    """Raises HapticdError for a target of another ending, and, without `overwrite`, for one that is there already."""
    form = form_of(target)
    if not overwrite:
        form.refuse_taken(target)
