"""Configuration: servo, device, materials and scene, from YAML files or a Python mapping."""

import os
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Annotated, Final, Literal, Self, TypeAlias

from pydantic import Field, ValidationError, field_validator, model_validator

from hapticd.base.core import MAX_FORCE_DELAY_FRAMES
from hapticd.base.errors import InvalidError, Path, Problem, shown
from hapticd.base.model import Damping, Model, Name, Position, Stiffness, faults_of, plain
from hapticd.base.yaml_source import Document, Json, load_path
from hapticd.config.actuator import Actuator
from hapticd.config.document_kinds import kind_of, refuse_other_kinds
from hapticd.config.dynamics import Dynamics, Grip, Handle
from hapticd.config.hid import Hid, Replay
from hapticd.config.locations import ConfigFiles, check_named, choose
from hapticd.config.materials import MAX_MATERIALS, Material, shipped_document, shipped_materials
from hapticd.config.scene import Scene, reference_faults
from hapticd.config.shipped_files import file_of

DEFAULT_CONFIG_FILE = "default.yaml"
"""Shipped file of the built-in configuration."""

_PATH_KEYS: Final[tuple[tuple[str, ...], ...]] = (("device", "replay", "path"), ("flight", "directory"))
"""Keys whose values are paths of files."""

Compensation: TypeAlias = Literal["off", "mass", "full"]
"""Dynamics for which strikes are compensated: none; the mass; mass, spring and damper of handle and hand."""
ActuatorForce: TypeAlias = Annotated[float, Field(ge=0.01, le=100)]
"""Maximum force of an actuator, in N."""
_MIN_RATE_HZ: Final = 1000
_MIN_LINK_RATE_HZ: Final = 10


class Overruns(Model):
    """The largest allowed fraction of missed servo periods, and the reaction if more are missed."""

    threshold: float = Field(
        default=0.1, ge=0.001, le=1, description="Largest fraction of missed periods in a second; 1: all."
    )
    action: Literal["warn", "step_down", "fault"] = Field(
        default="warn",
        description="Reaction if more periods are missed: an event, half the rate (a fault if impossible), or a fault.",
    )


class Servo(Model):
    """The servo loop and its real-time settings."""

    rate_hz: float = Field(default=10000.0, ge=_MIN_RATE_HZ, le=10000, description="Ticks per second.")
    cpu: Annotated[int, Field(ge=0, le=1023)] | None = Field(
        default=None, description="Processor that the servo runs on; null: any."
    )
    priority: int = Field(default=80, ge=1, le=99, description="Real-time priority (SCHED_FIFO).")
    realtime: Literal["required", "preferred", "off"] = Field(
        default="preferred",
        description="Real-time rights: refuse to start without them, request them, or do without.",
    )
    spin_us: float = Field(default=0.0, ge=0, le=100, description="Duration of busy waiting before each deadline.")
    clock: Literal["timer", "device"] = Field(
        default="timer", description="What starts a tick: a timer, or the position reports of a HID device."
    )
    overruns: Overruns = Field(default=Overruns(), description="Reaction to missed periods.")
    stream_timeout_s: float = Field(
        default=0.02,
        ge=0.002,
        le=1,
        description="A stream ends if no message arrives for this time: a streamed force goes to zero over `ramp_s`, a "
        "streamed hand stays at its last target.",
    )

    @field_validator("rate_hz", mode="before")
    @classmethod
    def _not_of_a_link(cls, rate_hz: object) -> object:
        if isinstance(rate_hz, int | float) and _MIN_LINK_RATE_HZ <= rate_hz < _MIN_RATE_HZ:
            raise ValueError(
                f"should be greater than or equal to {_MIN_RATE_HZ}, is {shown(rate_hz)}; a slower simulated joystick "
                "has device.sim.link.rate_hz"
            )
        return rate_hz


class Hand(Model):
    """The hand on the simulated handle: a mass on it, pulled to the operator's target by spring and damper."""

    mass_kg: float = Field(default=0.01, ge=0, le=10, description="Mass that moves with the handle.")
    stiffness_n_per_m: Stiffness = Field(default=300.0, description="Grip stiffness.")
    damping_n_s_per_m: Damping = Field(default=5.0, description="Grip damping.")


class Link(Model):
    """A link with frames between the servo and the simulated joystick, like USB."""

    rate_hz: float = Field(ge=_MIN_LINK_RATE_HZ, le=8000, description="Frames per second.")
    delay_frames: int = Field(
        default=1,
        ge=1,
        le=MAX_FORCE_DELAY_FRAMES,
        description="Delay of a position and of a force, in frames.",
    )


class Sim(Model):
    """The simulated joystick; the defaults are those of a desktop impulse joystick."""

    handle_mass_kg: float = Field(default=0.04, ge=0.001, le=10, description="Moving mass of the device.")
    handle_damping_n_s_per_m: Damping = Field(default=0.2, description="Viscous friction of the device.")
    coulomb_friction_n: float = Field(default=0.05, ge=0, le=10, description="Dry friction, per axis.")
    encoder_step_m: float = Field(default=20e-6, ge=0, le=0.01, description="Step of positions; 0: exact.")
    max_force_n: ActuatorForce = Field(default=8.9, description="Maximum force of the actuator, per axis.")
    force_step_n: float = Field(default=0.0043, ge=0, le=1, description="Resolution of the force; 0: exact.")
    actuator: Actuator | None = Field(default=None, description="Lag of the actuator; null: none.")
    report_interval_s: float = Field(
        default=0.0, ge=0, le=0.1, description="Time between position reports; 0: one at every tick."
    )
    report_delay_s: float = Field(default=0.0, ge=0, le=0.1, description="Age of a position when reported.")
    workspace_m: float = Field(default=0.075, ge=0.001, le=10, description="Half the travel, per axis.")
    force_timeout_s: float = Field(
        default=0.1, ge=0.001, le=10, description="Time after which a force that is not renewed becomes zero."
    )
    start_m: Position = Field(
        default=(0.0, 0.0),
        description="Position of handle and hand at the start, [x, y]; in `simulate` ignored if the waypoints start at "
        "0 s.",
    )
    hand: Hand = Field(default=Hand(), description="The hand that holds the handle.")
    link: Link | None = Field(default=None, description="Link of positions and forces; null: none, without delay.")

    @property
    def handle(self) -> Handle:
        """Mass, damping and dry friction of the simulated handle."""
        return Handle(
            mass_kg=self.handle_mass_kg,
            damping_n_s_per_m=self.handle_damping_n_s_per_m,
            friction_n=self.coulomb_friction_n,
        )

    @property
    def reports_s(self) -> tuple[float, float]:
        """Time in s between position reports, 0 for one at every tick, and the age in s of a report when it is read."""
        if self.link is None:
            return self.report_interval_s, self.report_delay_s
        return 1.0 / self.link.rate_hz, self.link.delay_frames / self.link.rate_hz

    @property
    def age_s(self) -> float:
        """Mean delay in s from a position of the handle to the force that is computed from that position.

        On a link with frames, a force waits half a frame on average.
        """
        delay_s = self.reports_s[1]
        return delay_s if self.link is None else 2.0 * delay_s - 0.5 / self.link.rate_hz

    @model_validator(mode="after")
    def _one_way_of_reports(self) -> Self:
        if self.link is not None and (self.report_interval_s or self.report_delay_s):
            raise ValueError("with a link, leave out report_interval_s and report_delay_s: the link sets both")
        return self

    @model_validator(mode="after")
    def _start_inside(self) -> Self:
        if max(map(abs, self.start_m)) > self.workspace_m:
            raise ValueError(f"start_m must be inside the workspace, -{self.workspace_m:g} to {self.workspace_m:g} m")
        return self


def _dynamics(kind: object, sim: Sim, handle: Handle | None, grip: Grip | None) -> Dynamics | None:
    hand = sim.hand
    if kind == "sim":
        handle = handle or sim.handle
        grip = grip or Grip(
            mass_kg=hand.mass_kg, damping_n_s_per_m=hand.damping_n_s_per_m, stiffness_n_per_m=hand.stiffness_n_per_m
        )
    if handle is None:
        return None
    grip = grip or Grip()
    return Dynamics(
        handle_mass_kg=handle.mass_kg,
        handle_damping_n_s_per_m=handle.damping_n_s_per_m,
        friction_n=handle.friction_n,
        grip_mass_kg=grip.mass_kg,
        grip_damping_n_s_per_m=grip.damping_n_s_per_m,
        grip_stiffness_n_per_m=grip.stiffness_n_per_m,
    )


def _moving_mass_kg(fields: dict[str, object]) -> float:
    sim, handle, grip = fields["sim"], fields["handle"], fields["grip"]
    assert isinstance(sim, Sim)
    assert handle is None or isinstance(handle, Handle)
    assert grip is None or isinstance(grip, Grip)
    known = _dynamics(fields["kind"], sim, handle, grip) or _dynamics("sim", sim, handle, grip)
    assert known is not None
    return known.mass_kg


def _muted_or_lowered(fields: dict[str, object]) -> Literal["mute", "lower"]:
    # If a slow joystick muted steel's mode, steel would feel softer than wood.
    return "mute" if fields["kind"] == "sim" else "lower"


class Device(Model):
    """The device that displays the force, and its limits."""

    kind: Literal["sim", "hid", "replay"] = Field(
        default="sim", description="The simulated joystick, a HID joystick, or a recording of one."
    )
    max_force_n: ActuatorForce = Field(default=8.9, description="Maximum magnitude of the commanded force.")
    max_speed_m_per_s: float = Field(
        default=5.0, ge=0.01, le=1000, description="A faster step between two positions is treated as a glitch."
    )
    rearm_m: float = Field(
        default=0.0,
        ge=0,
        le=0.01,
        description="Distance that the probe must withdraw before it can tap again; set it to the encoder's step or "
        "the noise of positions. 0: every contact is a tap.",
    )
    undisplayable: Literal["mute", "lower"] = Field(
        default_factory=_muted_or_lowered,
        description="A mode above 0.4 of the rate (the link's, if that is lower) is muted, or lowered in frequency.",
    )
    frozen_after_s: Annotated[float, Field(ge=0.1, le=60)] | None = Field(
        default=None,
        description="The same position for this long, at a force of at least a tenth of max_force_n, is a fault. null: "
        "no fault, since a hand may hold the handle still.",
    )
    sim: Sim = Field(default=Sim(), description="The simulated joystick.")
    hid: Hid = Field(default=Hid(), description="A HID joystick; for a replay, how its reports are decoded.")
    replay: Replay | None = Field(default=None, description="The recording that is played.")
    handle: Handle | None = Field(default=None, description="The handle of a real joystick; by default that of `sim`.")
    grip: Grip | None = Field(default=None, description="The hand; by default the simulated one, or none.")
    actuator: Actuator | None = Field(
        default=None, description="Lag of the actuator; by default that of the simulated one, or none."
    )
    compensation: Compensation = Field(
        default="off",
        description="Correction of strikes: none, for mass and zero-order hold, or for mass, spring, damper and hold.",
    )
    # Defined after the fields that its default depends on.
    effective_mass_kg: float = Field(
        default_factory=_moving_mass_kg,
        ge=1e-4,
        le=20,
        description="Mass that converts accelerations to forces; by default handle and hand together.",
    )

    @property
    def dynamics(self) -> Dynamics | None:
        """Mass, damping and stiffness of handle and hand; None for a real joystick without `handle`."""
        return _dynamics(self.kind, self.sim, self.handle, self.grip)

    @property
    def lag(self) -> Actuator | None:
        """Lag between commanded and exerted force; None if the force follows at once or the lag is unknown."""
        return self.sim.actuator if self.actuator is None and self.kind == "sim" else self.actuator

    @model_validator(mode="after")
    def _recording_named(self) -> Self:
        if self.kind == "replay" and self.replay is None:
            raise ValueError("kind replay needs device.replay.path, a recording of `hapticd devices dump`")
        return self

    @model_validator(mode="after")
    def _compensated_for_something(self) -> Self:
        if self.compensation != "off" and self.dynamics is None:
            raise ValueError(
                f"compensation {self.compensation} needs device.handle, the mass and damping of the joystick's handle"
            )
        return self


class FlightRecorder(Model):
    """The flight recorder: the last seconds of telemetry, written to a file on a fault or on request."""

    seconds: float = Field(default=10.0, ge=1, le=60, description="Duration of the kept telemetry.")
    directory: str | None = Field(
        default=None,
        min_length=1,
        max_length=4096,
        description="Folder of the files, relative to that of the YAML file; null: $STATE_DIRECTORY, or the runtime "
        "directory.",
    )
    keep: int = Field(default=10, ge=1, le=1000, description="Files to keep; older ones are removed.")


class Config(Model):
    """A complete configuration."""

    servo: Servo = Field(default=Servo(), description="The servo loop.")
    device: Device = Field(default=Device(), description="The device.")
    materials: dict[Name, Material] = Field(
        default={}, max_length=MAX_MATERIALS, description="Materials by name, added to the shipped ones."
    )
    scene: Scene = Field(default=Scene(), description="The scene at the start.")
    flight: FlightRecorder = Field(default=FlightRecorder(), description="The flight recorder.")

    @model_validator(mode="after")
    def _clock_reports(self) -> Self:
        if self.servo.clock == "device" and self.device.kind == "sim":
            raise ValueError("servo.clock device needs a device of kind hid or replay")
        return self


ConfigSource: TypeAlias = "Config | Mapping[str, object] | str | os.PathLike[str] | Sequence[str | os.PathLike[str]]"


def load_config(source: ConfigSource) -> Config:
    """Load and validate a configuration, and add the shipped materials.

    `source` is a mapping (which may hold numpy scalars, arrays and tuples), a path, or paths that are merged in
    order: a later file overrides key by key, but replaces a material or a scene object completely. Missing keys get
    their defaults. A material of the source replaces a shipped one of the same name. A Config is returned unchanged.

    Raises HapticdError for a file that cannot be read. Raises InvalidError, which names every faulty key with file,
    line and limit; if all keys are valid, every unknown material.
    """
    if isinstance(source, Config):
        return source
    if isinstance(source, Mapping):
        return config_of_documents([Document(plain(source))])
    paths = [source] if isinstance(source, str | os.PathLike) else source
    if not isinstance(paths, Sequence) or not all(isinstance(path, str | os.PathLike) for path in paths):
        raise InvalidError(
            [Problem("", f"a configuration must be a mapping, a path or a list of paths, is {shown(source)}")]
        )
    return config_of_documents(load_all(paths))


def load_all(paths: Sequence[str | os.PathLike[str]]) -> list[Document]:
    """Parse YAML files. Raises InvalidError, which names the fault of every file that is not YAML."""
    documents: list[Document] = []
    problems: list[Problem] = []
    for path in paths:
        try:
            documents.append(load_path(path))
        except InvalidError as error:
            problems += error.problems
    if problems:
        raise InvalidError(problems)
    return documents


@cache
def default_config() -> Config:
    """Return the built-in configuration, which is used if no file is found: `config/default.yaml`."""
    return config_of_documents([shipped_document(DEFAULT_CONFIG_FILE)])


def config_of(paths: Sequence[str | os.PathLike[str]] = ()) -> Config:
    """Load a command's configuration from the files given with -c, or from the files that locations.choose finds."""
    return chosen_config(choose(paths))


def chosen_config(chosen: ConfigFiles, rate_hz: float | None = None) -> Config:
    """Load the chosen configuration files as load_config does; without files return the built-in configuration.

    A shipped scene may be given by its name. `rate_hz` replaces servo.rate_hz. Raises HapticdError also if
    $HAPTICD_CONFIG names a missing file.
    """
    check_named(chosen)
    files = [file_of(file, "scenes") for file in chosen.files]
    if rate_hz is None:
        return load_config(files) if files else default_config()
    documents = load_all(files) if files else [shipped_document(DEFAULT_CONFIG_FILE)]
    return config_of_documents([*documents, Document({"servo": {"rate_hz": rate_hz}})])


def config_of_documents(documents: Sequence[Document]) -> Config:
    """Merge documents into a configuration, validate it, and add the shipped materials, as load_config does."""
    merged = Merged()
    for given in documents:
        document = _as_configuration(given)
        merged.add(document, document.mapping(Config.model_fields))
    for path in _PATH_KEYS:
        merged.make_absolute(path)
    try:
        config = Config.parsed(merged.data)
    except ValidationError as error:
        raise merged.invalid(faults_of(error)) from None
    materials = {**shipped_materials(), **config.materials}
    unknown = reference_faults(config.scene.objects, materials)
    if unknown:
        raise merged.invalid([(("scene", *path), text) for path, text in unknown])
    return config.model_copy(update={"materials": materials})


def _as_configuration(document: Document) -> Document:
    """Return a configuration or a bare scene as a configuration. Raises InvalidError for another kind of document."""
    refuse_other_kinds(document, "configuration", "change", "scene", "bare scene", "materials")
    return document.below("scene") if kind_of(document.data) == "bare scene" else document


class Merged:
    """Several documents merged into one, with the document that each value comes from."""

    def __init__(self) -> None:
        self.data: dict[str, Json] = {}
        self._owners: dict[Path, Document] = {}

    def add(self, document: Document, data: dict[str, Json]) -> None:
        """Merge a document. It overrides earlier ones key by key, but replaces a material or an object completely."""
        self._add(document, data, self.data, ())

    def _add(self, document: Document, source: dict[str, Json], target: dict[str, Json], path: Path) -> None:
        self._owners[path] = document
        for key, value in source.items():
            here = (*path, key)
            is_replaced = path in (("materials",), ("scene", "objects"))
            if isinstance(value, dict) and not is_replaced:
                old = target.get(key)
                inner = target[key] = old if isinstance(old, dict) else {}
                self._add(document, value, inner, here)
            else:
                target[key] = value
                self._owners[here] = document

    def make_absolute(self, path: Sequence[str]) -> None:
        """Make the value at `path`, if it is a relative path of a file, begin in the folder of its document."""
        section = self.data
        for key in path[:-1]:
            inner = section.get(key)
            section = inner if isinstance(inner, dict) else {}
        value = section.get(path[-1])
        if isinstance(value, str) and value:
            section[path[-1]] = os.path.join(self._owner(path).folder, value)

    def invalid(self, faults: Sequence[tuple[Path, str]]) -> InvalidError:
        """Return the InvalidError for faults of the merged document, each given by its path and text."""
        return InvalidError(self._owner(path).problem(path, text) for path, text in faults)

    def where(self, path: Sequence[str | int]) -> str:
        """Return `FILE:LINE:COLUMN: KEY` of the value at `path`, in the file that it comes from."""
        return self._owner(path).where(path)

    def _owner(self, path: Sequence[str | int]) -> Document:
        here = tuple(path)
        return next(self._owners[here[:n]] for n in range(len(here), -1, -1) if here[:n] in self._owners)
