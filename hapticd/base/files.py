"""Giving a finished file its name, without replacing a file that somebody else put there meanwhile."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import Final

from hapticd.base.errors import HapticdError

_NO_HARD_LINKS: Final = frozenset((errno.EPERM, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK, errno.EINVAL))


def is_there(name: str | os.PathLike[str]) -> HapticdError:
    """What to say of a name that is taken."""
    return HapticdError(
        f"{os.fspath(name)}: is there already; give another name, or --overwrite (in Python overwrite=True)"
    )


def put(part: str, target: str, overwrite: bool, folder: int) -> None:
    """Renames `part`, a whole file in `folder` (a descriptor), to `target`, another name there.

    Without `overwrite` it raises FileExistsError where there is a file of that name, also one that has appeared just
    now; then `part` is as it was. Raises OSError.
    """
    if overwrite:
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


def numbered(target: Path, number: int) -> Path:
    """`target` itself for 1, then NAME-2.ENDING and so on."""
    return target if number == 1 else target.with_name(f"{target.stem}-{number}{target.suffix}")


def displaced(wanted: str | os.PathLike[str], place: str | os.PathLike[str]) -> str:
    """What to say where a file is not where it was to be."""
    moved = os.path.dirname(os.path.abspath(place)) != os.path.dirname(os.path.realpath(wanted))
    why = "its folder was renamed" if moved else "another file has appeared there"
    return f"{os.fspath(wanted)}: {why} meanwhile; what was written is in {os.fspath(place)}"
