"""What is no regular file, in a folder of the test's own: no command may write there, nor put a file in its place."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

KINDS = {
    "folder": "a directory",
    "FIFO": "a FIFO (named pipe)",
    "socket": "a socket",
    "device": "a character device",
}
"""Each kind, and what an error says of it."""
_TYPES = {"FIFO": stat.S_IFIFO, "socket": stat.S_IFSOCK, "device": stat.S_IFCHR}


def special(path: Path, kind: str) -> str:
    """Makes one; what an error says of an output there. The device is one of our own that swallows all, as /dev/null
    does; a test is skipped where the user may make none."""
    if kind == "folder":
        path.mkdir()
    else:
        try:
            os.mknod(path, _TYPES[kind] | 0o600, os.makedev(1, 3))
        except PermissionError:
            pytest.skip("only root may make a device node")
    return refused(path, kind)


def refused(path: str | os.PathLike[str], kind: str) -> str:
    """What an error says of an output at `path`, which is one or leads to one."""
    return f"{os.fspath(path)}: is there already and is {KINDS[kind]}, no regular file; give another name"


def kept_open(path: Path) -> int:
    """Somebody who has a FIFO open: whoever opens it, to write or to read, need not wait."""
    return os.open(path, os.O_RDWR | os.O_NONBLOCK)


def seen(folder: Path) -> dict[str, tuple[int, int]]:
    """Everything below a folder: the same name stands for the same node before and after."""
    return {str(path): (path.lstat().st_ino, path.lstat().st_mode) for path in folder.rglob("*")}
