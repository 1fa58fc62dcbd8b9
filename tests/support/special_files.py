"""What is no regular file, in a folder of the test's own: no command may write there, nor put a file in its place."""

from __future__ import annotations

import fcntl
import os
import stat
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
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
    return f"{os.fspath(path)}: not a regular file but {KINDS[kind]}; give another name"


@contextmanager
def untouched(folder: Path, *made: str) -> Iterator[None]:
    """All below `folder` is afterwards what it was before, with nothing beside it but what is `made`. Nobody waits for
    a FIFO meanwhile, and nobody may write to one."""
    before = _nodes(folder)
    with ExitStack() as held:
        ends = [os.open(path, os.O_RDWR | os.O_NONBLOCK) for path in folder.rglob("*") if _is_fifo(path)]
        for end in ends:
            held.callback(os.close, end)
            fcntl.fcntl(end, fcntl.F_SETPIPE_SZ, 1 << 20)
        yield
        for end in ends:
            with pytest.raises(BlockingIOError):
                os.read(end, 1)
    after = _nodes(folder)
    assert after.keys() - before.keys() == {str(folder / name) for name in made}
    assert before.items() <= after.items()


def _is_fifo(path: Path) -> bool:
    return stat.S_ISFIFO(path.lstat().st_mode)


def _nodes(folder: Path) -> dict[str, tuple[int, int]]:
    return {str(path): (path.lstat().st_ino, path.lstat().st_mode) for path in folder.rglob("*")}
