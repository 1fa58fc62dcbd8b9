"""The runtime directory of a daemon: whether a daemon listens there, and why it does not answer."""

from __future__ import annotations

import errno
import grp
import os
import pwd
import socket
import stat
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final

from hapticd.base import arguments, threads
from hapticd.base.errors import HapticdError
from hapticd.protocol.calls import DaemonNotRunning
from hapticd.system.paths import SYSTEM_DIRECTORY, RuntimePaths, daemon_paths

HEARTBEAT_TOPIC: Final = b"status"
"""Topic that every daemon publishes every second."""
_RETRY_PERIOD_S: Final = 0.02
"""Time between two attempts to connect, in s."""


def place_of(directory: str | os.PathLike[str] | None) -> RuntimePaths:
    """Return the paths below a daemon's runtime directory, by default that of the environment.

    Raises HapticdError for an invalid path.
    """
    if directory is not None:
        arguments.path("runtime_dir", directory)
    threads.check_client()
    return daemon_paths(directory)


def probe(paths: RuntimePaths) -> None:
    """Raise DaemonNotRunning if no daemon listens at `paths`, HapticdError if this process has no permission."""
    try:
        try:
            _try_connect(paths.command)
        except ConnectionRefusedError:
            # The daemon has ended, or has bound its socket and not yet called listen.
            time.sleep(_RETRY_PERIOD_S)
            _try_connect(paths.command)
    except OSError as error:
        if error.errno in (errno.ENOENT, errno.ECONNREFUSED, errno.ENOTDIR):
            other = ""
            if paths.directory != SYSTEM_DIRECTORY and SYSTEM_DIRECTORY.is_dir():
                other = f", or use the service with: --runtime-dir {SYSTEM_DIRECTORY}"
            raise DaemonNotRunning(f"no daemon at {paths.directory}; start one with: hapticd run{other}") from None
        if error.errno == errno.EACCES:
            raise HapticdError(_permission_text(paths)) from None
        raise HapticdError(f"{paths.command}: {error.strerror}") from None


def _try_connect(path: Path) -> None:
    """Connect to a socket and close the connection. Raises OSError."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as trial:
        trial.connect(os.fspath(path))


def _permission_text(paths: RuntimePaths) -> str:
    """Return the error text for a user who must not open a daemon's sockets; it names the owner of the sockets."""
    refused = f"{paths.command}: permission denied"
    try:
        status = os.stat(paths.directory)
    except OSError:  # a parent folder is not accessible
        return refused
    owner = f"user {_name_of(pwd.getpwuid, status.st_uid)}"
    if not status.st_mode & stat.S_IXGRP:
        return f"{refused}: only {owner} has access to the daemon"
    group = _name_of(grp.getgrgid, status.st_gid)
    return (
        f"{refused}: the daemon is {owner}'s and for the group {group}; join it (adduser YOU {group}) and log in again"
    )


def _name_of(entry_of: Callable[[int], Sequence[object]], number: int) -> str:
    try:
        return str(entry_of(number)[0])
    except KeyError:
        return str(number)


def await_ready(place: RuntimePaths, wait_s: float, given_up: Callable[[], bool] = lambda: False) -> None:
    """Wait until a daemon listens at `place`, `wait_s` are over, or `given_up` returns true."""
    deadline = time.monotonic() + wait_s
    while time.monotonic() < deadline and not given_up():
        with suppress(OSError):
            _try_connect(place.command)
            return
        time.sleep(_RETRY_PERIOD_S)


def no_answer(paths: RuntimePaths, timeout_s: float) -> DaemonNotRunning:
    """Return the error for a call without a reply: no daemon listens, or it did not answer within `timeout_s`."""
    try:
        probe(paths)
    except DaemonNotRunning as error:
        return error
    except HapticdError as error:
        return DaemonNotRunning(str(error))
    return DaemonNotRunning(f"the daemon at {paths.directory} did not answer within {timeout_s:g} s")


def after_waiting(error: DaemonNotRunning, wait_s: float) -> DaemonNotRunning:
    """Return the error with a note on `wait_s`, the time that was spent waiting for a daemon to start."""
    return DaemonNotRunning(f"{error} (waited {wait_s:g} s for it)" if wait_s > 0 else str(error))


def has_ended(place: RuntimePaths) -> bool:
    """Return whether no daemon listens on the telemetry socket."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as trial:
        trial.setblocking(False)  # a stopped daemon accepts no connection
        return trial.connect_ex(os.fspath(place.telemetry)) in (errno.ENOENT, errno.ECONNREFUSED, errno.ENOTDIR)


def no_telemetry(paths: RuntimePaths, timeout_s: float) -> DaemonNotRunning:
    """Return the error for missing telemetry: no daemon listens, or it sent none for `timeout_s`."""
    try:
        probe(paths)
    except HapticdError as error:
        return DaemonNotRunning(str(error))
    return DaemonNotRunning(f"no telemetry from {paths.directory} for {timeout_s:g} s")
