"""Types of the results of methods and of telemetry: dictionaries with the names in `docs/protocol.md`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, NotRequired, TypeAlias, TypedDict

if TYPE_CHECKING:
    from hapticd.base.yaml_source import Json


class GestureEnd(TypedDict):
    """The event at the end of a motion of the simulated hand.

    `completed` is false if another operator replaced the motion. `started_tick` is the tick at which the motion began.
    """

    event: Literal["gesture_end"]
    tick: int
    time_ns: int
    started_tick: int
    completed: bool


class OperatorStatus(TypedDict):
    """State of the simulated hand: tick of the last `set_operator` or None, and ends of motions, the oldest first."""

    started_tick: int | None
    ends: list[GestureEnd]


class StreamStatus(TypedDict):
    """Counters of the messages of one kind of stream.

    Each received message is used, superseded, late (`seq` too low), held (another client owns the stream), refused
    (invalid), or waits to be used.
    """

    active: bool
    seq: int | None
    tick: int | None
    received: int
    used: int
    superseded: int
    late: int
    lost: int
    refused: int
    held: int
    limited: int
    timeouts: int


class Status(TypedDict):
    """The state of the daemon."""

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
    counters: dict[str, int]
    overruns: dict[str, Json]
    histograms: NotRequired[dict[str, dict[str, Json]]]
    flight: dict[str, Json] | None
    passivity: dict[str, Json]
    undisplayable: list[dict[str, Json]]
    warnings: list[dict[str, str]]
    offload: list[dict[str, Json]]
    operator: OperatorStatus | None
    connection: dict[str, Json] | None
    streams: dict[Literal["target", "force"], StreamStatus]


class ConfigResult(TypedDict):
    """The keys `servo` and `device` of the configuration."""

    config: dict[str, dict[str, Json]]


class SceneResult(TypedDict):
    """The scene and its revision (number of the last change of scene or materials).

    `margins` has the stability margin of each surface alone, by id: the factor by which its stiffness could grow, None
    if unlimited. `margins` is absent if mass and damping of the handle are unknown.
    """

    scene: dict[str, Json]
    revision: int
    margins: NotRequired[dict[str, float | None]]


class Warned(TypedDict):
    """A warning that a part of a request is not displayed as written, with its place in the params or their file."""

    where: str
    problem: str


class RevisionResult(TypedDict):
    """The revision (number) of a change; with `wait` also the first tick rendered with this revision or a later one.

    `margins` is as in `get_scene`, for new and changed surfaces. `warning` says why forces are off. `warnings` lists
    parts of the change that are not displayed as written.
    """

    revision: int
    tick: NotRequired[int]
    margins: NotRequired[dict[str, float | None]]
    warning: NotRequired[str]
    warnings: NotRequired[list[Warned]]


class MaterialsResult(TypedDict):
    """All materials by name, and the revision: the number of the last change of scene or materials."""

    materials: dict[str, dict[str, Json]]
    revision: int


class TickResult(TypedDict):
    """The tick at which a command took effect."""

    tick: int


class PlayResult(TickResult):
    """The tick at which `play` struck a mode, and the displayed frequency of the mode; None if the mode is silent."""

    displayed_hz: float | None
    warnings: NotRequired[list[Warned]]


class SignsCheck(TypedDict):
    """State of the check whether a device pushes in the right direction along each axis, and advice for the user."""

    state: Literal["unchecked", "trusted", "checking", "waiting", "right", "wrong", "unclear"]
    axis: Literal["x", "y"] | None
    problem: str | None
    advice: str | None


class ForcesResult(TickResult):
    """The tick of `set_forces`, and the state of the forces.

    `signs` is present while the daemon checks the directions of the device's forces, or the device exerts no force.
    """

    forces: Literal["on", "off", "faulted"]
    signs: NotRequired[SignsCheck]


class StreamedForceResult(TypedDict):
    """The state of the forces and, if the streamed force is not displayed, the reason."""

    forces: Literal["on", "off", "faulted"]
    warning: NotRequired[str]


class OperatorResult(TickResult):
    """The tick at which `set_operator` began a motion of the simulated hand, and the duration of the motion."""

    duration_s: float
    warnings: NotRequired[list[Warned]]


class LeaseResult(TypedDict):
    """The token with which a client renews or ends its lease; None after the end of the lease."""

    token: str | None
    warning: NotRequired[str]


class FlightResult(TypedDict):
    """The path of the flight file, which appears when it is complete."""

    file: str


class State(TypedDict):
    """The newest sample of the servo, one tick; vectors are [x, y].

    `touching` has the ids of touched objects, `flag_names` the names of the flags. `contact_force_n` is the force of
    touched objects and fields after the passivity controller, `vibration_force_n` that of ringing modes and the noise
    of textures. Both are before the force limit and the fade of `set_forces`; only amplitudes of strikes and noise are
    already limited. `force_n` is the force after limit and fade.
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


class Revised(TypedDict):
    """A change of scene or materials: all differences to the previous revision, None for removed objects and materials.

    `large` says that more has changed than a change lists: call `get_scene` and `get_materials`. `rate_hz` is the new
    rate after the servo has lowered it.
    """

    revision: int
    objects: NotRequired[dict[str, dict[str, Json] | None]]
    scene: NotRequired[dict[str, Json]]
    materials: NotRequired[dict[str, dict[str, Json] | None]]
    rate_hz: NotRequired[float]
    large: NotRequired[bool]


class StruckMode(TypedDict):
    """A ringing mode (decaying sinusoid) with the parameters of the method `play`."""

    angular_frequency_rad_per_s: float
    decay_rate_per_s: float
    attack: Literal["coefficient", "first_peak"]
    direction: list[float]
    amplitude_m_per_s2: float


class Played(TypedDict):
    """A ringing mode that the method `play` struck, and the tick at which it began."""

    tick: int
    play: StruckMode


class ResetObjects(TypedDict):
    """The ids in the params of `reset`; absent if all objects were reset."""

    objects: NotRequired[list[str]]


class ResetDone(TypedDict):
    """The objects whose contacts the method `reset` cleared, and the tick at which they were cleared."""

    tick: int
    reset: ResetObjects


Change: TypeAlias = Revised | Played | ResetDone
"""A change by a command: of scene or materials, by `play`, or by `reset`."""
Event: TypeAlias = "dict[str, Json]"
"""An event: its kind `event`, its time `tick` and `time_ns`, and members that depend on the kind."""
