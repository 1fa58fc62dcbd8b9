"""Materials: what a surface is made of, and the library that ships with hapticd.

A ringing mode is Q(t) = A exp(-B t) sin(w t) (Okamura, Dennerlein and Howe, "Vibration Feedback Models for
Virtual Environments", ICRA 1998, eq. 1 and 3), B the decay rate in 1/s, w the angular frequency in rad/s.
"""

import datetime
import math
from collections.abc import Mapping
from functools import cache
from importlib import resources
from itertools import pairwise
from types import MappingProxyType
from typing import Annotated, Final, Literal, TypeAlias

from pydantic import (
    AfterValidator,
    ConfigDict,
    Field,
    Strict,
    StringConstraints,
    ValidationError,
    ValidationInfo,
    field_validator,
)

from hapticd.base.errors import InvalidError, Path, Problem, quoted
from hapticd.base.model import (
    Damping,
    Model,
    Name,
    Stiffness,
    at_most,
    check_count,
    entry_by_entry,
    faults_of,
    one_of_two,
    problems_of,
    refuse_many_keys,
)
from hapticd.base.steps import Steps, finish
from hapticd.base.yaml_source import Document, load_bytes
from hapticd.config.modes import ONE_DIRECTION, AimedKeys, ModeTable, absent, given, one_of
from hapticd.config.modes import Attack as Attack
from hapticd.config.modes import Mode as Mode
from hapticd.config.modes import ModeKeys as ModeKeys
from hapticd.config.texture import WITHOUT_MODE, Grooves, Texture
from hapticd.config.waveform import Waveform

MAX_MATERIALS: Final = 1000
LIBRARY: Final = "materials"
_FIRST: Final = "okamura1998.yaml"
MAX_TAP_POINTS: Final = 256
"""HD_TAP_POINTS."""
MIN_TAP_STEP_M_PER_S: Final = 1e-6
MAX_PROVENANCE_FILES: Final = 1000
MAX_REASONS: Final = 64
MAX_REASON: Final = 1000
"""Characters of one."""

TapPoint: TypeAlias = Annotated[
    tuple[Annotated[float, Field(ge=1e-4, le=100)], Annotated[float, Field(ge=0, le=1e5)]], Strict(False)
]
"""[approach speed in m/s, amplitude in m/s^2]."""


def _rising(interval: tuple[float, float]) -> tuple[float, float]:
    if interval[0] > interval[1]:
        raise ValueError(f"must not end below its beginning, is {list(interval)}")
    return interval


def _a_day(text: str) -> str:
    try:
        datetime.date.fromisoformat(text)
    except ValueError:
        raise ValueError(f"must be a day, year-month-day, is {quoted(text)}") from None
    return text


Interval: TypeAlias = Annotated[
    tuple[Annotated[float, Field(ge=-1e12, le=1e12)], Annotated[float, Field(ge=-1e12, le=1e12)]],
    Strict(False),
    AfterValidator(_rising),
]
"""[low, high] in the unit of what it bounds."""
Words: TypeAlias = Annotated[str, StringConstraints(min_length=1, max_length=256, pattern=r"^[^\u0000-\u001f\u007f]+$")]


Reason: TypeAlias = Annotated[str, StringConstraints(min_length=1, max_length=MAX_REASON)]


class SecondMode(ModeKeys):
    """A second ringing that begins with the tap's."""

    ratio: float = Field(ge=-10, le=10, description="Its coefficient over that of the tap's own mode.")


_RINGING: Final[tuple[str, ...]] = (
    "frequency_hz",
    "angular_frequency_rad_per_s",
    "decay_time_s",
    "decay_rate_per_s",
    "mode_table",
    "second",
)
"""Keys of a tap that rings."""
_ONE_MODE: Final = _RINGING[:4]
"""Keys of one that rings alike at all speeds."""


class Tap(AimedKeys):
    """The vibration that begins when the surface is touched: its amplitude A follows the approach speed."""

    model_config = ConfigDict(
        json_schema_extra={
            "allOf": [
                one_of("frequency_hz", "angular_frequency_rad_per_s", "waveform", "mode_table"),
                one_of("decay_time_s", "decay_rate_per_s", "waveform", "mode_table"),
                {"not": given("second", "waveform")},
                one_of("attack_slope_per_s", "amplitudes"),
                ONE_DIRECTION,
            ]
        }
    )

    attack_slope_per_s: Annotated[float, Field(ge=0, le=1e5)] | None = Field(
        default=None, description="Amplitude per approach speed."
    )
    amplitudes: (
        Annotated[
            tuple[TapPoint, ...],
            Strict(False),
            Field(min_length=1, max_length=MAX_TAP_POINTS),
            at_most(MAX_TAP_POINTS),
        ]
        | None
    ) = Field(default=None, description="Instead of the slope: [approach speed in m/s, amplitude in m/s^2], rising.")
    attack: Attack = Field(
        default="coefficient",
        description="What the amplitude means: A of the equation, or the largest acceleration (of a mode: of its first "
        "cycle).",
    )
    mode_table: ModeTable | None = Field(
        default=None, description="Frequency and decay time over the approach speed, instead of one of each."
    )
    second: SecondMode | None = Field(default=None, description="A mode that is struck together with this one.")
    waveform: Waveform | None = Field(default=None, description="A curve that is played, instead of a mode that rings.")

    def mode_faults(self) -> list[str]:
        if self.waveform is not None:
            why, excluded = "has a waveform, and does not ring", _RINGING
        elif self.mode_table is not None:
            why, excluded = "has a mode_table, which says frequency and decay", _ONE_MODE
        else:
            return super().mode_faults()
        given = [name for name in excluded if getattr(self, name) is not None]
        return [f"{why}: leave out {' and '.join(given)}"] if given else []

    @property
    def mode(self) -> Mode:
        """Of a table that in the middle of its speeds."""
        return super().mode if self.mode_table is None else self.mode_table.middle

    def mode_at(self, speed_m_per_s: float) -> Mode:
        """What a tap at this approach speed rings with."""
        return self.mode if self.mode_table is None else self.mode_table.at(speed_m_per_s)

    @property
    def modes(self) -> tuple[Mode, ...]:
        """What it rings with; of a table the modes of its lowest and of its highest frequency, none of a waveform."""
        if self.waveform is not None:
            return ()
        return (self.mode,) if self.mode_table is None else self.mode_table.bounds

    @property
    def ringing(self) -> Mode | None:
        """The mode; None of a waveform."""
        return None if self.waveform is not None else self.mode

    @property
    def one_mode(self) -> Mode | None:
        """The mode of a tap that rings alike at all speeds; None of a table and of a waveform."""
        return None if self.mode_table is not None else self.ringing

    def coefficient(self, amplitude: float) -> float:
        """The A of the mode's or the waveform's equation for an amplitude as `attack` means it."""
        return (self.waveform or self.mode).coefficient(amplitude, self.attack)

    def cross_faults(self) -> list[str]:
        faults = [*super().cross_faults(), *one_of_two(self, "attack_slope_per_s", "amplitudes")]
        for index, ((before, _), (speed, _)) in enumerate(pairwise(self.amplitudes or ())):
            if speed < before + MIN_TAP_STEP_M_PER_S:
                faults.append(
                    f"amplitudes[{index + 1}] must be at a speed at least {MIN_TAP_STEP_M_PER_S:g} m/s above the one "
                    f"before, {before:g}, is at {speed:g}"
                )
                break
        return faults

    def amplitude_m_per_s2(self, speed_m_per_s: float) -> float:
        """The amplitude at an approach speed of at least 0. Straight lines between the points, from rest (0) to the
        first, and on as the last one beyond, never below 0."""
        if self.attack_slope_per_s is not None:
            return self.attack_slope_per_s * speed_m_per_s
        assert self.amplitudes is not None
        points = ((0.0, 0.0), *self.amplitudes)
        end = next((i for i in range(1, len(points)) if points[i][0] >= speed_m_per_s), len(points) - 1)
        (from_speed, low), (to_speed, high) = points[end - 1], points[end]
        return max(0.0, low + (high - low) * (speed_m_per_s - from_speed) / (to_speed - from_speed))


class Rupture(AimedKeys):
    """How a membrane breaks, and the ringing when it does. Means something for membranes only."""

    model_config = ConfigDict(
        json_schema_extra={
            "allOf": [
                one_of("frequency_hz", "angular_frequency_rad_per_s"),
                one_of("decay_time_s", "decay_rate_per_s"),
                one_of("depth_m", "max_strain radius_m"),
                ONE_DIRECTION,
            ]
        }
    )

    depth_m: Annotated[float, Field(ge=1e-6, le=1)] | None = Field(
        default=None, description="Deflection at which the membrane ruptures."
    )
    max_strain: Annotated[float, Field(ge=1e-6, le=10)] | None = Field(
        default=None, description="Largest strain, instead of depth_m and together with radius_m."
    )
    radius_m: Annotated[float, Field(ge=1e-4, le=1)] | None = Field(
        default=None, description="Radius over which the membrane is stretched, with max_strain."
    )
    amplitude_m_per_s2: float = Field(ge=0, le=1e5, description="A of the ringing, at any speed.")
    heals: bool = Field(default=False, description="Whether it closes again when the probe withdraws.")

    def cross_faults(self) -> list[str]:
        faults = super().cross_faults()
        given = [name for name in ("depth_m", "max_strain", "radius_m") if getattr(self, name) is not None]
        if given not in (["depth_m"], ["max_strain", "radius_m"]):
            has = " and ".join(given) or "none of them"
            faults.append(f"needs either depth_m or both max_strain and radius_m, has {has}")
        return faults

    @property
    def rupture_depth_m(self) -> float:
        """depth_m, or R sqrt((1 + strain)^2 - 1): a membrane of radius R drawn to a cone."""
        if self.depth_m is not None:
            return self.depth_m
        assert self.max_strain is not None
        assert self.radius_m is not None
        return self.radius_m * math.sqrt(self.max_strain * (2 + self.max_strain))


class Friction(Model):
    """Dry friction, Coulomb's: at rest a spring holds the probe until it slides."""

    coefficient: float = Field(ge=0, le=10, description="Tangential over normal force, where it slides.")
    stiffness_n_per_m: float = Field(
        default=500.0, ge=1e-3, le=1e5, description="Force per distance from where the probe sticks, before it slides."
    )


class ProvenanceFile(Model):
    """A recording that a material was fitted to."""

    path: Annotated[str, StringConstraints(min_length=1, max_length=4096)] = Field(description="Where it was.")
    sha256: Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}$")] | None = Field(
        default=None, description="Hash of its bytes, in hex digits; none of what was never a file."
    )


class FitVerdict(Model):
    """What a fit is worth: good; fair, where something speaks against it; poor, where it should not be used."""

    quality: Literal["good", "fair", "poor"] = Field(description="Of the fit.")
    reasons: Annotated[
        tuple[Reason, ...],
        Strict(False),
        Field(max_length=MAX_REASONS),
        at_most(MAX_REASONS),
    ] = Field(default=(), description="Why it is not good.")


class Provenance(Model):
    """Where the figures of a material come from; nothing that is rendered."""

    files: Annotated[tuple[ProvenanceFile, ...], Strict(False), at_most(MAX_PROVENANCE_FILES)] = Field(
        min_length=1, max_length=MAX_PROVENANCE_FILES, description="The recordings."
    )
    date: Annotated[str, StringConstraints(pattern=r"^[0-9]{4}-[0-9]{2}-[0-9]{2}$"), AfterValidator(_a_day)] = Field(
        description="Day of the fit, year-month-day."
    )
    version: Annotated[str, StringConstraints(min_length=1, max_length=64)] = Field(description="Of hapticd.")
    intervals: Annotated[dict[Words, Interval], Field(max_length=256)] | None = Field(
        default=None, description="95 % intervals, [low, high], by the name of the figure."
    )
    verdict: Annotated[dict[Words, FitVerdict], Field(max_length=16)] | None = Field(
        default=None, description="What each fit is worth, by its kind: tap, grooves, texture, puncture."
    )
    choices: Annotated[dict[Words, Reason], Field(max_length=64)] | None = Field(
        default=None, description="Which of several models was chosen, and why, by the name of the figure."
    )


class Material(Model):
    """What a surface is made of."""

    model_config = ConfigDict(
        json_schema_extra={
            "if": {"required": ["texture"], "properties": {"texture": WITHOUT_MODE}},
            "then": {"allOf": [given("tap"), {"properties": {"tap": absent("mode_table", "waveform")}}]},
        }
    )

    stiffness_n_per_m: Stiffness = Field(description="Force per penetration or deflection.")
    damping_n_s_per_m: Damping = Field(default=0.0, description="Force per speed along the normal.")
    tap: Tap | None = Field(default=None, description="Ringing at the touch; without it a touch is silent.")
    rupture: Rupture | None = Field(
        default=None, description="How a membrane breaks; without it a membrane never does."
    )
    friction: Friction | None = Field(default=None, description="What holds against stroking; without it, nothing.")
    # After `tap`, which grooves may ring with.
    texture: Texture | None = Field(default=None, description="What stroking feels like; without it, smooth.")
    provenance: Provenance | None = Field(default=None, description="Where the figures come from, if it was fitted.")

    @field_validator("texture", mode="after")
    @classmethod
    def _has_a_mode(cls, texture: Texture | None, info: ValidationInfo) -> Texture | None:
        if not isinstance(texture, Grooves) or texture.display != "vibration" or texture.own_modes:
            return texture
        # A tap that is itself faulty is not in `data`; then its own fault is enough.
        tap = info.data.get("tap", True)
        if tap is None:
            other = "or a tap of the material"
        elif isinstance(tap, Tap) and tap.one_mode is None:
            other = f"as the tap {'is a waveform' if tap.mode_table is None else 'has a mode_table'}"
        else:
            return texture
        raise ValueError(f"needs a mode to ring with: frequency_hz and decay_time_s of its own, {other}")

    @property
    def fitted(self) -> Mapping[str, FitVerdict]:
        """What each fit of it is worth, by its kind; empty where nothing was fitted."""
        return {} if self.provenance is None else self.provenance.verdict or {}

    @property
    def groove_modes(self) -> tuple[Mode, ...]:
        """What a groove displayed as vibration rings with: the texture's own mode, of a table of frequencies that of
        the lowest and that of the highest, or the tap's; else nothing."""
        if not isinstance(self.texture, Grooves) or self.texture.display != "vibration":
            return ()
        own = self.texture.own_modes
        if own:
            return own
        assert self.tap is not None
        return (self.tap.mode,)

    @property
    def groove_mode(self) -> Mode | None:
        """The first of groove_modes; None where there is none."""
        return next(iter(self.groove_modes), None)

    def groove_mode_at(self, speed_m_per_s: float, force_n: float) -> Mode | None:
        """What a groove that is passed with this tangential speed and normal force rings with."""
        mode = self.groove_mode
        if mode is None or not isinstance(self.texture, Grooves) or self.texture.frequency_table is None:
            return mode
        frequency_hz = self.texture.frequency_table.at(speed_m_per_s, force_n)
        return Mode(mode.decay_rate_per_s, 2 * math.pi * frequency_hz)


class _Library(Model):
    materials: dict[Name, Material] = Field(max_length=MAX_MATERIALS)


Materials: TypeAlias = Mapping[str, Material]


def validate_materials(data: object, root: Path = ()) -> dict[str, Material]:
    """Materials by name from plain data. Raises InvalidError; `where` starts with `root`, `materials`."""
    return finish(material_steps(data, root))


def material_steps(data: object, root: Path = ()) -> Steps[dict[str, Material]]:
    """As validate_materials, with a pause after each: tens of models of a texture take tens of milliseconds."""
    if not isinstance(data, dict):
        return _parsed(data, root)
    check_count(data, MAX_MATERIALS, (*root, "materials"))
    return (yield from entry_by_entry(data, lambda part: _parsed(part, root), (*root, "materials")))


def _parsed(data: object, root: Path) -> dict[str, Material]:
    refuse_many_keys(data, (*root, "materials"))
    try:
        return _Library.parsed({"materials": data}).materials
    except ValidationError as error:
        raise InvalidError(problems_of(error, root)) from None


@cache
def shipped_materials() -> Materials:
    """The shipped library, every file of `config/materials`: the paper's materials first.

    Raises InvalidError for a fault in them, and for a name that two files define.
    """
    library: dict[str, Material] = {}
    for name in library_files():
        document = shipped_document(name)
        try:
            found = _Library.parsed(document.data).materials
        except ValidationError as error:
            raise InvalidError(Problem(document.where(path), text) for path, text in faults_of(error)) from None
        twice = [Problem(document.where(("materials", each)), "is defined twice") for each in found if each in library]
        if twice:
            raise InvalidError(twice)
        library |= found
    return MappingProxyType(library)


def library_files() -> list[str]:
    """The files of the shipped library, by their path below `config/`."""
    folder = resources.files("hapticd.shipped").joinpath(LIBRARY)
    names = [file.name for file in folder.iterdir() if file.name.endswith(".yaml")]
    return [f"{LIBRARY}/{name}" for name in sorted(names, key=lambda name: (name != _FIRST, name))]


def shipped_document(name: str) -> Document:
    """A YAML file that ships with hapticd, by its path below `config/`."""
    resource = resources.files("hapticd.shipped").joinpath(name)
    return load_bytes(resource.read_bytes(), f"hapticd/shipped/{name}")
