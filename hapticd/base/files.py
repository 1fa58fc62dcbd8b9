"""Where a file may be written, and giving a finished file its name: what somebody else put there stays."""

from __future__ import annotations

import errno
import os
import stat
from contextlib import suppress
from pathlib import Path
from typing import Final

from hapticd.base.errors import HapticdError

_NO_HARD_LINKS: Final = frozenset((errno.EPERM, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK, errno.EINVAL))
_NOT_REGULAR: Final = {
    stat.S_IFBLK: "a block device",
    stat.S_IFCHR: "a character device",
    stat.S_IFDIR: "a directory",
    stat.S_IFIFO: "a FIFO (named pipe)",
    stat.S_IFSOCK: "a socket",
}


def _not_regular(path: str | os.PathLike[str], folder: int | None = None) -> str | None:
    """What is there, links followed to their end; None for a regular file, or nothing."""
    with suppress(OSError):
        return _NOT_REGULAR.get(stat.S_IFMT(os.stat(path, dir_fd=folder).st_mode))
    return None


def check_regular(path: str | os.PathLike[str]) -> None:
    """Raises HapticdError where something is at `path`, links followed to their end, that is no regular file."""
    found = _not_regular(path)
    if found is not None:
        raise HapticdError(f"{os.fspath(path)}: is there already and is {found}, no regular file; give another name")


def is_there(name: str | os.PathLike[str]) -> HapticdError:
    """What to say of a name that is taken."""
    return HapticdError(
        f"{os.fspath(name)}: is there already; give another name, or --overwrite (in Python overwrite=True)"
    )


def put(part: str, target: str, overwrite: bool, folder: int) -> None:
    """Renames `part`, a whole file in `folder` (a descriptor), to `target`, another name there.

    It raises FileExistsError where the name is taken, also since just now: by anything, or with `overwrite` by what is
    no regular file. Then `part` is as it was. Raises OSError.
    """
    if overwrite and _not_regular(target, folder) is None:
        os.replace(part, target, src_dir_fd=folder, dst_dir_fd=folder)
        return
    try:
        # A link is refused where the name is taken; a rename would replace what has it.
        os.link(part, target, src_dir_fd=folder, dst_dir_fd=folder, follow_symlinks=False)
    except OSError as error:
        if error.errno not in _NO_HARD_LINKS:
            raise
        # This file system has no hard links: an empty file holds the name for the rename.
        empty = os.O_CREAT | os.O_EXCL | os.O_WRONLY | os.O_NOFOLLOW | os.O_CLOEXEC
        os.close(os.open(target, empty, 0o666, dir_fd=folder))
        try:
            os.replace(part, target, src_dir_fd=folder, dst_dir_fd=folder)
        except OSError:
            os.unlink(target, dir_fd=folder)
            raise
    else:
        os.unlink(part, dir_fd=folder)


def create(path: str | os.PathLike[str], text: str, mode: int) -> None:
    """A new file, on disk and whole, or none. Raises OSError; FileExistsError where the name is taken."""
    fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, mode)
    try:
        with os.fdopen(fd, "w") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
    except OSError:
        os.unlink(path)
        raise


def numbered(target: Path, number: int) -> Path:
    """`target` itself for 1, then NAME-2.ENDING and so on."""
    return target if number == 1 else target.with_name(f"{target.stem}-{number}{target.suffix}")


def displaced(wanted: str | os.PathLike[str], place: str | os.PathLike[str]) -> str:
    """What to say where a file is not where it was to be."""
    moved = os.path.dirname(os.path.abspath(place)) != os.path.dirname(os.path.realpath(wanted))
    why = "its folder was renamed" if moved else "another file has appeared there"
    return f"{os.fspath(wanted)}: {why} meanwhile; what was written is in {os.fspath(place)}"
