"""Reads files that hapticd acts on (keys, passwords, reports that stop a device), if no other user may change them."""

from __future__ import annotations

import os
import stat
from typing import Final

from hapticd.base.errors import HapticdError, collapse_whitespace

_OTHERS_WRITE_BITS: Final = stat.S_IWGRP | stat.S_IWOTH
"""Bits of the mode that let other users change a file."""
_OTHERS_READ_BITS: Final = stat.S_IRWXO | stat.S_IXGRP
"""Bits of the mode that a secret file must not have; its group may read it."""


def read_trusted(path: str | os.PathLike[str], max_bytes: int, *, secret: bool = False) -> bytes:
    """Return at most `max_bytes` + 1 bytes of a regular file, so that the caller notices a file that is too large.

    The file must belong to root or to the user of this process, and no other user may write to it. A `secret` file may
    be read only by its owner and its group. Raises HapticdError.
    """
    name = collapse_whitespace(os.fspath(path))
    try:
        # O_NONBLOCK: opening a pipe without a writer must not block.
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
        with os.fdopen(descriptor, "rb") as file:
            status = os.fstat(descriptor)
            if not stat.S_ISREG(status.st_mode):
                raise HapticdError(f"{name}: not a regular file")
            if status.st_uid not in (0, os.geteuid()):
                raise HapticdError(
                    f"{name}: belongs to user {status.st_uid}; it must belong to root or to user {os.geteuid()}"
                )
            mode = stat.S_IMODE(status.st_mode)
            if mode & _OTHERS_WRITE_BITS:
                raise HapticdError(f"{name}: other users may change it (mode {mode:04o}): chmod go-w")
            if secret and mode & _OTHERS_READ_BITS:
                raise HapticdError(
                    f"{name}: other users may read it (mode {mode:04o}): chmod 600, or 640 for a service's group"
                )
            return file.read(max_bytes + 1)
    except OSError as error:
        raise HapticdError(f"{name}: cannot be read: {error.strerror}") from None
