"""Where a daemon is, whether it is there, and why it does not answer: on this machine, or behind a bridge."""

from __future__ import annotations

import errno
import grp
import os
import pwd
import socket
import stat
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeAlias, cast

import zmq

from hapticd.base import arguments, threads
from hapticd.base.errors import HapticdError
from hapticd.protocol import messages
from hapticd.protocol.calls import TIMEOUT_S, DaemonNotRunning, KeyRefused
from hapticd.protocol.remote import Named, Remote, is_remote, monitored, remote
from hapticd.system.paths import SYSTEM_DIRECTORY, RuntimePaths, daemon_paths

if TYPE_CHECKING:
    from hapticd.protocol.keys import Certificate

ALIVE: Final = b"status"
"""A topic that comes every second from every daemon."""
BRIDGE: Final = b"bridge"
"""A topic that a bridge alone sends: whether there is a daemon behind it, and what our key may."""
AWAY_S: Final = 1.0
"""A daemon of which its bridge says that it is away may be under way again: so long a new subscription waits for it."""
_TRY_EVERY_MS: Final = 20
_LOOK_EVERY_S: Final = 0.1

Place: TypeAlias = RuntimePaths | Remote
"""Where a daemon is: in a runtime directory of this machine, or behind a bridge."""
KeySource: TypeAlias = "str | os.PathLike[str] | Certificate | None"
"""Our secret key: its file, or itself."""


def place_of(
    place: str | os.PathLike[str] | None, key: KeySource = None, server_key: str | os.PathLike[str] | None = None
) -> Place:
    """Where `place` is: a runtime directory, or tcp://HOST:PORT of a bridge; None: as the environment says.

    That is HAPTICD_CONNECT, then a runtime directory. HAPTICD_KEY and HAPTICD_SERVER_KEY stand for keys of a bridge
    that are not given. Raises HapticdError for what is neither, and for keys that cannot be used.
    """
    if place is not None:
        arguments.path("runtime_dir", place)
    threads.check_client()
    address = Named(place) if place is not None else _or_variable(None, "HAPTICD_CONNECT")
    if is_remote(place) or address.variable is not None:
        return remote(address, _or_variable(key, "HAPTICD_KEY"), _or_variable(server_key, "HAPTICD_SERVER_KEY"))
    if key is not None or server_key is not None:
        raise HapticdError(f"{place or 'key'}: keys are for a bridge, at tcp://HOST:PORT")
    return daemon_paths(place)


def _or_variable(given: object, variable: str) -> Named:
    found = os.environ.get(variable)
    return Named(given) if given is not None or not found else Named(found, variable)


def place_name(place: Place) -> str:
    """A place as messages name it."""
    return f"the bridge at {place}" if isinstance(place, Remote) else str(place.directory)


def probe(paths: Place, timeout_s: float = TIMEOUT_S, command: bool = False) -> None:
    """Raises DaemonNotRunning where nobody listens, HapticdError where we may not ask.

    Of a bridge the telemetry socket is asked, which lets in whoever may watch, or the command socket.
    """
    if isinstance(paths, Remote):
        _probe_bridge(paths, timeout_s, command)
        return
    try:
        try:
            _try_connect(paths.command)
        except ConnectionRefusedError:
            # Nobody listens any more, or not yet: a daemon binds its socket first.
            time.sleep(_TRY_EVERY_MS * 1e-3)
            _try_connect(paths.command)
    except OSError as error:
        if error.errno in (errno.ENOENT, errno.ECONNREFUSED, errno.ENOTDIR):
            other = ""
            if paths.directory != SYSTEM_DIRECTORY and SYSTEM_DIRECTORY.is_dir():
                other = f", or take the service's with: --runtime-dir {SYSTEM_DIRECTORY}"
            raise DaemonNotRunning(f"no daemon at {paths.directory}; start one with: hapticd run{other}") from None
        if error.errno == errno.EACCES:
            raise HapticdError(_not_ours(paths)) from None
        raise HapticdError(f"{paths.command}: {error.strerror}") from None


def _try_connect(path: Path) -> None:
    """To a socket, and lets go of it. Raises OSError."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as trial:
        trial.connect(os.fspath(path))


def _not_ours(paths: RuntimePaths) -> str:
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


def await_ready(place: Place, wait_s: float, given_up: Callable[[], bool] = lambda: False) -> None:
    """Returns once a daemon listens at `place`, or `wait_s` are over, or nobody waits any more.

    ZeroMQ tries to connect, again and again, and tells when it has. Raises DaemonNotRunning where no bridge came,
    KeyRefused where one does not let us in.
    """
    if isinstance(place, Remote):
        until = time.monotonic() + wait_s
        _probe_bridge(place, wait_s, command=False, patient=True, given_up=given_up)
        _await_daemon(place, until, given_up)
        return
    trial: zmq.Socket[bytes]
    with zmq.Context.instance().socket(zmq.DEALER) as trial:
        trial.setsockopt(zmq.LINGER, 0)
        trial.setsockopt(zmq.RECONNECT_IVL, _TRY_EVERY_MS)
        monitor: zmq.Socket[bytes] = trial.get_monitor_socket(zmq.EVENT_HANDSHAKE_SUCCEEDED)
        try:
            trial.connect(place.command_endpoint)
            next(monitored(monitor, wait_s, given_up), None)
        finally:
            trial.disable_monitor()
            monitor.close()


def _await_daemon(place: Remote, until: float, given_up: Callable[[], bool]) -> None:
    """Waits for the daemon behind a bridge: it says so, and a daemon shows by its status."""
    trial: zmq.Socket[bytes]
    with zmq.Context.instance().socket(zmq.SUB) as trial:
        trial.setsockopt(zmq.LINGER, 0)
        for topic in (BRIDGE, ALIVE):
            trial.setsockopt(zmq.SUBSCRIBE, topic)
        place.secure(trial)
        trial.connect(place.telemetry_endpoint)
        while (left_s := until - time.monotonic()) > 0 and not given_up():
            if trial.poll(int(min(left_s, _LOOK_EVERY_S) * 1e3 + 0.999)) and shows_daemon(trial.recv_multipart()):
                return


def _probe_bridge(
    place: Remote,
    timeout_s: float,
    command: bool,
    patient: bool = False,
    given_up: Callable[[], bool] = lambda: False,
) -> None:
    refused = place.knock(timeout_s, command, patient, given_up)
    if refused is None:
        return
    if refused.by in ("nobody", "busy"):
        raise DaemonNotRunning(refused.why)
    if refused.by == "key" and command and place.knock(timeout_s, command=False) is None:
        raise KeyRefused(
            f"{refused.why} for commands: it may only watch; `hapticd watch` goes with it, and a key for "
            "commands has `may: command` at the bridge"
        )
    if refused.by == "key":
        raise KeyRefused(f"{refused.why}: the bridge's file lists no client with it; `hapticd key new` prints its line")
    raise KeyRefused(refused.why)


def no_answer(paths: Place, timeout_s: float) -> DaemonNotRunning:
    """Why there was no answer: nobody is there, or somebody does not speak."""
    try:
        probe(paths, timeout_s, command=True)
    except DaemonNotRunning as error:
        return error
    except HapticdError as error:
        return DaemonNotRunning(str(error))
    name = place_name(paths)
    who = f"{name}: the daemon behind it" if isinstance(paths, Remote) else f"the daemon at {name}"
    return DaemonNotRunning(f"{who} did not answer within {timeout_s:g} s")


def after_waiting(error: DaemonNotRunning, wait_s: float) -> DaemonNotRunning:
    """The same of somebody who was waited for."""
    return DaemonNotRunning(f"{error} (waited {wait_s:g} s for it)" if wait_s > 0 else str(error))


def has_ended(place: Place) -> bool:
    """Whether no daemon of this machine has its telemetry socket any more. A bridge tells by the topic `bridge`."""
    if isinstance(place, Remote):
        return False
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as trial:
        trial.setblocking(False)  # one that is stopped takes nobody, and must not be waited for
        return trial.connect_ex(os.fspath(place.telemetry)) in (errno.ENOENT, errno.ECONNREFUSED, errno.ENOTDIR)


def shows_daemon(frames: list[bytes]) -> bool:
    """Whether a message of telemetry shows that there is a daemon: it came from one, or the bridge says so."""
    return frames[0] != BRIDGE or cast("dict[str, object]", messages.decode_trusted(frames[1])).get("daemon") is True


def no_daemon_behind(place: Place) -> DaemonNotRunning:
    """A bridge is there, and its daemon is not."""
    return DaemonNotRunning(f"{place_name(place)}: the daemon behind it does not answer")


def no_telemetry(paths: Place, timeout_s: float) -> DaemonNotRunning:
    """Why telemetry stopped, or never came."""
    try:
        probe(paths, timeout_s)
    except HapticdError as error:
        return DaemonNotRunning(str(error))
    if isinstance(paths, Remote):
        return no_daemon_behind(paths)
    return DaemonNotRunning(f"no telemetry from {place_name(paths)} for {timeout_s:g} s")
