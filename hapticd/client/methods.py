"""The daemon's methods, once for both clients: arguments, what they send, results and documentation.

A function here returns the call that is to be made, or the feed that is to be subscribed to. `blocking.py` and
`asynchronous.py` make methods of them, which make the call.
"""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Generic, Literal, Protocol, TypeAlias, TypeVar, cast

from hapticd.base import arguments
from hapticd.base.errors import HapticdError, shown
from hapticd.client.feed import Feed
from hapticd.protocol.calls import Topic
from hapticd.protocol.results import (
    ConfigResult,
    Event,
    FlightResult,
    ForcesResult,
    LeaseResult,
    MaterialsResult,
    OperatorResult,
    PlayResult,
    RevisionResult,
    SceneResult,
    State,
    Status,
    TickResult,
)
from hapticd.protocol.streams import MOST, Kind

if TYPE_CHECKING:
    from hapticd.base.yaml_source import Json
    from hapticd.client.samples import SampleBatch

R = TypeVar("R")
F = TypeVar("F", bound=Callable[..., object])
_SELF: Final = inspect.Parameter("self", inspect.Parameter.POSITIONAL_OR_KEYWORD)
Interpolation: TypeAlias = Literal["linear", "minimum_jerk"]


class Model(Protocol):
    """A validated model, such as `hapticd.Scene`."""

    def to_dict(self) -> dict[str, Json]: ...


SceneSource: TypeAlias = "Mapping[str, object] | str | os.PathLike[str] | Model"
"""A scene: the mapping itself, the path of a YAML file, or a `hapticd.Scene`."""
WaypointsSource: TypeAlias = "Iterable[Iterable[float]] | str | os.PathLike[str]"
"""Waypoints [[t_s, x_m, y_m], ...], or the path of a file with what the hand does: YAML, JSON or CSV."""
PatchSource: TypeAlias = "Mapping[str, object] | str | os.PathLike[str]"
"""A merge patch: the mapping itself, or the path of a YAML file."""


@dataclass(slots=True)
class Call(Generic[R]):
    """A call of the protocol, whose result is an R."""

    method: str
    params: Mapping[str, object] | None = None


@dataclass(slots=True)
class Listen(Generic[R]):
    """A subscription to telemetry, whose items are R."""

    feed: Feed[R]
    timeout_s: float | None


@dataclass(slots=True)
class Send:
    """A message of a stream."""

    kind: Kind
    x: float
    y: float


def documented(method: F, described: Callable[..., object], result: str, owner: str = "Client") -> F:
    """`method` of `owner`, a client, with the name, the parameters and the documentation of a function here.

    `result` is what `inspect.signature` says of the result, `{}` standing for R.
    """
    signature = inspect.signature(described)
    returns = result.format(str(signature.return_annotation).partition("[")[2].removesuffix("]"))
    parameters = [_SELF, *signature.parameters.values()]
    made: Any = method
    made.__signature__ = signature.replace(parameters=parameters, return_annotation=returns)
    made.__annotations__ = {**described.__annotations__, "return": returns}
    made.__name__, made.__doc__ = described.__name__, described.__doc__
    made.__qualname__ = f"{owner}.{described.__name__}"
    return method


# ---- Calls ---------------------------------------------------------------------------------------------------------


def get_status(detail: bool = False) -> Call[Status]:
    """Version, device, rate, real-time rights, revision, tick, forces, faults and counters; `detail`: histograms,
    too."""
    return Call("get_status", {"detail": True} if detail else {})


def get_state() -> Call[State]:
    """The newest sample, as `states` yields it."""
    return Call("get_state")


def state() -> Call[State]:
    """The newest sample: `get_state` by its short name."""
    return get_state()


def get_config() -> Call[ConfigResult]:
    """The configuration's servo and device."""
    return Call("get_config")


def get_scene() -> Call[SceneResult]:
    """The scene and its revision."""
    return Call("get_scene")


def set_scene(scene: SceneSource, expect_revision: int | None = None, wait: bool = False) -> Call[RevisionResult]:
    """Replaces the scene, all or nothing.

    `scene` is a mapping, the path of a YAML file that holds a scene, or a `hapticd.Scene`. With
    `expect_revision` the daemon refuses (-32001) if the scene has another revision; with `wait` the
    result has the first `tick` rendered with it.
    """
    return _change("set_scene", {"scene": scene_tree(scene)}, expect_revision, wait)


def update_scene(objects: PatchSource, expect_revision: int | None = None, wait: bool = False) -> Call[RevisionResult]:
    """Changes objects by id: a JSON Merge Patch (RFC 7396) over the scene's `objects`; None removes."""
    return _change("update_scene", {"objects": patch_tree(objects, "scene", "objects")}, expect_revision, wait)


def get_materials() -> Call[MaterialsResult]:
    """All materials by name, the shipped ones among them."""
    return Call("get_materials")


def set_materials(
    materials: PatchSource, expect_revision: int | None = None, wait: bool = False
) -> Call[RevisionResult]:
    """Adds materials by name, and replaces those of the same name whole; others stay. A mapping or the path of a
    YAML file."""
    return _change("set_materials", {"materials": patch_tree(materials, "materials")}, expect_revision, wait)


def update_materials(
    materials: PatchSource, expect_revision: int | None = None, wait: bool = False
) -> Call[RevisionResult]:
    """Changes materials by name: a JSON Merge Patch, as a mapping or the path of a YAML file."""
    return _change("update_materials", {"materials": patch_tree(materials, "materials")}, expect_revision, wait)


def apply(
    *,
    materials: PatchSource | None = None,
    scene: SceneSource | None = None,
    expect_revision: int | None = None,
    wait: bool = False,
) -> Call[RevisionResult]:
    """Materials as `set_materials` and the scene as `set_scene`, or one of them: one change at one tick, all or
    nothing."""
    params: dict[str, object] = {}
    if materials is not None:
        params["materials"] = patch_tree(materials, "materials")
    if scene is not None:
        params["scene"] = scene_tree(scene)
    return _change("apply", params, expect_revision, wait)


def play(
    material: str | None = None,
    *,
    mode: Mapping[str, float] | None = None,
    direction: Iterable[float] = (0.0, 1.0),
    amplitude_m_per_s2: float,
) -> Call[PlayResult]:
    """Strikes a mode, or a material's tap, along `direction` [x, y], whatever is touched."""
    params: dict[str, object] = {
        "direction": arguments.numbers("direction", direction),
        "amplitude_m_per_s2": amplitude_m_per_s2,
    }
    if material is not None:
        params["material"] = material
    if mode is not None:
        params["mode"] = arguments.mapping("mode", mode)
    return Call("play", params)


def reset(objects: Iterable[str] | None = None) -> Call[TickResult]:
    """Heals membranes and clears contact state, of the objects with these ids or of all."""
    return Call("reset", None if objects is None else {"objects": arguments.texts("objects", objects)})


def mark(text: str, data: Json = None) -> Call[TickResult]:
    """Leaves a mark in the event stream and in every recording; the result has its `tick`.

    `text` has up to 1000 characters, `data` is anything that JSON can hold, up to 8 KiB.
    """
    return Call("mark", {"text": text, "data": data})


def set_forces(enabled: bool) -> Call[ForcesResult]:
    """Forces on or off; on clears a latched fault whose cause is gone, else is refused (-32003)."""
    return Call("set_forces", {"enabled": enabled})


def set_operator(
    waypoints: WaypointsSource | None = None,
    *,
    interpolation: Interpolation | None = None,
    gesture: Mapping[str, object] | None = None,
) -> Call[OperatorResult]:
    """What the simulated joystick's hand does: waypoints [[t_s, x_m, y_m], ...], a gesture, or the path of a file
    (YAML, JSON, CSV) that holds either."""
    return Call("set_operator", _operator(waypoints, interpolation, gesture))


def lease(duration_s: float, token: str | None = None) -> Call[LeaseResult]:
    """Takes a lease, or renews that with `token`; 0 ends it. Not renewed in time, forces fade out."""
    return Call("lease", {"duration_s": duration_s} if token is None else {"duration_s": duration_s, "token": token})


def reload(expect_revision: int | None = None, wait: bool = False) -> Call[RevisionResult]:
    """The daemon reads its configuration files again: scene and materials, all or nothing."""
    return _change("reload", {}, expect_revision, wait)


def dump_flight() -> Call[FlightResult]:
    """Has the last seconds of telemetry written to a file on the daemon's machine; its name."""
    return Call("dump_flight")


# ---- Streams -------------------------------------------------------------------------------------------------------


def stream() -> None:
    """Streams targets of the simulated hand, or forces, while the block runs: up to 1,000 a second of each.

    The servo goes from one to the next in a straight line. Without a message for the time-out (20 ms by default) a
    force fades to zero and the hand stays; the end of the block sends a force of zero. No message waits for an answer.
    The first one of each kind, and one in half a second, asks for one all the same: what the daemon refuses is raised
    (RemoteError) by a later message or at the end of the block, and forces that are off are warned of (ForcesOff).
    """


def target(x: float, y: float) -> Send:
    """Where the simulated hand wants to be, m. Raises DaemonNotRunning, and RemoteError for a message before."""
    most = MOST["target"]
    return Send("target", arguments.within("x", x, most, "m"), arguments.within("y", y, most, "m"))


def force(fx: float, fy: float) -> Send:
    """A force that is added to the rendered one, N. Raises DaemonNotRunning, and RemoteError for a message before."""
    most = MOST["force"]
    return Send("force", arguments.within("fx", fx, most, "N"), arguments.within("fy", fy, most, "N"))


# ---- Telemetry -----------------------------------------------------------------------------------------------------


def samples(timeout_s: float | None = None, *, newest: bool = False) -> Listen[SampleBatch]:
    """Every tick, in batches of 20 ms: numpy structured arrays that know what of them was lost (`lost`).

    Begins when this returns, in asyncio with `async with` or the first item. Iteration raises DaemonNotRunning where
    nothing comes for `timeout_s` (by default the client's), and warns (TelemetryLoss) where reading is too slow.

    With `newest` each batch is the next one that the daemon sends once it is asked for; what it sent since the one
    before is left out, which is no loss to warn of, and counted in `lost`.
    """
    from hapticd.client.samples import SampleStream

    newest = arguments.flag("newest", newest)
    return Listen(Feed(("samples",), SampleStream(warn=not newest).convert, newest), timeout_s)


def states(timeout_s: float | None = None, *, newest: bool = False) -> Listen[State]:
    """The newest sample as a dictionary, 60 times a second.

    With `newest` each one is the next that the daemon sends once it is asked for: who reads slowly never reads an
    old one.
    """
    feed = Feed(("state",), lambda _, message: cast(State, message), arguments.flag("newest", newest))
    return Listen(feed, timeout_s)


def events(timeout_s: float | None = None) -> Listen[Event]:
    """Contacts, releases, punctures, faults and the other events."""
    return Listen(Feed(("event",), lambda _, message: cast("Event", message)), timeout_s)


def statuses(timeout_s: float | None = None) -> Listen[Status]:
    """The status, once a second."""
    return Listen(Feed(("status",), lambda _, message: cast(Status, message)), timeout_s)


def telemetry(*topics: Topic, timeout_s: float | None = None) -> Listen[tuple[Topic, dict[str, object]]]:
    """Several topics on one socket, in the daemon's order: pairs of topic and message as it came."""
    return Listen(Feed(topics, lambda topic, message: (topic, message)), timeout_s)


# ---- What they send ------------------------------------------------------------------------------------------------


def _change(method: str, params: dict[str, object], expect_revision: int | None, wait: bool) -> Call[RevisionResult]:
    if expect_revision is not None:
        params["expect_revision"] = expect_revision
    if arguments.flag("wait", wait):
        params["wait"] = True
    return Call(method, params)


def scene_tree(scene: SceneSource) -> Mapping[str, object]:
    """The mapping that goes over the wire. A file is validated here, so that faults are reported with their line.

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


def _operator(
    waypoints: WaypointsSource | None, interpolation: Interpolation | None, gesture: Mapping[str, object] | None
) -> dict[str, object]:
    """Raises HapticdError for a file that holds no operator."""
    if isinstance(waypoints, str | os.PathLike):
        if interpolation is not None or gesture is not None:
            raise HapticdError(f"{os.fspath(waypoints)}: a file says all of it: interpolation and gesture, too")
        from hapticd.config.file_faults import FromFile
        from hapticd.config.operator import load_operator

        operator = load_operator(arguments.path("waypoints", waypoints))
        if operator.gesture is not None:
            read = _operator(None, None, operator.gesture.to_dict())
        else:
            read = _operator(operator.waypoints, operator.interpolation, None)
        return read if operator.document is None else FromFile(read, operator.document)
    params: dict[str, object] = {}
    if waypoints is not None:
        params["waypoints"] = arguments.rows("waypoints", waypoints)
    if interpolation is not None:
        params["interpolation"] = interpolation
    if gesture is not None:
        params["gesture"] = arguments.mapping("gesture", gesture)
    return params
