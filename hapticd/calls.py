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
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import (
    TYPE_CHECKING,
    Final,
    Generic,
    Literal,
    NotRequired,
    Protocol,
    TypeAlias,
    TypedDict,
    TypeVar,
    cast,
)

import zmq

from hapticd import wire
from hapticd.errors import HapticdError, Problem
from hapticd.paths import SYSTEM_DIRECTORY, RuntimePaths, daemon_paths
from hapticd.remote import Named, Remote, is_remote, monitored, remote

if TYPE_CHECKING:
    from hapticd.keys import Certificate
    from hapticd.yaml_source import Json

T = TypeVar("T")

TIMEOUT_S: Final = 5.0
"""How long a client waits for an answer unless it is told otherwise."""

_TRY_EVERY_MS: Final = 20
Interpolation: TypeAlias = Literal["linear", "minimum_jerk"]
Topic: TypeAlias = Literal["samples", "state", "event", "change", "status"]


class RemoteError(HapticdError):
    """The daemon answered with an error.

    `code` is one of `hapticd.wire.Code`, `problems` holds the faults that were found in the params, `data`
    is the error's data as it came.
    """

    def __init__(self, code: int, message: str, data: object = None) -> None:
        super().__init__(code, message, data)
        self.code = code
        self.message = message
        self.data = data
        self.problems: tuple[Problem, ...] = _problems(data)

    def __str__(self) -> str:
        return "; ".join(map(str, self.problems)) or self.message


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


# ---- results, named as in docs/protocol.md -----------------------------------------------------------------


class GestureEnd(TypedDict):
    """The event at the end of what the hand was told to do, `completed` or replaced by another operator before that;
    `started_tick` is that of `set_operator`."""

    event: Literal["gesture_end"]
    tick: int
    time_ns: int
    started_tick: int
    completed: bool


class OperatorStatus(TypedDict):
    """The tick that took the last operator (None: none so far), and the last gestures that ended, oldest first."""

    started_tick: int | None
    ends: list[GestureEnd]


class Status(TypedDict):
    """What the daemon is and does."""

    version: str
    protocol: int
    started_ns: int
    clock: dict[str, int]
    state: str
    device: str
    rate_hz: float
    realtime: dict[str, Json] | None
    revision: int
    tick: int
    forces: Literal["on", "off", "faulted"]
    faults: list[str]
    lease_s: float | None
    intake: dict[str, Json] | None
    counters: dict[str, int]
    overruns: dict[str, Json]
    histograms: dict[str, dict[str, Json]]
    flight: dict[str, Json] | None
    passivity: dict[str, Json]
    undisplayable: list[dict[str, Json]]
    warnings: list[dict[str, str]]
    offload: list[dict[str, Json]]
    stability: dict[str, Json]
    operator: OperatorStatus | None


class ConfigResult(TypedDict):
    """The configuration's servo and device, by these names."""

    config: dict[str, dict[str, Json]]


class SceneResult(TypedDict):
    """The scene, and the revision that it has."""

    scene: dict[str, Json]
    revision: int


class Warned(TypedDict):
    """What of a message is not displayed as it was meant: a place in its params, or in the file that they came from."""

    where: str
    problem: str


class RevisionResult(TypedDict):
    """The revision that a change made; with `wait`, also the first tick rendered with it or a later one.

    `warning`: why forces are off. `warnings`: what of the change is not displayed as it was meant.
    """

    revision: int
    tick: NotRequired[int]
    warning: NotRequired[str]
    warnings: NotRequired[list[Warned]]


class MaterialsResult(TypedDict):
    """All materials by name, and the scene's revision with them."""

    materials: dict[str, dict[str, Json]]
    revision: int


class TickResult(TypedDict):
    """The tick that took a command."""

    tick: int


class PlayResult(TickResult):
    """Also the frequency that is shown, where the rate does not carry the mode's own."""

    displayed_hz: float | None
    warnings: NotRequired[list[Warned]]


class ForcesResult(TickResult):
    """Also what the forces are now."""

    forces: Literal["on", "off", "faulted"]


class OperatorResult(TickResult):
    """Also how long the hand will be under way."""

    duration_s: float
    warnings: NotRequired[list[Warned]]


class LeaseResult(TypedDict):
    """By this token the lease is renewed or ended; None once it is ended."""

    token: str | None
    warning: NotRequired[str]


class FlightResult(TypedDict):
    """The file that the flight recorder writes; it is there once it is whole."""

    file: str


class State(TypedDict):
    """The newest sample; vectors are [x, y]. `touching`: ids of objects; `flag_names`: the flags as words.

    `contact_force_n`: touched objects and fields, after the passivity controller. `vibration_force_n`: ringing modes
    and the noise of textures. Both are before the force limit and the fade of set_forces; `force_n` is after them.
    """

    tick: int
    time_ns: int
    position_m: list[float]
    velocity_m_per_s: list[float]
    contact_force_n: list[float]
    vibration_force_n: list[float]
    force_n: list[float]
    revision: int
    flags: int
    lateness_ns: int
    work_ns: int
    touching: list[str]
    flag_names: list[str]


Event: TypeAlias = "dict[str, Json]"
"""One event; `event` says which, `tick` and `time_ns` when, the other members depend on it."""


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
        from hapticd.from_file import FromFile
        from hapticd.scene import read_scene

        read, document, root = read_scene(scene)
        return FromFile(read.to_dict(), document, root)
    return scene.to_dict()


def patch_tree(patch: PatchSource, *path: str) -> Mapping[str, object]:
    """The mapping that goes over the wire; a file may hold it under `path`, as a configuration does, or bare.

    Raises HapticdError for a file that cannot be read or holds no mapping, InvalidError for one that is no
    YAML or holds something else beside it.
    """
    if isinstance(patch, Mapping):
        return patch
    from hapticd.document_kinds import PATCHES, refuse_other_keys, refuse_other_kinds
    from hapticd.from_file import FromFile
    from hapticd.yaml_source import load_path

    document = load_path(patch)
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
    if wait:
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
    return {**params, "wait": True} if wait else params


def play_params(
    material: str | None,
    mode: Mapping[str, float] | None,
    direction: Iterable[float],
    amplitude_m_per_s2: float,
) -> dict[str, object]:
    """Params of play."""
    params: dict[str, object] = {
        "direction": [float(component) for component in direction],
        "amplitude_m_per_s2": float(amplitude_m_per_s2),
    }
    if material is not None:
        params["material"] = material
    if mode is not None:
        params["mode"] = dict(mode)
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
        return _operator_of(waypoints)
    params: dict[str, object] = {}
    if waypoints is not None:
        params["waypoints"] = [[float(number) for number in waypoint] for waypoint in waypoints]
    if interpolation is not None:
        params["interpolation"] = interpolation
    if gesture is not None:
        params["gesture"] = dict(gesture)
    return params


def _operator_of(file: str | os.PathLike[str]) -> dict[str, object]:
    from hapticd.from_file import FromFile
    from hapticd.operator import load_operator

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
    """The token of a lease that is to be held; raises HapticdError for one of no duration."""
    token = lease["token"]
    if token is None:
        raise HapticdError("duration_s: must be more than 0 to hold a lease")
    return token


# ---- questions and answers ---------------------------------------------------------------------------------


def question(id: int, method: str, params: Mapping[str, object] | None) -> bytes:
    """The body of a call; raises HapticdError for one that the daemon would refuse to read."""
    body = wire.request(id, method, params)
    if len(body) > wire.MAX_BODY:
        raise HapticdError(f"{method}: {len(body)} bytes in one message (at most {wire.MAX_BODY})")
    return body


def outcome(result: object | RemoteError | DaemonNotRunning, params: Mapping[str, object] | None) -> object:
    """The result of a call, or its error raised; places in params that came from a file are told as they are in it."""
    if isinstance(result, DaemonNotRunning):
        raise result
    if isinstance(result, RemoteError):
        if params and result.problems:
            from hapticd.from_file import placed

            result.problems = tuple(Problem(placed(each.where, params), each.problem) for each in result.problems)
        raise result
    if params and isinstance(result, dict) and result.get("warnings"):
        from hapticd.from_file import placed

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
    return str(place if isinstance(place, Remote) else place.directory)


def answer(body: bytes) -> tuple[wire.Id, object | RemoteError | DaemonNotRunning]:
    """The id that an answer carries, and the result or the error in it."""
    message = wire.decode_trusted(body)
    if not isinstance(message, dict):
        raise _not_an_answer()
    id = cast(wire.Id, message.get("id"))
    if "error" not in message:
        return id, message.get("result")
    error = message["error"]
    if not isinstance(error, dict):
        raise _not_an_answer()
    code, message = int(error.get("code", 0)), str(error.get("message", ""))
    if code == wire.Code.DAEMON_AWAY:
        return id, DaemonNotRunning(message)
    return id, RemoteError(code, message, error.get("data"))


def _not_an_answer() -> wire.WireError:
    return wire.WireError(wire.Code.INVALID_REQUEST, "the daemon's answer is not a JSON-RPC object")


def probe(paths: Place, timeout_s: float = TIMEOUT_S, command: bool = False) -> None:
    """Raises DaemonNotRunning where nobody listens, HapticdError where we may not ask.

    Of a bridge the telemetry socket is asked, which lets in whoever may watch, or the command socket.
    """
    if isinstance(paths, Remote):
        _knock(paths, timeout_s, command)
        return
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as trial:
        try:
            trial.connect(os.fspath(paths.command))
        except OSError as error:
            if error.errno in (errno.ENOENT, errno.ECONNREFUSED, errno.ENOTDIR):
                other = ""
                if paths.directory != SYSTEM_DIRECTORY and SYSTEM_DIRECTORY.is_dir():
                    other = f", or take the service's with: --runtime-dir {SYSTEM_DIRECTORY}"
                raise DaemonNotRunning(f"no daemon at {paths.directory}; start one with: hapticd run{other}") from None
            if error.errno == errno.EACCES:
                raise HapticdError(_not_ours(paths)) from None
            raise HapticdError(f"{paths.command}: {error.strerror}") from None


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
    """Returns once somebody listens at `place`, or `wait_s` are over, or nobody waits any more.

    ZeroMQ tries to connect, again and again, and tells when it has. Raises KeyRefused where a bridge does not let us
    in.
    """
    if isinstance(place, Remote):
        _knock(place, wait_s, command=False, patient=True, given_up=given_up)
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
    there, why = refused
    if not there:
        raise DaemonNotRunning(why)
    if command and place.knock(timeout_s, command=False) is None:
        raise KeyRefused(f"{why} for commands: it may only watch")
    raise KeyRefused(why)


def unanswered(paths: Place, timeout_s: float) -> DaemonNotRunning:
    """Why there was no answer: nobody is there, or somebody does not speak."""
    try:
        probe(paths, timeout_s, command=True)
    except DaemonNotRunning as error:
        return error
    except HapticdError as error:
        return DaemonNotRunning(str(error))
    return DaemonNotRunning(f"the daemon at {told(paths)} did not answer within {timeout_s:g} s")


# ---- telemetry ---------------------------------------------------------------------------------------------


class Feed(Generic[T]):
    """Turns telemetry messages into what a subscription yields.

    `state` comes 60 times a second. Subscriptions take effect in their order, so that the first message of
    any topic shows that those asked for before `state` are in effect. `status` comes every second, however
    little happens, so that silence means that the daemon is gone.
    """

    READY: Final = b"state"
    ALIVE: Final = b"status"

    def __init__(
        self, topics: Iterable[Topic], convert: Callable[[Topic, dict[str, object]], T], newest: bool = False
    ) -> None:
        """`newest`: each item is asked for when it is read, so that those before it are never sent."""
        self._wanted = frozenset(topic.encode() for topic in topics)
        self._convert = convert
        self.subscriptions: tuple[bytes, ...] = (*sorted((self._wanted | {self.ALIVE}) - {self.READY}), self.READY)
        self.each: frozenset[bytes] = self._wanted - {self.ALIVE} if newest else frozenset()
        """To be subscribed to for each item, and unsubscribed from after it."""
        self.surplus = (frozenset({self.READY}) - self._wanted) | self.each
        """To be unsubscribed from as soon as the first message came."""

    def accept(self, frames: list[bytes]) -> tuple[T, ...]:
        """What one message yields: one item, or none where it was not asked for."""
        if len(frames) != 2 or frames[0] not in self._wanted:
            return ()
        message = wire.decode_trusted(frames[1])
        if not isinstance(message, dict):
            raise wire.WireError(wire.Code.INVALID_REQUEST, f"telemetry {frames[0].decode()}: not a map")
        return (self._convert(cast(Topic, frames[0].decode()), message),)


def silent(paths: Place, timeout_s: float) -> DaemonNotRunning:
    """Why telemetry stopped, or never came."""
    try:
        probe(paths, timeout_s)
    except HapticdError as error:
        return DaemonNotRunning(str(error))
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
    forgotten = len(ends) == wire.GESTURE_ENDS and min(end["started_tick"] for end in ends) > started_tick
    if last is None or last < started_tick or forgotten:
        raise HapticdError(
            f"the daemon knows nothing of the operator that tick {started_tick} took: it was started anew since, or "
            f"{wire.GESTURE_ENDS} others ended"
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
