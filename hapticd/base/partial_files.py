"""Partial files: hidden beside the target, they get its name once they are whole.

Everything is done relative to the folder's descriptor: whoever renames the folder, or puts a link in its place, changes
nothing. Others may write to the folder, too. So the name of a partial file cannot be guessed
(`.NAME.PROCESS.RANDOM.part`), it is never opened through a link, and it gets no name unless it still is the file that
was opened. `partial_files_of` finds those of processes that were killed; what others put there under such a name is
reported, and left as it is.
"""

from __future__ import annotations

import errno
import fcntl
import os
import re
import secrets
import stat
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from hapticd.base.errors import HapticdError
from hapticd.base.files import check_regular, displaced, numbered, put

_LONGEST: Final = 1 << 26
"""Bytes of a line; of ours, scene and materials together have some megabytes at most."""
_LINKS: Final = 40
"""Links in a row, as many as Linux follows."""
_REMOVED: Final = "it was removed while it was being written"
_NEW: Final = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
_RESUME: Final = os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC


class Folder:
    """A folder that is written to, by its descriptor."""

    def __init__(self, path: Path) -> None:
        """Raises OSError."""
        self.path = path
        self.fd = os.open(path, os.O_PATH | os.O_DIRECTORY | os.O_CLOEXEC)

    def names(self) -> list[str]:
        """What is in it; nothing where it may not be read."""
        with suppress(OSError):
            fd = os.open(".", os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC, dir_fd=self.fd)
            try:
                return os.listdir(fd)
            finally:
                os.close(fd)
        return []

    def where(self) -> Path:
        """Where it is now: it may have been renamed."""
        try:
            same = os.path.samestat(os.stat(self.path), os.fstat(self.fd))
        except OSError:
            same = False
        return self.path if same else Path(os.readlink(f"/proc/self/fd/{self.fd}"))

    def close(self) -> None:
        if self.fd >= 0:
            os.close(self.fd)
            self.fd = -1


def resolved(target: str | os.PathLike[str]) -> Path:
    """The place of a target that may be a link. Raises HapticdError where something is there that is no regular file,
    or where the link is another user's, in a folder that others may write to: it leads where they please."""
    check_regular(target)
    path = os.fspath(target)
    for _ in range(_LINKS):
        if not os.path.islink(path):
            break
        folder = os.stat(os.path.dirname(path) or ".")
        owner = os.lstat(path).st_uid
        if folder.st_mode & (stat.S_IWOTH | stat.S_IWGRP) and owner not in (os.geteuid(), folder.st_uid):
            raise HapticdError(
                f"{os.fspath(target)}: is another user's link, in a folder that others may write to; give another name"
            )
        path = os.path.join(os.path.dirname(path), os.readlink(path))
    return Path(os.path.realpath(path))


class PartialFile:
    """A file in the making, locked while it is: what is appended is in it whole, or not at all."""

    def __init__(self, folder: Folder, name: str, resume: bool = False) -> None:
        """A new file, or with `resume` one that is ours. Raises FileExistsError, BlockingIOError (somebody is still
        writing it), OSError."""
        self.folder = folder
        self.name = name
        self.fd = os.open(name, _RESUME if resume else _NEW, 0o666, dir_fd=folder.fd)
        self._closed = False
        try:
            found = os.fstat(self.fd)
            if resume and not _is_ours(found):
                raise PermissionError(errno.EPERM, "it is not ours")
            fcntl.flock(self.fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            self.close()
            raise
        self.size = found.st_size

    def append(self, data: bytes) -> None:
        """Raises OSError; then there is as much in it as before."""
        try:
            self.put(self.size, data)
        except OSError:
            os.ftruncate(self.fd, self.size)
            raise
        self.size += len(data)
        if os.fstat(self.fd).st_nlink == 0:
            raise FileNotFoundError(errno.ENOENT, _REMOVED)

    def put(self, at: int, data: bytes) -> None:
        """Writes at a place."""
        rest = memoryview(data)
        while rest:
            written = os.pwrite(self.fd, rest, at)
            at, rest = at + written, rest[written:]

    def cut(self, size: int) -> None:
        """Forgets what comes after."""
        os.ftruncate(self.fd, size)
        self.size = size

    def descriptor(self) -> int:
        """Another descriptor of it, at its beginning; its place in the file is shared by all of them."""
        os.lseek(self.fd, 0, os.SEEK_SET)
        return os.dup(self.fd)

    def lines(self) -> Iterator[bytes]:
        """Its whole lines."""
        with open(self.descriptor(), "rb") as file:
            while (line := file.readline(_LONGEST)).endswith(b"\n"):
                yield line

    def name_it(self, name: str, overwrite: bool) -> None:
        """Gives it its name, which is then `name`. Raises FileExistsError without `overwrite`, and OSError."""
        if not self.is_there():
            raise FileNotFoundError(errno.ENOENT, _REMOVED)
        put(self.name, name, overwrite, self.folder.fd)
        self.name = name

    def rename_back(self, name: str) -> None:
        """Takes the name from it again."""
        os.replace(self.name, name, src_dir_fd=self.folder.fd, dst_dir_fd=self.folder.fd)
        self.name = name

    def is_there(self) -> bool:
        """Whether its name still is its own."""
        with suppress(OSError):
            found = os.stat(self.name, dir_fd=self.folder.fd, follow_symlinks=False)
            return os.path.samestat(found, os.fstat(self.fd))
        return False

    def close(self) -> None:
        if not self._closed:
            self._closed = True
            os.close(self.fd)

    def discard(self) -> None:
        """Removes it, if it has its hidden name still and the folder lets it."""
        if not self._closed:
            if self.is_there():
                with suppress(OSError):
                    os.unlink(self.name, dir_fd=self.folder.fd)
            self.close()


def _is_ours(found: os.stat_result) -> bool:
    return stat.S_ISREG(found.st_mode) and found.st_uid == os.geteuid() and found.st_nlink == 1


def new_stem(target: Path) -> str:
    """What the names of the parts of a new file begin with: nobody can guess it."""
    return f".{target.name}.{os.getpid()}.{secrets.token_hex(8)}"


@dataclass(frozen=True, slots=True)
class PartialFiles:
    """What lies beside a target under names of partial files."""

    stems: list[str]
    """Of our own: of recordings that were killed, and of those that are under way."""
    others: list[str]
    """What others put there, or links: never opened."""


def partial_files_of(target: Path) -> PartialFiles:
    """The partial files beside a target."""
    name = re.escape(target.name)
    part, ours = re.compile(rf"\.{name}\..*\.part"), re.compile(rf"(\.{name}\.\d+\.[0-9a-f]{{16}})\.part")
    stems, others = [], []
    try:
        folder = Folder(target.parent)
    except OSError:
        return PartialFiles([], [])
    try:
        for found in sorted(filter(part.fullmatch, folder.names())):
            match = ours.fullmatch(found)
            with suppress(FileNotFoundError):
                if match and _is_ours(os.stat(found, dir_fd=folder.fd, follow_symlinks=False)):
                    stems.append(match[1])
                else:
                    others.append(found)
    finally:
        folder.close()
    return PartialFiles(stems, others)


def write_file(target: Path, data: bytes, overwrite: bool, synced: bool = False) -> Path:
    """Writes a file whole, or leaves what is there as it is; where it is: NAME-2.ENDING and so on where the name is
    taken, with `overwrite` by what is no regular file. `synced`: it is on disk then. Raises OSError."""
    folder = Folder(target.parent)
    try:
        part = PartialFile(folder, f"{new_stem(target)}.part")
        try:
            part.append(data)
            if synced:
                os.fsync(part.fd)
            number = 1
            while True:
                placed = numbered(target, number)
                try:
                    part.name_it(placed.name, overwrite and placed == target)
                except FileExistsError:
                    number += 1
                else:
                    part.close()
                    return placed
        finally:
            part.discard()
    finally:
        folder.close()


def check_new(target: str, overwrite: bool) -> None:
    """Raises HapticdError for an output that would replace a file unasked or what is no regular file, or has no folder
    to go to."""
    check_regular(target)
    if os.path.exists(target) and not overwrite:
        raise HapticdError(f"{target}: is there already; give another name, or --overwrite")
    folder = os.path.dirname(target) or "."
    if not os.path.isdir(folder):
        raise HapticdError(f"{target}: cannot be written: there is no folder {folder}")


def write_whole(path: str, content: str | bytes, overwrite: bool, synced: bool = False) -> None:
    """Writes a file, or leaves the one that is there as it is. `synced`: it is on disk then. Raises HapticdError.

    The end of a link is written, and the link stays. A file that has appeared since `check_new` keeps its name without
    `overwrite`; what was to be written then gets the next free one, which the error says.
    """
    data = content.encode() if isinstance(content, str) else content
    target = resolved(path)
    try:
        placed = write_file(target, data, overwrite, synced)
    except OSError as error:
        raise HapticdError(f"{path}: cannot be written: {error.strerror}") from None
    if placed != target:
        raise HapticdError(displaced(path, placed))
