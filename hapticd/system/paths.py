"""Where a daemon and its clients meet: the runtime directory, the names in it, and how a daemon owns it.

The directory is the one that was named, else `$HAPTICD_RUNTIME_DIR`, else `$RUNTIME_DIRECTORY` where systemd gives one,
else `$XDG_RUNTIME_DIR/hapticd`, else `/tmp/hapticd-UID`. Only the directory's owner can put sockets into it, so that
whoever connects to a name in it talks to the daemon of that owner.

A daemon locks it with flock(2). systemd-tmpfiles leaves a locked directory alone, with all that is in it, and elsewhere
a socket of a name that /proc/net/unix has. So sockets are bound under their own names: between bind(2) and listen(2) a
client is refused, and tries again. At its end a daemon removes only those files that are still the ones that it made.
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
"""The runtime directory of the service of the system. It is there while the service runs."""
_LONGEST_SOCKET_NAME: Final = 107
"""sockaddr_un has room for 108 bytes, the last of which is NUL."""
_BACKLOG: Final = 128
"""Connections that may wait to be accepted."""
_CHECK_EVERY_S: Final = 1.0

_log = logging.getLogger("hapticd")


@dataclass(frozen=True, slots=True)
class RuntimePaths:
    """The names in one runtime directory."""

    directory: Path

    @property
    def command(self) -> Path:
        """The command socket (ROUTER); it is bound last, so that its existence means ready."""
        return self.directory / "hapticd.command"

    @property
    def telemetry(self) -> Path:
        """The telemetry socket (PUB)."""
        return self.directory / "hapticd.telemetry"

    @property
    def lock(self) -> Path:
        """The daemon's process number. What it holds an flock on as long as it lives is the directory."""
        return self.directory / "hapticd.lock"

    @property
    def device(self) -> Path:
        """What stops the device that the daemon drives (stopper.py); it outlives a daemon that was killed."""
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
    """The names in `directory`, by default in the one that the environment says.

    Raises HapticdError where a socket's name would be longer than the system takes.
    """
    environ = os.environ
    # systemd lists several directories separated by colons; the first is the service's own.
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
        raise HapticdError("runtime directory: its name must be UTF-8, or ZeroMQ cannot connect to it") from None
    longest = max(len(os.fsencode(paths.command)), len(os.fsencode(paths.telemetry)))
    if longest > _LONGEST_SOCKET_NAME:
        raise HapticdError(
            f"runtime directory {chosen}: too long, the socket names in it would have {longest} bytes "
            f"(at most {_LONGEST_SOCKET_NAME})"
        )
    return paths


def check_directory(paths: RuntimePaths) -> None:
    """Raises HapticdError unless the directory exists, is no symbolic link, and is ours alone to write."""
    try:
        status = os.lstat(paths.directory)
    except OSError as error:
        raise HapticdError(f"runtime directory {paths.directory}: {error.strerror}") from None
    problem, mode = None, stat.S_IMODE(status.st_mode)
    if not stat.S_ISDIR(status.st_mode):
        problem = "must be a directory, and no symbolic link"
    elif status.st_uid != os.geteuid():
        problem = f"belongs to user {status.st_uid}, not to {os.geteuid()}"
    elif mode & 0o022:
        problem = f"others may write to it (mode {mode:04o}); it must be 0750 or 0700"
    if problem:
        raise HapticdError(f"runtime directory {paths.directory}: {problem}")


def daemon_paths(directory: str | os.PathLike[str] | None = None) -> RuntimePaths:
    """The names that a client connects to; raises HapticdError where somebody else could have put them there.

    A directory that was named, or that the environment names, is taken as it is: a system daemon's belongs
    to that daemon's user. The one under /tmp must be the user's own, since anybody could have made it.
    """
    paths = runtime_paths(directory)
    named = directory or any(map(os.environ.get, ("HAPTICD_RUNTIME_DIR", "RUNTIME_DIRECTORY", "XDG_RUNTIME_DIR")))
    if not named and os.path.lexists(paths.directory):
        check_directory(paths)
    return paths


# ---- A daemon owns it ------------------------------------------------------------------------------------------------


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
        own = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK)
        try:
            path.unlink(missing_ok=True)
            os.fchmod(own.fileno(), 0o660)  # the file's mode, from its first moment
            own.bind(os.fspath(path))
            self.note(path)  # before anybody can be connected: who is may replace the file
            own.listen(_BACKLOG)
        except OSError as error:
            own.close()
            raise HapticdError(f"{path}: cannot be bound: {error.strerror}") from None
        return own

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
        self._due_s = time.monotonic() + _CHECK_EVERY_S
        for path in [path for path in self._files if not self.is_ours(path)]:
            del self._files[path]
            _log.error("%s: was removed or replaced by another process; restart the daemon to make it again", path)


@contextmanager
def owned(paths: RuntimePaths) -> Iterator[Owned]:
    """The runtime directory, made if it is missing, ours alone while the context lasts.

    Raises HapticdError where another daemon holds it.
    """
    _make(paths)
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
                f"another daemon (process {holder}) runs on {paths.directory}; stop it, or choose another "
                "directory with --runtime-dir"
            ) from None
        except OSError as error:
            raise HapticdError(f"{error.filename or paths.directory}: {error.strerror}") from None
        for path in (paths.telemetry, paths.command):
            stack.callback(mine.remove, path)
        yield mine


def _make(paths: RuntimePaths) -> None:
    """Creates the directory and missing parents, for the user alone, or takes the one that is there if it passes
    `check_directory`.

    One that is there keeps 0750 or 0700, as systemd or an administrator chose it, and gets 0700 otherwise.
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
