"""Where a daemon and its clients meet: the runtime directory, and the names in it.

The directory is the one that was named, else `$HAPTICD_RUNTIME_DIR`, else `$RUNTIME_DIRECTORY` where systemd gives one,
else `$XDG_RUNTIME_DIR/hapticd`, else `/tmp/hapticd-UID`. Only the directory's owner can put sockets into it, so that
whoever connects to a name in it talks to the daemon of that owner.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from hapticd.base.errors import HapticdError

SYSTEM_DIRECTORY: Final = Path("/run/hapticd")
"""The runtime directory of the service of the system. It is there while the service runs."""

_NAMED_BY: Final = ("HAPTICD_RUNTIME_DIR", "RUNTIME_DIRECTORY", "XDG_RUNTIME_DIR")
"""The variables that name a runtime directory."""

# sockaddr_un has room for 108 bytes, the last of which is NUL.
_LONGEST_SOCKET_NAME = 107


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
        """The file that a daemon holds an flock on as long as it lives."""
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


def runtime_paths(
    directory: str | os.PathLike[str] | None = None, environ: Mapping[str, str] | None = None
) -> RuntimePaths:
    """The names in `directory`, by default in the one that the environment says.

    Raises HapticdError where a socket's name would be longer than the system takes.
    """
    environ = os.environ if environ is None else environ
    if directory is not None:
        chosen = Path(directory)
    elif environ.get("HAPTICD_RUNTIME_DIR"):
        chosen = Path(environ["HAPTICD_RUNTIME_DIR"])
    elif environ.get("RUNTIME_DIRECTORY"):
        # systemd lists several directories separated by colons; the first is the service's own.
        chosen = Path(environ["RUNTIME_DIRECTORY"].split(":")[0])
    elif environ.get("XDG_RUNTIME_DIR"):
        chosen = Path(environ["XDG_RUNTIME_DIR"], "hapticd")
    else:
        chosen = Path(f"/tmp/hapticd-{os.getuid()}")
    paths = RuntimePaths(chosen.absolute())
    try:
        os.fspath(paths.directory).encode("utf-8")
    except UnicodeEncodeError:
        raise HapticdError("runtime directory: its name must be UTF-8, or ZeroMQ cannot bind in it") from None
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
    if stat.S_ISLNK(status.st_mode):
        raise HapticdError(f"runtime directory {paths.directory}: is a symbolic link; it must be a directory")
    if not stat.S_ISDIR(status.st_mode):
        raise HapticdError(f"runtime directory {paths.directory}: is not a directory")
    if status.st_uid != os.geteuid():
        raise HapticdError(
            f"runtime directory {paths.directory}: belongs to user {status.st_uid}, not to {os.geteuid()}"
        )
    if status.st_mode & 0o022:
        mode = stat.S_IMODE(status.st_mode)
        raise HapticdError(
            f"runtime directory {paths.directory}: others may write to it (mode {mode:04o}); it must be 0750 or 0700"
        )


def make_directory(paths: RuntimePaths) -> None:
    """Creates the directory, or takes the one that is there if it passes `check_directory`.

    A new one has mode 0700 from the beginning, whatever the umask: a client that looks for its daemon can always enter
    it. One that is there already keeps 0750 or 0700, as systemd or an administrator chose it, and gets 0700 otherwise.
    Missing parents are made, for the user alone. The umask is changed meanwhile, for every thread of the process.
    """
    try:
        with _umask(0o077):
            paths.directory.parent.mkdir(parents=True, exist_ok=True)
            try:
                os.mkdir(paths.directory)
            except FileExistsError:
                check_directory(paths)
                if stat.S_IMODE(os.lstat(paths.directory).st_mode) not in (0o700, 0o750):
                    os.chmod(paths.directory, 0o700)
    except OSError as error:
        raise HapticdError(f"runtime directory {paths.directory}: {error.filename}: {error.strerror}") from None


@contextmanager
def _umask(mask: int) -> Iterator[None]:
    before = os.umask(mask)
    try:
        yield
    finally:
        os.umask(before)


def daemon_paths(directory: str | os.PathLike[str] | None = None) -> RuntimePaths:
    """The names that a client connects to; raises HapticdError where somebody else could have put them there.

    A directory that was named, or that the environment names, is taken as it is: a system daemon's belongs
    to that daemon's user. The one under /tmp must be the user's own, since anybody could have made it.
    """
    paths = runtime_paths(directory)
    named = directory is not None or any(map(os.environ.get, _NAMED_BY))
    if not named and os.path.lexists(paths.directory):
        check_directory(paths)
    return paths
