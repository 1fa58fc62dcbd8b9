"""Files that are written atomically: under a hidden name in the target's folder, then renamed to the target.

An existing file is replaced only on request. A device, a pipe or a folder is never written to nor replaced. If the
target is a symbolic link, the file that it leads to is written.
"""

from __future__ import annotations

import errno
import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path
from typing import BinaryIO, Final

from hapticd.base.errors import HapticdError

_NO_HARD_LINKS: Final = frozenset((errno.EPERM, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK, errno.EINVAL))
"""Errors of os.link on a file system without hard links."""
_NEW_FILE_FLAGS: Final = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
_NOT_REGULAR: Final = {
    stat.S_IFBLK: "a block device",
    stat.S_IFCHR: "a character device",
    stat.S_IFDIR: "a directory",
    stat.S_IFIFO: "a FIFO (named pipe)",
    stat.S_IFSOCK: "a socket",
}


def _not_regular(path: str | os.PathLike[str]) -> str | None:
    """Return the kind of `path` after links are followed; None if it is a regular file or does not exist.

    Raises OSError if the system refuses to follow a link, such as another user's in a world-writable folder.
    """
    try:
        return _NOT_REGULAR.get(stat.S_IFMT(os.stat(path).st_mode))
    except FileNotFoundError:
        return None


def check_regular(path: str | os.PathLike[str]) -> None:
    """Raise HapticdError if `path`, after links are followed, exists and is not a regular file."""
    try:
        found = _not_regular(path)
    except OSError as error:
        raise _unwritable(path, error) from None
    if found is not None:
        raise HapticdError(f"{os.fspath(path)}: not a regular file but {found}; give another name")


def check_new(path: str | os.PathLike[str], overwrite: bool) -> None:
    """Raise HapticdError if an output cannot be written to `path`.

    The reasons: a file exists and `overwrite` is False, `path` is not a regular file, or its folder does not exist.
    """
    name = os.fspath(path)
    check_regular(name)
    if os.path.exists(name) and not overwrite:
        raise HapticdError(f"{name}: already exists; give another name, or --overwrite (in Python overwrite=True)")
    folder = os.path.dirname(name) or "."
    if not os.path.isdir(folder):
        raise HapticdError(f"{name}: cannot be written: the folder {folder} does not exist")


def write_atomically(
    path: str | os.PathLike[str], content: str | bytes, overwrite: bool, *, mode: int = 0o666, synced: bool = False
) -> None:
    """Write a file atomically, with the arguments of `atomic_file`. Raises HapticdError."""
    with atomic_file(path, overwrite, mode=mode, synced=synced) as file:
        file.write(content.encode() if isinstance(content, str) else content)


@contextmanager
def atomic_file(
    path: str | os.PathLike[str], overwrite: bool, *, mode: int = 0o666, synced: bool = False
) -> Iterator[BinaryIO]:
    """Open a file to write, which gets the name `path` at the end of the `with` block; on failure `path` is unchanged.

    With `synced` the data are on disk before the file gets its name. If `path` is taken and `overwrite` is False, the
    file gets the next free name, and a HapticdError with this name is raised.
    """
    check_regular(path)
    target = Path(os.path.realpath(path))
    part = temporary_path(target)
    try:
        try:
            with create(part, mode) as file:
                yield file
                file.flush()
                if synced:
                    os.fsync(file.fileno())
            placed = rename_to_free_name(part, target, overwrite)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        raise _unwritable(path, error) from None
    if placed != target:
        raise HapticdError(displaced(path, placed))


def temporary_path(target: Path) -> Path:
    """Return an unused hidden path in the folder of the file `target`: `.NAME.PROCESS.RANDOM.part`."""
    return target.with_name(f".{target.name}.{os.getpid()}.{secrets.token_hex(8)}.part")


def create(path: Path, mode: int = 0o666, buffering: int = -1) -> BinaryIO:
    """Create a file to write and read. Raises OSError: FileExistsError if the name is taken."""
    return open(path, "w+b", buffering, opener=lambda name, _: os.open(name, _NEW_FILE_FLAGS, mode))


def rename_to_free_name(part: Path, target: Path, overwrite: bool) -> Path:
    """Rename the file `part` to `target`, or if that name is taken, to NAME-2.ENDING and so on; return the new path.

    With `overwrite` a regular file at `target` is replaced. If OSError is raised, `part` is unchanged.
    """
    for number in count(1):
        place = target if number == 1 else target.with_name(f"{target.stem}-{number}{target.suffix}")
        try:
            _rename(part, place, overwrite and number == 1)
            return place
        except FileExistsError:
            continue
    raise AssertionError("count() has no end")


def _rename(part: Path, place: Path, overwrite: bool) -> None:
    """Rename a file to `place` without a race. Raises FileExistsError if another program has taken the name."""
    if overwrite and _not_regular(place) is None:
        os.replace(part, place)
        return
    try:
        # A hard link fails if the name is taken; a rename would replace that file.
        os.link(part, place, follow_symlinks=False)
    except OSError as error:
        if error.errno not in _NO_HARD_LINKS:
            raise
        # This file system has no hard links: an empty file holds the name for the rename.
        create(place).close()
        try:
            os.replace(part, place)
        except OSError:
            place.unlink()
            raise
    else:
        # The file has its name. If its hidden name cannot be removed, that does no harm.
        with suppress(OSError):
            part.unlink()


def displaced(wanted: str | os.PathLike[str], place: str | os.PathLike[str]) -> str:
    """Return the message that a file was written to `place`, because the name `wanted` was taken meanwhile."""
    return f"{os.fspath(wanted)}: another program created this file meanwhile; the output is in {os.fspath(place)}"


def _unwritable(path: str | os.PathLike[str], error: OSError) -> HapticdError:
    return HapticdError(f"{os.fspath(path)}: cannot be written: {error.strerror}")
