"""The runtime directory while a daemon owns it: its lock, and the sockets that are bound in it.

The directory and the file `hapticd.lock` are locked with flock(2). systemd-tmpfiles leaves a locked directory alone,
with all that is in it, and elsewhere a socket of a name that /proc/net/unix has. So sockets are bound under their own
names: between bind(2) and listen(2) a client is refused, and tries again. At its end a daemon removes only those files
that are still the ones that it made.
"""

from __future__ import annotations

import fcntl
import logging
import os
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from hapticd.base.errors import HapticdError
from hapticd.system.paths import RuntimePaths, make_directory

CHECK_EVERY_S: Final = 1.0

_BACKLOG: Final = 128
"""Connections that may wait to be accepted."""

_log = logging.getLogger("hapticd")


@dataclass(slots=True)
class Owned:
    """The runtime directory of a running daemon."""

    paths: RuntimePaths
    _files: dict[Path, tuple[int, int]] = field(default_factory=dict)
    """Each file that this daemon made: its device and inode."""
    _due_s: float = 0.0

    def note(self, path: Path) -> None:
        """Remembers that the file at `path` is ours."""
        self._files[path] = _identity(path)

    def listen(self, path: Path) -> socket.socket:
        """A socket that listens at `path`, in place of what a killed daemon left there. Raises HapticdError."""
        try:
            path.unlink(missing_ok=True)
            with ExitStack() as stack:
                own = stack.enter_context(
                    socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK)
                )
                os.fchmod(own.fileno(), 0o660)  # the file's mode, from its first moment
                own.bind(os.fspath(path))
                self.note(path)  # before anybody can be connected: who is may replace the file
                own.listen(_BACKLOG)
                stack.pop_all()
                return own
        except OSError as error:
            raise HapticdError(f"{path}: cannot be bound: {error.strerror}") from None

    def remove(self, path: Path) -> None:
        """Removes the file at `path` if it is still ours."""
        if self.is_ours(path):
            path.unlink(missing_ok=True)

    def is_ours(self, path: Path) -> bool:
        """Whether the file at `path` is the one that this daemon made."""
        try:
            return self._files.get(path) == _identity(path)
        except OSError:
            return False

    def check(self) -> None:
        """Logs once of each file that somebody removed or replaced. Looks once a second, however often it is called."""
        if time.monotonic() < self._due_s:
            return
        self._due_s = time.monotonic() + CHECK_EVERY_S
        for path in [path for path in self._files if not self.is_ours(path)]:
            del self._files[path]
            _log.error("%s: was removed or replaced by another process; restart the daemon to make it again", path)


@contextmanager
def owned(paths: RuntimePaths) -> Iterator[Owned]:
    """The runtime directory, made if it is missing, ours alone while the context lasts.

    Raises HapticdError where another daemon holds it.
    """
    make_directory(paths)
    with (
        _opened(paths.directory, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW) as directory,
        _opened(paths.lock, os.O_CREAT | os.O_RDWR | os.O_NOFOLLOW) as lock,
    ):
        if not _lock(lock):
            holder = os.pread(lock, 32, 0).decode("ascii", "replace").strip() or "unknown"
            raise HapticdError(
                f"another daemon (process {holder}) runs on {paths.directory}; stop it, or choose another "
                "directory with --runtime-dir"
            )
        if not _lock(directory):
            raise HapticdError(
                f"runtime directory {paths.directory}: is locked by another process, perhaps by a daemon whose "
                f"{paths.lock.name} was removed; stop that one, or choose another directory with --runtime-dir"
            )
        os.ftruncate(lock, 0)
        os.pwrite(lock, f"{os.getpid()}\n".encode(), 0)
        mine = Owned(paths)
        mine.note(paths.lock)
        try:
            yield mine
        finally:
            for path in (paths.command, paths.telemetry):
                mine.remove(path)


def _lock(descriptor: int) -> bool:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


@contextmanager
def _opened(path: Path, flags: int) -> Iterator[int]:
    try:
        descriptor = os.open(path, flags | os.O_CLOEXEC, 0o600)
    except OSError as error:
        raise HapticdError(f"{path}: {error.strerror}") from None
    try:
        yield descriptor
    finally:
        os.close(descriptor)


def _identity(path: Path) -> tuple[int, int]:
    status = os.lstat(path)
    return status.st_dev, status.st_ino
