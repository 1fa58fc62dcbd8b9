"""What the daemon's methods answer and its telemetry tells: dictionaries with the very names of `docs/protocol.md`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, NotRequired, TypeAlias, TypedDict

if TYPE_CHECKING:
    from hapticd.base.yaml_source import Json


class GestureEnd(TypedDict):
    """The event at the end of what the hand was sent to do, `completed` or replaced by another operator before that;
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


class StreamStatus(TypedDict):
    """What became of the messages of one kind of stream. Each that was received is used, superseded, late, held or
    refused, or about to be used."""

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
    """The configuration's servo and device, by these names."""

    config: dict[str, dict[str, Json]]


class SceneResult(TypedDict):
    """The scene, and the revision that it has. `margins`: how many times as stiff each surface could be by itself, by
    id, None for any; absent where the handle's mass and damping are not known."""

    scene: dict[str, Json]
    revision: int
    margins: NotRequired[dict[str, float | None]]


class Warned(TypedDict):
    """What of a message is not displayed as it was meant: a place in its params, or in the file that they came from."""

    where: str
    problem: str


class RevisionResult(TypedDict):
    """The revision that a change made; with `wait`, also the first tick rendered with it or a later one.

    `margins`: as in `get_scene`, of the surfaces that the change brought or changed. `warning`: why forces are off.
    `warnings`: what of the change is not displayed as it was meant.
    """

    revision: int
    tick: NotRequired[int]
    margins: NotRequired[dict[str, float | None]]
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


class SignsCheck(TypedDict):
    """How far the check of a device's signs is, and what to do."""

    state: Literal["unchecked", "trusted", "checking", "waiting", "right", "wrong", "unclear"]
    axis: Literal["x", "y"] | None
    problem: str | None
    advice: str | None


class ForcesResult(TickResult):
    """Also what the forces are now, and, where the scene is held back until then, the check of the device's signs."""

    forces: Literal["on", "off", "faulted"]
    signs: NotRequired[SignsCheck]


class StreamedForceResult(TypedDict):
    """What the forces are now, and, unless they are on, why nothing of the streamed force is felt."""

    forces: Literal["on", "off", "faulted"]
    warning: NotRequired[str]


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
    and the noise of textures. Both are before the force limit and the fade of set_forces, but for a strike or
    a noise, which has the amplitude that the limit left it; `force_n` is after them.
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
    """A change of scene or materials: all that is other than at the revision before, None for what is gone. `large`:
    more than is listed; `get_scene` and `get_materials` list it. `rate_hz`: the servo stepped down."""

    revision: int
    objects: NotRequired[dict[str, dict[str, Json] | None]]
    scene: NotRequired[dict[str, Json]]
    materials: NotRequired[dict[str, dict[str, Json] | None]]
    rate_hz: NotRequired[float]
    large: NotRequired[bool]


class StruckMode(TypedDict):
    """The mode, and what `play` was told of it."""

    angular_frequency_rad_per_s: float
    decay_rate_per_s: float
    attack: Literal["coefficient", "first_peak"]
    direction: list[float]
    amplitude_m_per_s2: float


class Played(TypedDict):
    """A mode that `play` struck, and the tick that took it."""

    tick: int
    play: StruckMode


class ResetObjects(TypedDict):
    """Ids, where the command named them."""

    objects: NotRequired[list[str]]


class ResetDone(TypedDict):
    """Contacts that `reset` cleared, and the tick that took it."""

    tick: int
    reset: ResetObjects


Change: TypeAlias = Revised | Played | ResetDone
"""What a command changed."""
Event: TypeAlias = "dict[str, Json]"
"""One event; `event` says which, `tick` and `time_ns` when, the other members depend on it."""
