"""The half of both clients that does no I/O: what each method sends, and what is made of what comes back.

`client.py` and `aio.py` are the two thin shells around it, blocking and asyncio. Results are typed as
dictionaries with the very names of `docs/protocol.md`.
"""

from __future__ import annotations

import errno
import grp
import os
import pwd
import socket
import stat
import time
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import (
    TYPE_CHECKING,
    Final,
    Generic,
    Literal,
    Protocol,
    TypeAlias,
    TypeVar,
    cast,
    get_args,
)

import zmq

from hapticd.base import arguments, threads
from hapticd.base.codec import NotEncodableError
from hapticd.base.errors import HapticdError, Problem, in_order, lines_of, shown
from hapticd.protocol import messages
from hapticd.protocol.remote import Named, Remote, is_remote, monitored, remote
from hapticd.protocol.results import Event, GestureEnd, LeaseResult, State, Status
from hapticd.system.paths import SYSTEM_DIRECTORY, RuntimePaths, daemon_paths

if TYPE_CHECKING:
    from hapticd.base.yaml_source import Json
    from hapticd.protocol.keys import Certificate

T = TypeVar("T")

TIMEOUT_S: Final = 5.0
"""How long a client waits for an answer unless it is told otherwise."""

_TRY_EVERY_MS: Final = 20
_LOOK_EVERY_S: Final = 0.1
AWAY_S: Final = 1.0
"""A daemon of which its bridge says that it is away may be under way again: so long a new subscription waits for it."""
Interpolation: TypeAlias = Literal["linear", "minimum_jerk"]
Topic: TypeAlias = Literal["samples", "state", "event", "change", "status", "bridge"]


class RemoteError(HapticdError):
    """The daemon answered with an error.

    `code` is one of `hapticd.protocol.messages.Code`, `problems` holds the faults that were found in the params, `data`
    is the error's data as it came.
    """

    def __init__(self, code: int, message: str, data: object = None) -> None:
        super().__init__(code, message, data)
        self.code = code
        self.message = message
        self.data = data
        self.problems: tuple[Problem, ...] = _problems(data)

    def __str__(self) -> str:
        return "; ".join(lines_of(self.problems)) or self.message


def _problems(data: object) -> tuple[Problem, ...]:
    if not isinstance(data, list):
        return ()
    return tuple(
        Problem(str(item["where"]), str(item["problem"]))
        for item in data
        if isinstance(item, dict) and "where" in item and "problem" in item
    )


class DaemonNotRunning(HapticdError):
    """Nobody answers at the runtime directory, or nobody any more."""


class KeyRefused(HapticdError):
    """A bridge is there and does not let us in: our key is not known there, or may only watch."""


Place: TypeAlias = RuntimePaths | Remote
"""Where a daemon is: in a runtime directory of this machine, or behind a bridge."""
KeySource: TypeAlias = "str | os.PathLike[str] | Certificate | None"
"""Our secret key: its file, or itself."""


class TimedOut(HapticdError, TimeoutError):
    """What was waited for did not come in the time that was given for it."""


class TelemetryLoss(UserWarning):
    """This subscriber was too slow: the daemon sent samples that never arrived here."""


class MissedPeriods(UserWarning):
    """The servo missed a greater part of its periods than `servo.overruns.threshold` while something was recorded."""


class ForcesOff(UserWarning):
    """A lease is held, but a fault keeps the forces off until `set_forces(True)`."""


# ---- params ------------------------------------------------------------------------------------------------


class Model(Protocol):
    """A validated model, such as `hapticd.Scene`."""

    def to_dict(self) -> dict[str, Json]: ...


SceneSource: TypeAlias = "Mapping[str, object] | str | os.PathLike[str] | Model"
"""A scene: the mapping itself, the path of a YAML file, or a `hapticd.Scene`."""
WaypointsSource: TypeAlias = "Iterable[Iterable[float]] | str | os.PathLike[str]"
"""Waypoints [[t_s, x_m, y_m], ...], or the path of a file with what the hand does: YAML, JSON or CSV."""
PatchSource: TypeAlias = "Mapping[str, object] | str | os.PathLike[str]"
"""A merge patch: the mapping itself, or the path of a YAML file."""


def scene_tree(scene: SceneSource) -> Mapping[str, object]:
    """The mapping that goes over the wire. A file is validated here, so that faults are told with their line.

    Raises HapticdError for a file that cannot be read, InvalidError for one that holds no valid scene.
    """
    if isinstance(scene, Mapping):
        return scene
    if isinstance(scene, str | os.PathLike):
        from hapticd.config.file_faults import FromFile
        from hapticd.config.scene import read_scene

        read, document, root = read_scene(arguments.path("scene", scene))
        return FromFile(read.to_dict(), document, root)
    if not hasattr(scene, "to_dict"):
        raise arguments.wrong("scene", f"must be a mapping, the path of a file or a hapticd.Scene, is {shown(scene)}")
    return scene.to_dict()


def patch_tree(patch: PatchSource, *path: str) -> Mapping[str, object]:
    """The mapping that goes over the wire; a file may hold it under `path`, as a configuration does, or bare.

    Raises HapticdError for a file that cannot be read or holds no mapping, InvalidError for one that is no
    YAML or holds something else beside it.
    """
    if isinstance(patch, Mapping):
        return patch
    from hapticd.base.yaml_source import load_path
    from hapticd.config.document_kinds import PATCHES, refuse_other_keys, refuse_other_kinds
    from hapticd.config.file_faults import FromFile

    if not isinstance(patch, str | os.PathLike):
        raise arguments.wrong(path[-1], f"must be a mapping or the path of a file, is {shown(patch)}")
    document = load_path(arguments.path(path[-1], patch))
    refuse_other_kinds(document, *PATCHES[path[-1]])
    found: tuple[str, ...] = ()
    data: object = document.data
    for key in path:
        if isinstance(data, dict) and key in data:
            refuse_other_keys(document, found, (other for other in data if other != key), f"{path[-1]}, which are all")
            data = data[key]
            found += (key,)
    if not isinstance(data, dict):
        raise HapticdError(f"{document.where(found)}: must be a mapping, the {path[-1]} by their names")
    return FromFile(data, document, found)


def change_params(key: str, value: Mapping[str, object], expect_revision: int | None, wait: bool) -> dict[str, object]:
    """Params of set_scene, update_scene, set_materials and update_materials."""
    params: dict[str, object] = {key: value}
    if expect_revision is not None:
        params["expect_revision"] = expect_revision
    if arguments.flag("wait", wait):
        params["wait"] = True
    return params


def apply_params(
    materials: PatchSource | None, scene: SceneSource | None, expect_revision: int | None, wait: bool
) -> dict[str, object]:
    """Params of apply."""
    params: dict[str, object] = {}
    if materials is not None:
        params["materials"] = patch_tree(materials, "materials")
    if scene is not None:
        params["scene"] = scene_tree(scene)
    return {**params, **reload_params(expect_revision, wait)}


def reload_params(expect_revision: int | None, wait: bool) -> dict[str, object]:
    """Params of reload."""
    params: dict[str, object] = {} if expect_revision is None else {"expect_revision": expect_revision}
    return {**params, "wait": True} if arguments.flag("wait", wait) else params


def play_params(
    material: str | None,
    mode: Mapping[str, float] | None,
    direction: Iterable[float],
    amplitude_m_per_s2: float,
) -> dict[str, object]:
    """Params of play."""
    params: dict[str, object] = {
        "direction": arguments.numbers("direction", direction),
        "amplitude_m_per_s2": amplitude_m_per_s2,
    }
    if material is not None:
        params["material"] = material
    if mode is not None:
        params["mode"] = arguments.mapping("mode", mode)
    return params


def operator_params(
    waypoints: WaypointsSource | None,
    interpolation: Interpolation | None,
    gesture: Mapping[str, object] | None,
) -> dict[str, object]:
    """Params of set_operator. Raises HapticdError for a file that holds no operator."""
    if isinstance(waypoints, str | os.PathLike):
        if interpolation is not None or gesture is not None:
            raise HapticdError(f"{os.fspath(waypoints)}: a file says all of it: interpolation and gesture, too")
        return _operator_of(arguments.path("waypoints", waypoints))
    params: dict[str, object] = {}
    if waypoints is not None:
        params["waypoints"] = arguments.rows("waypoints", waypoints)
    if interpolation is not None:
        params["interpolation"] = interpolation
    if gesture is not None:
        params["gesture"] = arguments.mapping("gesture", gesture)
    return params


def reset_params(objects: Iterable[str] | None) -> dict[str, object] | None:
    """Params of reset."""
    return None if objects is None else {"objects": arguments.texts("objects", objects)}


def _operator_of(file: str | os.PathLike[str]) -> dict[str, object]:
    from hapticd.config.file_faults import FromFile
    from hapticd.config.operator import load_operator

    operator = load_operator(file)
    if operator.gesture is not None:
        params = operator_params(None, None, operator.gesture.to_dict())
    else:
        params = operator_params(operator.waypoints, operator.interpolation, None)
    return params if operator.document is None else FromFile(params, operator.document)


def lease_params(duration_s: float, token: str | None) -> dict[str, object]:
    """Params of lease."""
    return {"duration_s": duration_s} if token is None else {"duration_s": duration_s, "token": token}


def token_of(lease: LeaseResult) -> str:
    """The token of a lease that is to be held. Raises HapticdError for one of no duration; ForcesOff warns."""
    token = lease["token"]
    if token is None:
        raise HapticdError("duration_s: must be more than 0 to hold a lease")
    if "warning" in lease:
        # Of the line with `with` in it, behind the context manager that asks.
        warnings.warn(ForcesOff(lease["warning"]), stacklevel=4)
    return token


# ---- questions and answers ---------------------------------------------------------------------------------


def question(id: int, method: str, params: Mapping[str, object] | None) -> bytes:
    """The body of a call; raises HapticdError for one that the daemon would refuse to read."""
    if not isinstance(method, str):
        raise arguments.wrong("method", f"must be a text, is {shown(method)}")
    if params is not None and not isinstance(params, Mapping):
        raise arguments.wrong("params", f"must be a mapping, is {shown(params)}")
    try:
        body = messages.request(id, method, params)
        if len(body) > messages.MAX_BODY:
            raise HapticdError(f"{method}: {len(body)} bytes in one message (at most {messages.MAX_BODY})")
        messages.decode(body)
    except (messages.WireError, NotEncodableError) as error:
        arguments.plain((), params)  # says where
        raise HapticdError(f"{method}: {error}") from None
    return body


def outcome(result: object | RemoteError | DaemonNotRunning, params: Mapping[str, object] | None, at: Place) -> object:
    """The result of a call, or its error raised; places in params that came from a file are told as they are in it."""
    if isinstance(result, DaemonNotRunning):  # a bridge says so, and does not know by which address it is known
        raise DaemonNotRunning(f"{told(at)}: {result}")
    if isinstance(result, RemoteError):
        if params and result.problems:
            from hapticd.config.file_faults import placed

            result.problems = in_order(Problem(placed(each.where, params), each.problem) for each in result.problems)
        raise result
    if params and isinstance(result, dict) and result.get("warnings"):
        from hapticd.config.file_faults import placed

        warnings = [{**each, "where": placed(str(each["where"]), params)} for each in result["warnings"]]
        return {**result, "warnings": warnings}
    return result


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


def told(place: Place) -> str:
    """A place as messages name it."""
    return f"the bridge at {place}" if isinstance(place, Remote) else str(place.directory)


def answer(body: bytes) -> tuple[messages.Id, object | RemoteError | DaemonNotRunning]:
    """The id that an answer carries, and the result or the error in it."""
    message = messages.decode_trusted(body)
    if not isinstance(message, dict):
        raise _not_an_answer()
    id = cast(messages.Id, message.get("id"))
    if "error" not in message:
        return id, message.get("result")
    error = message["error"]
    if not isinstance(error, dict):
        raise _not_an_answer()
    code, message = int(error.get("code", 0)), str(error.get("message", ""))
    if code == messages.Code.DAEMON_AWAY:
        return id, DaemonNotRunning(message)
    return id, RemoteError(code, message, error.get("data"))


def _not_an_answer() -> messages.WireError:
    return messages.WireError(messages.Code.INVALID_REQUEST, "the daemon's answer is not a JSON-RPC object")


def probe(paths: Place, timeout_s: float = TIMEOUT_S, command: bool = False) -> None:
    """Raises DaemonNotRunning where nobody listens, HapticdError where we may not ask.

    Of a bridge the telemetry socket is asked, which lets in whoever may watch, or the command socket.
    """
    if isinstance(paths, Remote):
        _knock(paths, timeout_s, command)
        return
    try:
        try:
            _connect(paths.command)
        except ConnectionRefusedError:
            # Nobody listens any more, or not yet: a daemon binds its socket first.
            time.sleep(_TRY_EVERY_MS * 1e-3)
            _connect(paths.command)
    except OSError as error:
        if error.errno in (errno.ENOENT, errno.ECONNREFUSED, errno.ENOTDIR):
            other = ""
            if paths.directory != SYSTEM_DIRECTORY and SYSTEM_DIRECTORY.is_dir():
                other = f", or take the service's with: --runtime-dir {SYSTEM_DIRECTORY}"
            raise DaemonNotRunning(f"no daemon at {paths.directory}; start one with: hapticd run{other}") from None
        if error.errno == errno.EACCES:
            raise HapticdError(_not_ours(paths)) from None
        raise HapticdError(f"{paths.command}: {error.strerror}") from None


def _connect(path: Path) -> None:
    """To a socket, and lets go of it. Raises OSError."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as trial:
        trial.connect(os.fspath(path))


def _not_ours(paths: RuntimePaths) -> str:
    """Why the sockets may not be used, and whom they belong to."""
    told = f"{paths.command}: permission denied"
    try:
        status = os.stat(paths.directory)
    except OSError:  # a folder above it is closed
        return told
    owner = f"user {_name_of(pwd.getpwuid, status.st_uid)}"
    if not status.st_mode & stat.S_IXGRP:
        return f"{told}: the daemon is {owner}'s alone"
    group = _name_of(grp.getgrgid, status.st_gid)
    return f"{told}: the daemon is {owner}'s and for the group {group}; join it (adduser YOU {group}) and log in again"


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
        _knock(place, wait_s, command=False, patient=True, given_up=given_up)
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
        for topic in (Feed.BRIDGE, Feed.ALIVE):
            trial.setsockopt(zmq.SUBSCRIBE, topic)
        place.secure(trial)
        trial.connect(place.telemetry_endpoint)
        while (left_s := until - time.monotonic()) > 0 and not given_up():
            if trial.poll(int(min(left_s, _LOOK_EVERY_S) * 1e3 + 0.999)) and Feed.shows_daemon(trial.recv_multipart()):
                return


def _knock(
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
        raise KeyRefused(f"{refused.why} for commands: it may only watch")
    raise KeyRefused(refused.why)


def unanswered(paths: Place, timeout_s: float) -> DaemonNotRunning:
    """Why there was no answer: nobody is there, or somebody does not speak."""
    try:
        probe(paths, timeout_s, command=True)
    except DaemonNotRunning as error:
        return error
    except HapticdError as error:
        return DaemonNotRunning(str(error))
    who = f"{told(paths)}: the daemon behind it" if isinstance(paths, Remote) else f"the daemon at {told(paths)}"
    return DaemonNotRunning(f"{who} did not answer within {timeout_s:g} s")


def waited(error: DaemonNotRunning, wait_s: float) -> DaemonNotRunning:
    """The same of somebody who was waited for."""
    return DaemonNotRunning(f"{error} (waited {wait_s:g} s for it)" if wait_s > 0 else str(error))


def has_ended(place: Place) -> bool:
    """Whether no daemon of this machine has its telemetry socket any more. A bridge tells by the topic `bridge`."""
    if isinstance(place, Remote):
        return False
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as trial:
        trial.setblocking(False)  # one that is stopped takes nobody, and must not be waited for
        return trial.connect_ex(os.fspath(place.telemetry)) in (errno.ENOENT, errno.ECONNREFUSED, errno.ENOTDIR)


# ---- telemetry ---------------------------------------------------------------------------------------------


class Feed(Generic[T]):
    """Turns telemetry messages into what a subscription yields.

    `state` comes 60 times a second. Subscriptions take effect in their order, so that the first message of
    any topic shows that those asked for before `state` are in effect. `status` comes every second, however
    little happens, so that silence means that the daemon is gone.
    """

    READY: Final = b"state"
    ALIVE: Final = b"status"
    BRIDGE: Final = b"bridge"
    """A bridge alone sends it: whether there is a daemon behind it, and what our key may."""

    def __init__(
        self, topics: Sequence[Topic], convert: Callable[[Topic, dict[str, object]], T], newest: bool = False
    ) -> None:
        """`newest`: each item is asked for when it is read, so that those before it are never sent."""
        if not topics:
            raise arguments.wrong("telemetry", f"needs a topic or several; known: {', '.join(get_args(Topic))}")
        for topic in topics:
            arguments.one_of("topic", topic, get_args(Topic))
        self._wanted = frozenset(topic.encode() for topic in topics)
        self._convert = convert
        self.subscriptions: tuple[bytes, ...] = (*sorted((self._wanted | {self.ALIVE}) - {self.READY}), self.READY)
        self.each: frozenset[bytes] = self._wanted - {self.ALIVE} if newest else frozenset()
        """To be subscribed to for each item, and unsubscribed from after it."""
        self.surplus = (frozenset({self.READY}) - self._wanted) | self.each
        """To be unsubscribed from as soon as the first message came."""

    @classmethod
    def shows_daemon(cls, frames: list[bytes]) -> bool:
        """Whether a message shows that there is a daemon: it came from one, or the bridge says so."""
        return (
            frames[0] != cls.BRIDGE
            or cast("dict[str, object]", messages.decode_trusted(frames[1])).get("daemon") is True
        )

    def accept(self, frames: list[bytes]) -> tuple[T, ...]:
        """What one message yields: one item, or none where it was not asked for."""
        if len(frames) != 2 or frames[0] not in self._wanted:
            return ()
        message = messages.decode_trusted(frames[1])
        if not isinstance(message, dict):
            raise messages.WireError(messages.Code.INVALID_REQUEST, f"telemetry {frames[0].decode()}: not a map")
        return (self._convert(cast(Topic, frames[0].decode()), message),)


def behind(place: Place) -> DaemonNotRunning:
    """A bridge is there, and its daemon is not."""
    return DaemonNotRunning(f"{told(place)}: the daemon behind it does not answer")


def silent(paths: Place, timeout_s: float) -> DaemonNotRunning:
    """Why telemetry stopped, or never came."""
    try:
        probe(paths, timeout_s)
    except HapticdError as error:
        return DaemonNotRunning(str(error))
    if isinstance(paths, Remote):
        return behind(paths)
    return DaemonNotRunning(f"no telemetry from {told(paths)} for {timeout_s:g} s")


def gesture_end(started_tick: int, topic: Topic, message: Mapping[str, object]) -> GestureEnd | None:
    """The end of the operator that this tick took, where a message of telemetry, or a status, tells of it.

    Raises HapticdError for a status of a daemon that knows nothing of such an operator.
    """
    if topic == "event":
        ours = message.get("event") == "gesture_end" and message.get("started_tick") == started_tick
        return cast(GestureEnd, message) if ours else None
    operator = cast(Status, message)["operator"]
    ends = [] if operator is None else operator["ends"]
    for end in ends:
        if end["started_tick"] == started_tick:
            return end
    last = None if operator is None else operator["started_tick"]
    forgotten = len(ends) == messages.GESTURE_ENDS and min(end["started_tick"] for end in ends) > started_tick
    if last is None or last < started_tick or forgotten:
        raise HapticdError(
            f"the daemon knows nothing of the operator that tick {started_tick} took: it was started anew since, or "
            f"{messages.GESTURE_ENDS} others ended"
        )
    return None


def message_of(topic: Topic, message: dict[str, object]) -> tuple[Topic, dict[str, object]]:
    """A message as it came, for subscriptions to several topics."""
    return topic, message


def state_of(topic: Topic, message: dict[str, object]) -> State:
    return cast(State, message)


def event_of(topic: Topic, message: dict[str, object]) -> Event:
    return cast("Event", message)


def status_of(topic: Topic, message: dict[str, object]) -> Status:
    return cast(Status, message)
