"""Files of samples and events, as they are written: what the formats share.

A recording goes into a hidden partial file beside the target, so that memory stays bounded however long it is; the
target is put in place at the end, whole, by a rename. The partial file is in the format of the target from its first
byte on, so that the end needs no second copy. Events and what is said once go into a second partial file, the notes,
one JSON value a line. A file that is there is replaced only with `overwrite`. Without it, a file that appears while the
recording is made keeps its name, and the recording takes the next free one (`tap-2.npz`).

A recording that fails leaves no file and changes none, with two exceptions. On a full disk the newest samples give way
to what else belongs to the file, which is then finished. A process that was killed leaves its partial files, and so
does one whose file could not get its name, or not be written any further; recovery.py makes a file of them.

npz_writer.py, csv_writer.py and mcap_writer.py write the formats, formats.py chooses one by the ending. The section
Files of docs/protocol.md says what each of them holds.
"""

from __future__ import annotations

import errno
import json
import os
import re
import shlex
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from itertools import chain
from itertools import count as numbers
from pathlib import Path
from types import TracebackType
from typing import Any, Final, NamedTuple, NoReturn, Self, TypeAlias

import numpy as np
import numpy.typing as npt

from hapticd.base.errors import HapticdError
from hapticd.base.files import check_regular, is_there, numbered
from hapticd.base.partial_files import Folder, PartialFile, new_stem, resolved

Samples: TypeAlias = npt.NDArray[np.void]

CHECK_EVERY: Final = 1 << 18
"""Bytes of samples after which there is a checkpoint."""
_STRETCH: Final = 10_000
"""Samples that are written at once."""
_FIELD: Final = re.compile("[<>|]?[iuf][1248]")
_FULL: Final = frozenset((errno.ENOSPC, errno.EDQUOT, errno.EFBIG))


class DiskFullError(HapticdError):
    """The disk takes no more. What was written before is whole, and can be finished."""


class Checkpoint(NamedTuple):
    """A place in the partial file that a full disk may fall back to."""

    size: int
    samples: int
    """How many are before it."""
    last_tick: int = -1
    last_time_ns: int = 0


class RecordingWriter(ABC):
    """Writes one recording; what was not finished when its `with` ends is thrown away, unless it could not be finished.

    Its methods raise HapticdError where the disk does not take what is written; DiskFullError where it is only full.
    """

    def __init__(self, target: str | os.PathLike[str], *, overwrite: bool = False, resume: str | None = None) -> None:
        """`resume`: the stem of the names of partial files that a killed process left, to be finished here.

        Raises HapticdError where the target cannot be written, or is there already and not to be replaced; with
        `resume` BlockingIOError where the process still lives, and OSError and ValueError where they cannot be read.
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
        self._stem = new_stem(self.target) if resume is None else resume
        self._name = os.fspath(target)
        self._dtype: np.dtype[np.void] | None = None
        self._partial_files: list[PartialFile] = []
        self._checkpoints = [Checkpoint(0, 0)]
        self._dropped_samples = False
        self._keep_partial_files = resume is not None
        self.torn_bytes = 0
        """At the end of what was recovered: no whole sample or record."""
        if resume is None and self.target.exists() and not os.access(self.target, os.W_OK):
            raise HapticdError(f"{self._name}: may not be overwritten")
        if resume is None:
            self.check_files(target, overwrite)
        try:
            self._folder = Folder(self.target.parent)
        except OSError as error:
            raise HapticdError(f"{self._name}: cannot be written: {error.strerror}") from None
        try:
            self._partial = self._open_partial("part", resume is not None)
            self._notes = self._open_partial("notes", resume is not None)
            if resume is not None:
                self._resume()
        except OSError as error:
            if resume is None:
                self._fail(error)
            self._close()
            raise
        except ValueError:
            self._close()
            raise

    # ---- What each format does -------------------------------------------------------------------------------------

    @staticmethod
    def files_of(target: Path) -> list[Path]:
        """The files of a recording of this name, itself last."""
        return [target]

    @classmethod
    def check_files(cls, target: str | os.PathLike[str], overwrite: bool) -> None:
        """Raises HapticdError where a file of a recording of this name is there already, with `overwrite` where what is
        there is no regular file."""
        place = resolved(target)
        for path in reversed(cls.files_of(place)):
            check_regular(path)
            if not overwrite and os.path.lexists(path):
                name = os.fspath(target)
                raise is_there(name if path == place else os.path.join(os.path.dirname(name), path.name))

    @abstractmethod
    def _write(self, samples: Samples) -> None:
        """Appends them whole, or raises OSError and leaves what there was."""

    @abstractmethod
    def _finish(self, texts: Mapping[str, object], arrays: Mapping[str, npt.NDArray[Any]]) -> None:
        """Raises OSError, and can then be called again."""

    @abstractmethod
    def _count_written(self, dtype: np.dtype[np.void]) -> int:
        """Finds out what a killed process wrote; how many bytes of it are whole. Raises ValueError and others for what
        is none of ours."""

    def _drop_pending(self) -> None:
        """Forgets samples that were not written yet."""
        return

    # ---- What they share -------------------------------------------------------------------------------------------

    @property
    def written_bytes(self) -> int:
        """On the disk so far; another thread may ask."""
        return self._partial.size + self._notes.size

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
            with self._naming_errors():
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
        """Appends a status, where the format has a place for it."""
        return

    def write_all(
        self,
        texts: Mapping[str, object],
        changes: Iterable[Mapping[str, object]],
        samples: Samples,
        events: Iterable[Mapping[str, Any]],
    ) -> None:
        """All of a recording, which is then to be finished; events after the samples of their ticks."""
        self.begin(texts)
        for change in changes:
            self.write_change(change)
        rest = iter(events)
        event = next(rest, None)
        for first in range(0, len(samples), _STRETCH):
            stretch = samples[first : first + _STRETCH]
            self.write(stretch)
            while event is not None and int(event.get("tick", 0)) <= int(stretch["tick"][-1]):
                self.write_event(event)
                event = next(rest, None)
        for last in () if event is None else chain((event,), rest):
            self.write_event(last)

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
                if self.torn_bytes:
                    self._partial.cut(self._partial.size)
                found = texts() if callable(texts) else texts
                self._finish(self.texts | dict(found or {}), arrays or {})
                return
            except OSError as error:
                if error.errno not in _FULL or self._keep_partial_files or not self._drop_newest():
                    self._fail(error)

    def read_events(self) -> Iterator[dict[str, Any]]:
        """Those of the samples that there are; all where no sample was given up."""
        for event in self._read_notes("event"):
            if not self._dropped_samples or int(event.get("tick", 0)) <= self.last_tick:
                yield event

    def discard(self) -> None:
        """Throws away what is not finished, also what is being recovered."""
        self._keep_partial_files = False
        self._close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._close()

    def _publish(self, files: Mapping[Path, PartialFile]) -> None:
        """Gives partial files, which the disk has all of then, their names among files_of(target); raises OSError, and
        none has its name."""
        for file in files.values():
            os.fsync(file.fd)
        for number in numbers(1):
            names = dict(zip(self.files_of(self.target), self.files_of(numbered(self.target, number)), strict=True))
            renamed: dict[str, PartialFile] = {}
            try:
                for path, file in files.items():
                    before = file.name
                    file.name_it(names[path].name, self._overwrite and number == 1)
                    renamed[before] = file
            except OSError as error:
                for before, file in renamed.items():
                    file.rename_back(before)
                if isinstance(error, FileExistsError):
                    continue
                raise
            folder = self._folder.where()
            self.displaced = number > 1 or folder != self._folder.path
            self.target = folder / names[self.target].name
            for file in files.values():
                file.close()
            return

    def _checkpoint(self, count: int, samples: Samples) -> None:
        """After samples were appended: `count` are in the file, these the newest."""
        if self._partial.size - self._checkpoints[-1].size >= CHECK_EVERY:
            self._checkpoints.append(Checkpoint(self._partial.size, count, *last_of(samples)))

    def _drop_newest(self) -> bool:
        """Gives up the newest samples to make room; False where none are left."""
        if self.count == 0:
            return False
        self._drop_pending()
        if self._checkpoints[-1][:2] == (self._partial.size, self.count):
            self._checkpoints.pop()
        size, self.count, self.last_tick, self.last_time_ns = self._checkpoints[-1]
        self._partial.cut(size)
        self._dropped_samples = True
        self._count_events()
        return self.count > 0

    def _count_events(self) -> None:
        self.event_count = sum(1 for _ in self.read_events())

    def _note(self, tag: str, value: object) -> None:
        with self._naming_errors():
            self._notes.append(json.dumps([tag, value]).encode() + b"\n")

    def _read_notes(self, wanted: str) -> Iterator[Any]:
        for line in self._notes.lines():
            tag, value = json.loads(line)
            if tag == wanted:
                yield value

    def _with_changes(self, texts: Mapping[str, object]) -> dict[str, object]:
        changes = list(self._read_notes("change"))
        return dict(texts) | ({"changes": changes} if changes else {})

    def _resume(self) -> None:
        for texts in self._read_notes("texts"):
            self.texts = texts
        for about in self._read_notes("about"):
            self.about = about
        for description in self._read_notes("dtype"):
            fields = [(name, form, *map(tuple, rest)) for name, form, *rest in description]
            if not all(_FIELD.fullmatch(form) for _, form, *_ in fields):
                raise ValueError("a field of samples is no plain number")
            self._dtype = np.dtype(fields)
        if self._dtype is not None:
            size = self._partial.size
            self._partial.size = self._count_written(self._dtype)
            self.torn_bytes = max(size - self._partial.size, 0)
            self._dropped_samples = True
            self._count_events()

    @contextmanager
    def _naming_errors(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            if error.errno in _FULL:
                raise DiskFullError(f"{self._name}: cannot be written: {error.strerror}") from None
            self._fail(error)

    def _fail(self, error: OSError) -> NoReturn:
        message = f"{self._name}: cannot be written: {error.strerror}"
        # A disk that is full has no room for what was not finished; elsewhere it may be all that there is of an hour.
        if self.count and error.errno not in _FULL and self._partial.is_there():
            self._keep_partial_files = True
            command = f"hapticd recover {shlex.quote(self._name)}"
            message += f"; what was recorded is kept, and `{command}` makes a file of it"
        self._close()
        raise HapticdError(message) from None

    def _remove(self, name: str) -> None:
        with suppress(FileNotFoundError):
            os.unlink(name, dir_fd=self._folder.fd)

    def _open_partial(self, kind: str, resume: bool = False) -> PartialFile:
        file = PartialFile(self._folder, f"{self._stem}.{kind}", resume)
        self._partial_files.append(file)
        return file

    def _close(self) -> None:
        for file in self._partial_files:
            if self._keep_partial_files:
                file.close()
            else:
                file.discard()
        self._folder.close()


def last_of(samples: Samples) -> tuple[int, int]:
    """Tick and time of the last one."""
    return int(samples["tick"][-1]), int(samples["time_ns"][-1])
