"""The runtime directory, in which a daemon and its clients meet: its path, its file names, and its ownership.

The directory is the one that was given, else `$HAPTICD_RUNTIME_DIR`, else `$RUNTIME_DIRECTORY` (set by systemd), else
`$XDG_RUNTIME_DIR/hapticd`, else `/tmp/hapticd-UID`. Only the directory's owner can put sockets into it, so a client
that connects to one of them reaches the daemon of that owner.

A daemon locks the directory with flock(2). systemd-tmpfiles does not clean a locked directory, nor a socket whose path
is listed in /proc/net/unix. Therefore sockets are bound under their final names; between bind(2) and listen(2) a client
is refused and tries again. At its end a daemon removes a file only if it is still the file that it created.
"""

from __future__ import annotations

import fcntl
import logging
import os
import socket
import stat
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from hapticd.base.errors import HapticdError

SYSTEM_DIRECTORY: Final = Path("/run/hapticd")
"""The runtime directory of the system service; systemd creates it and removes it with the service."""
_MAX_SOCKET_PATH_BYTES: Final = 107
"""The longest path of a socket: sockaddr_un has room for 108 bytes, the last of which is NUL."""
_LISTEN_BACKLOG: Final = 128
"""Connections that may wait to be accepted."""
_OWNERSHIP_CHECK_INTERVAL_S: Final = 1.0
"""Interval at which a daemon checks whether its files were removed or replaced."""

_log = logging.getLogger("hapticd")


@dataclass(frozen=True, slots=True)
class RuntimePaths:
    """The files of one runtime directory."""

    directory: Path

    @property
    def command(self) -> Path:
        """The socket for clients' commands (ROUTER). It is bound last: once it exists, the daemon is ready."""
        return self.directory / "hapticd.command"

    @property
    def telemetry(self) -> Path:
        """The socket on which the daemon publishes telemetry (PUB)."""
        return self.directory / "hapticd.telemetry"

    @property
    def lock(self) -> Path:
        """The file with the daemon's process number. The daemon's lock, flock(2), is on the directory."""
        return self.directory / "hapticd.lock"

    @property
    def device(self) -> Path:
        """The reports that stop the daemon's device (hid/stopper.py); the file remains if the daemon is killed."""
        return self.directory / "hapticd.device"

    @property
    def command_endpoint(self) -> str:
        """The command socket as ZeroMQ names it."""
        return f"ipc://{self.command}"

    @property
    def telemetry_endpoint(self) -> str:
        """The telemetry socket as ZeroMQ names it."""
        return f"ipc://{self.telemetry}"


def runtime_paths(directory: str | os.PathLike[str] | None = None) -> RuntimePaths:
    """Return the files of a runtime directory, by default of the one that the environment selects.

    Raises HapticdError if the path of a socket would be too long or not UTF-8.
    """
    environ = os.environ
    # systemd separates several directories by colons; the first is the runtime directory.
    given = environ.get("RUNTIME_DIRECTORY", "").split(":")[0]
    named = directory or environ.get("HAPTICD_RUNTIME_DIR") or given
    if named:
        chosen = Path(named)
    elif environ.get("XDG_RUNTIME_DIR"):
        chosen = Path(environ["XDG_RUNTIME_DIR"], "hapticd")
    else:
        chosen = Path(f"/tmp/hapticd-{os.getuid()}")
    paths = RuntimePaths(chosen.absolute())
    try:
        os.fspath(paths.directory).encode("utf-8")
    except UnicodeEncodeError:
        raise HapticdError("runtime directory: its path must be UTF-8, or ZeroMQ cannot connect to it") from None
    longest = max(len(os.fsencode(paths.command)), len(os.fsencode(paths.telemetry)))
    if longest > _MAX_SOCKET_PATH_BYTES:
        raise HapticdError(
            f"runtime directory {chosen}: path too long: the paths of its sockets may have at most "
            f"{_MAX_SOCKET_PATH_BYTES} bytes, they would have {longest} bytes"
        )
    return paths


def check_directory(paths: RuntimePaths) -> None:
    """Raise HapticdError unless the path is a directory, not a symbolic link, that only this user may write."""
    try:
        status = os.lstat(paths.directory)
    except OSError as error:
        raise HapticdError(f"runtime directory {paths.directory}: {error.strerror}") from None
    problem, mode = None, stat.S_IMODE(status.st_mode)
    if not stat.S_ISDIR(status.st_mode):
        problem = "must be a directory, not a symbolic link"
    elif status.st_uid != os.geteuid():
        problem = f"belongs to user {status.st_uid}, not to {os.geteuid()}"
    elif mode & 0o022:
        problem = f"other users may write to it (mode {mode:04o}); its mode must be 0750 or 0700"
    if problem:
        raise HapticdError(f"runtime directory {paths.directory}: {problem}")


def daemon_paths(directory: str | os.PathLike[str] | None = None) -> RuntimePaths:
    """Return the files of the runtime directory of the daemon that a client connects to.

    A directory that is given, or that the environment names, is not checked, because a system daemon's directory
    belongs to the daemon's user. Any user could have created the default directory, below /tmp: raises HapticdError
    unless it belongs to this user.
    """
    paths = runtime_paths(directory)
    named = directory or any(map(os.environ.get, ("HAPTICD_RUNTIME_DIR", "RUNTIME_DIRECTORY", "XDG_RUNTIME_DIR")))
    if not named and os.path.lexists(paths.directory):
        check_directory(paths)
    return paths


# ---- Ownership by a daemon -------------------------------------------------------------------------------------------


@dataclass(slots=True)
class Owned:
    """The runtime directory of a running daemon, and the files that this daemon created in it."""

    paths: RuntimePaths
    _files: dict[Path, tuple[int, int]] = field(default_factory=dict)
    """Device and inode of each file that this daemon created."""
    _due_s: float = 0.0

    def note(self, path: Path) -> None:
        """Register the file at `path` as created by this daemon."""
        self._files[path] = _identity(path)

    def listen(self, path: Path) -> socket.socket:
        """Return a socket that listens at `path`; a socket that a killed daemon left there is replaced.

        Raises HapticdError if the socket cannot be bound.
        """
        own = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK)
        try:
            path.unlink(missing_ok=True)
            os.fchmod(own.fileno(), 0o660)  # so the file has this mode from its creation on
            own.bind(os.fspath(path))
            self.note(path)  # before the first client connects, which could replace the file
            own.listen(_LISTEN_BACKLOG)
        except OSError as error:
            own.close()
            raise HapticdError(f"{path}: cannot bind the socket: {error.strerror}") from None
        return own

    def remove(self, path: Path) -> None:
        """Remove the file at `path` if this daemon created that file."""
        if self.is_ours(path):
            path.unlink(missing_ok=True)

    def is_ours(self, path: Path) -> bool:
        """Return whether the file at `path` is the one that this daemon created."""
        try:
            return self._files.get(path) == _identity(path)
        except OSError:
            return False

    def check(self) -> None:
        """Log each of the daemon's files that was removed or replaced, once; does nothing within 1 s of a check."""
        if time.monotonic() < self._due_s:
            return
        self._due_s = time.monotonic() + _OWNERSHIP_CHECK_INTERVAL_S
        for path in [path for path in self._files if not self.is_ours(path)]:
            del self._files[path]
            _log.error("%s: removed or replaced by another process; restart the daemon to create it again", path)


@contextmanager
def owned(paths: RuntimePaths) -> Iterator[Owned]:
    """Create the runtime directory if it is missing, and lock it while the context lasts.

    Raises HapticdError if another daemon has locked it.
    """
    _make_directory(paths)
    mine = Owned(paths)
    with ExitStack() as stack:
        try:
            directory = os.open(paths.directory, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
            stack.callback(os.close, directory)
            fcntl.flock(directory, fcntl.LOCK_EX | fcntl.LOCK_NB)
            paths.lock.write_text(f"{os.getpid()}\n")
            mine.note(paths.lock)
        except BlockingIOError:
            holder = paths.lock.read_text(errors="replace").strip() if paths.lock.exists() else "unknown"
            raise HapticdError(
                f"another daemon (process {holder}) uses {paths.directory}; stop it, or choose another "
                "directory with --runtime-dir"
            ) from None
        except OSError as error:
            raise HapticdError(f"{error.filename or paths.directory}: {error.strerror}") from None
        for path in (paths.telemetry, paths.command):
            stack.callback(mine.remove, path)
        yield mine


def _make_directory(paths: RuntimePaths) -> None:
    """Create the runtime directory and its parents with mode 0700, or accept one that `check_directory` accepts.

    An existing directory keeps the mode 0750 or 0700, set by systemd or an administrator; any other becomes 0700.
    """
    try:
        for folder in reversed((paths.directory, *paths.directory.parents)):
            if not folder.exists():
                with suppress(FileExistsError):
                    folder.mkdir(mode=0o700)
        check_directory(paths)
        if stat.S_IMODE(os.lstat(paths.directory).st_mode) not in (0o700, 0o750):
            paths.directory.chmod(0o700)
    except OSError as error:
        raise HapticdError(f"runtime directory {paths.directory}: {error.filename}: {error.strerror}") from None


def _identity(path: Path) -> tuple[int, int]:
    status = os.lstat(path)
    return status.st_dev, status.st_ino
