"""Files that appear whole or not at all: written under a hidden name beside the target, which they then get.

A file that is there is replaced only where that is asked for. What is no regular file is never written to nor replaced:
no device, no pipe, no folder. A link stays, and its end is written.
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
_NEW_FILE_FLAGS: Final = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
_NOT_REGULAR: Final = {
    stat.S_IFBLK: "a block device",
    stat.S_IFCHR: "a character device",
    stat.S_IFDIR: "a directory",
    stat.S_IFIFO: "a FIFO (named pipe)",
    stat.S_IFSOCK: "a socket",
}


def _not_regular(path: str | os.PathLike[str]) -> str | None:
    """What is there, links followed to their end; None for a regular file, or nothing. Raises OSError where the system
    refuses to follow: another user's link in a folder that everybody may write to."""
    try:
        return _NOT_REGULAR.get(stat.S_IFMT(os.stat(path).st_mode))
    except FileNotFoundError:
        return None


def check_regular(path: str | os.PathLike[str]) -> None:
    """Raises HapticdError where something is at `path`, links followed to their end, that is no regular file."""
    try:
        found = _not_regular(path)
    except OSError as error:
        raise _unwritable(path, error) from None
    if found is not None:
        raise HapticdError(f"{os.fspath(path)}: is there already and is {found}, no regular file; give another name")


def check_new(path: str | os.PathLike[str], overwrite: bool) -> None:
    """Raises HapticdError for an output that would replace a file unasked or what is no regular file, or has no folder
    to go to."""
    name = os.fspath(path)
    check_regular(name)
    if os.path.exists(name) and not overwrite:
        raise HapticdError(f"{name}: is there already; give another name, or --overwrite (in Python overwrite=True)")
    folder = os.path.dirname(name) or "."
    if not os.path.isdir(folder):
        raise HapticdError(f"{name}: cannot be written: there is no folder {folder}")


def write_whole(
    path: str | os.PathLike[str], content: str | bytes, overwrite: bool, *, mode: int = 0o666, synced: bool = False
) -> None:
    """Writes a file, as `whole_file` does. Raises HapticdError."""
    with whole_file(path, overwrite, mode=mode, synced=synced) as file:
        file.write(content.encode() if isinstance(content, str) else content)


@contextmanager
def whole_file(
    path: str | os.PathLike[str], overwrite: bool, *, mode: int = 0o666, synced: bool = False
) -> Iterator[BinaryIO]:
    """A file to write to, which is at `path` once the block is over; where that fails, `path` is as it was.

    `synced`: it is on disk then. A file that has appeared at `path` since `check_new` keeps its name without
    `overwrite`; the new one then gets the next free name, which the error says. Raises HapticdError.
    """
    check_regular(path)
    target = Path(os.path.realpath(path))
    part = hidden_beside(target)
    try:
        try:
            with create(part, mode) as file:
                yield file
                file.flush()
                if synced:
                    os.fsync(file.fileno())
            placed = give_name(part, target, overwrite)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        raise _unwritable(path, error) from None
    if placed != target:
        raise HapticdError(displaced(path, placed))


def hidden_beside(target: Path) -> Path:
    """A name in the target's folder that nobody else has: `.NAME.PROCESS.RANDOM.part`."""
    return target.with_name(f".{target.name}.{os.getpid()}.{secrets.token_hex(8)}.part")


def create(path: Path, mode: int = 0o666, buffering: int = -1) -> BinaryIO:
    """A new file to write and read. Raises OSError, FileExistsError where something has its name."""
    return open(path, "w+b", buffering, opener=lambda name, _: os.open(name, _NEW_FILE_FLAGS, mode))


def give_name(part: Path, target: Path, overwrite: bool) -> Path:
    """Renames a finished file to `target`; where it is: NAME-2.ENDING and so on where the name is taken, with
    `overwrite` by what is no regular file. Raises OSError; then `part` is as it was."""
    for number in count(1):
        place = target if number == 1 else target.with_name(f"{target.stem}-{number}{target.suffix}")
        try:
            _rename(part, place, overwrite and number == 1)
            return place
        except FileExistsError:
            continue
    raise AssertionError("count() has no end")


def _rename(part: Path, place: Path, overwrite: bool) -> None:
    """Raises FileExistsError where the name is taken, also since just now."""
    if overwrite and _not_regular(place) is None:
        os.replace(part, place)
        return
    try:
        # A link is refused where the name is taken; a rename would replace what has it.
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
        # The file has its name; that the hidden one stays does no harm, and whoever fails here must not undo the other.
        with suppress(OSError):
            part.unlink()


def displaced(wanted: str | os.PathLike[str], place: str | os.PathLike[str]) -> str:
    """What to say where a file has another name than it was to have."""
    return f"{os.fspath(wanted)}: another file has appeared there meanwhile; what was written is in {os.fspath(place)}"


def _unwritable(path: str | os.PathLike[str], error: OSError) -> HapticdError:
    return HapticdError(f"{os.fspath(path)}: cannot be written: {error.strerror}")
