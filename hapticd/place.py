"""Giving a finished file its name, without replacing a file that somebody else put there meanwhile."""

from __future__ import annotations

import errno
import os
from contextlib import suppress
from itertools import count
from pathlib import Path
from typing import Final

from hapticd.errors import HapticdError

_NO_HARD_LINKS: Final = frozenset((errno.EPERM, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK, errno.EINVAL))


def is_there(name: str | os.PathLike[str]) -> HapticdError:
    """What to say of a name that is taken."""
    return HapticdError(
        f"{os.fspath(name)}: is there already; give another name, or --overwrite (in Python overwrite=True)"
    )


def put(part: str | os.PathLike[str], target: str | os.PathLike[str], overwrite: bool) -> None:
    """Renames `part`, a whole file in the folder of `target`, to `target`.

    Without `overwrite` it raises FileExistsError where there is a file of that name, also one that has appeared just
    now; then `part` is as it was. Raises OSError.
    """
    if overwrite:
        os.replace(part, target)
        return
    try:
        # A link is refused where the name is taken; a rename would replace what has it.
        os.link(part, target)
    except OSError as error:
        if error.errno not in _NO_HARD_LINKS:
            raise
        # This file system has no hard links: an empty file holds the name for the rename.
        os.close(os.open(target, os.O_CREAT | os.O_EXCL | os.O_WRONLY | os.O_CLOEXEC, 0o666))
        try:
            os.replace(part, target)
        except OSError:
            os.unlink(target)
            raise
    else:
        os.unlink(part)


def place(part: Path, target: Path, overwrite: bool) -> Path:
    """As `put`, but where the name is taken under the first of NAME-2.ENDING, NAME-3.ENDING and so on that is free;
    returns where it is. Raises OSError."""
    for number in count(1):
        with suppress(FileExistsError):
            put(part, numbered(target, number), overwrite)
            return numbered(target, number)
    raise AssertionError


def numbered(target: Path, number: int) -> Path:
    """`target` itself for 1, then NAME-2.ENDING and so on."""
    return target if number == 1 else target.with_name(f"{target.stem}-{number}{target.suffix}")


def displaced(wanted: str | os.PathLike[str], place: str | os.PathLike[str]) -> str:
    """What to say where another file had appeared at the place of one that was being written."""
    return f"{os.fspath(wanted)}: another file has appeared there meanwhile; what was written is in {os.fspath(place)}"
