"""Files that are obeyed (keys, passwords, what stops a device): read where only root and ourselves may change them."""

from __future__ import annotations

import os
import stat
from typing import Final

from hapticd.base.errors import HapticdError, on_one_line

_OTHERS_CHANGE: Final = stat.S_IWGRP | stat.S_IWOTH
_OTHERS_READ: Final = stat.S_IRWXO | stat.S_IXGRP


def read_trusted(path: str | os.PathLike[str], most: int, *, secret: bool = False) -> bytes:
    """The bytes of a regular file, one more than `most` at the most, so that a larger one shows.

    Its owner must be root or the user that we run as, and nobody else may write to it. Nor may others read one that is
    `secret`, except for its group. Owner and mode are those of the file that is read. Raises HapticdError.
    """
    name = on_one_line(os.fspath(path))
    try:
        # A pipe that nobody writes to is not waited for.
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
        with os.fdopen(descriptor, "rb") as file:
            status = os.fstat(descriptor)
            if not stat.S_ISREG(status.st_mode):
                raise HapticdError(f"{name}: must be a regular file")
            if status.st_uid not in (0, os.geteuid()):
                raise HapticdError(f"{name}: belongs to user {status.st_uid}; it must belong to root or to us")
            mode = stat.S_IMODE(status.st_mode)
            if mode & _OTHERS_CHANGE:
                raise HapticdError(f"{name}: others may change it (mode {mode:04o}): chmod go-w")
            if secret and mode & _OTHERS_READ:
                raise HapticdError(
                    f"{name}: others may read it (mode {mode:04o}): chmod 600, or 640 for a service's group"
                )
            return file.read(most + 1)
    except OSError as error:
        raise HapticdError(f"{name}: cannot be read: {error.strerror}") from None
