"""Whether a daemon is there, and why it does not answer."""

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
"""A topic that comes every second from every daemon."""
_RETRY_PERIOD_S: Final = 0.02


def place_of(directory: str | os.PathLike[str] | None) -> RuntimePaths:
    """The runtime directory of a daemon; None: as the environment says. Raises HapticdError for what is no path."""
    if directory is not None:
        arguments.path("runtime_dir", directory)
    threads.check_client()
    return daemon_paths(directory)


def probe(paths: RuntimePaths) -> None:
    """Raises DaemonNotRunning where nobody listens, HapticdError where we may not ask."""
    try:
        try:
            _try_connect(paths.command)
        except ConnectionRefusedError:
            # Nobody listens any more, or not yet: a daemon binds its socket first.
            time.sleep(_RETRY_PERIOD_S)
            _try_connect(paths.command)
    except OSError as error:
        if error.errno in (errno.ENOENT, errno.ECONNREFUSED, errno.ENOTDIR):
            other = ""
            if paths.directory != SYSTEM_DIRECTORY and SYSTEM_DIRECTORY.is_dir():
                other = f", or take the service's with: --runtime-dir {SYSTEM_DIRECTORY}"
            raise DaemonNotRunning(f"no daemon at {paths.directory}; start one with: hapticd run{other}") from None
        if error.errno == errno.EACCES:
            raise HapticdError(_permission_text(paths)) from None
        raise HapticdError(f"{paths.command}: {error.strerror}") from None


def _try_connect(path: Path) -> None:
    """To a socket, and lets go of it. Raises OSError."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as trial:
        trial.connect(os.fspath(path))


def _permission_text(paths: RuntimePaths) -> str:
    """Why the sockets may not be used, and whom they belong to."""
    refused = f"{paths.command}: permission denied"
    try:
        status = os.stat(paths.directory)
    except OSError:  # a folder above it is closed
        return refused
    owner = f"user {_name_of(pwd.getpwuid, status.st_uid)}"
    if not status.st_mode & stat.S_IXGRP:
        return f"{refused}: the daemon is {owner}'s alone"
    group = _name_of(grp.getgrgid, status.st_gid)
    return (
        f"{refused}: the daemon is {owner}'s and for the group {group}; join it (adduser YOU {group}) and log in again"
    )


def _name_of(look_up: Callable[[int], Sequence[object]], number: int) -> str:
    try:
        return str(look_up(number)[0])
    except KeyError:
        return str(number)


def await_ready(place: RuntimePaths, wait_s: float, given_up: Callable[[], bool] = lambda: False) -> None:
    """Returns once a daemon listens at `place`, or `wait_s` are over, or nobody waits any more."""
    deadline = time.monotonic() + wait_s
    while time.monotonic() < deadline and not given_up():
        with suppress(OSError):
            _try_connect(place.command)
            return
        time.sleep(_RETRY_PERIOD_S)


def no_answer(paths: RuntimePaths, timeout_s: float) -> DaemonNotRunning:
    """Why there was no answer: nobody is there, or somebody does not speak."""
    try:
        probe(paths)
    except DaemonNotRunning as error:
        return error
    except HapticdError as error:
        return DaemonNotRunning(str(error))
    return DaemonNotRunning(f"the daemon at {paths.directory} did not answer within {timeout_s:g} s")


def after_waiting(error: DaemonNotRunning, wait_s: float) -> DaemonNotRunning:
    """The same of somebody who was waited for."""
    return DaemonNotRunning(f"{error} (waited {wait_s:g} s for it)" if wait_s > 0 else str(error))


def has_ended(place: RuntimePaths) -> bool:
    """Whether no daemon has its telemetry socket any more."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as trial:
        trial.setblocking(False)  # one that is stopped takes nobody, and must not be waited for
        return trial.connect_ex(os.fspath(place.telemetry)) in (errno.ENOENT, errno.ECONNREFUSED, errno.ENOTDIR)


def no_telemetry(paths: RuntimePaths, timeout_s: float) -> DaemonNotRunning:
    """Why telemetry stopped, or never came."""
    try:
        probe(paths)
    except HapticdError as error:
        return DaemonNotRunning(str(error))
    return DaemonNotRunning(f"no telemetry from {paths.directory} for {timeout_s:g} s")
