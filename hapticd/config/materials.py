"""Materials, and the library that ships with hapticd. modes.py defines the ringing mode Q(t)."""

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
"""Maximum number of materials of a configuration."""
LIBRARY_FOLDER: Final = "materials"
"""Folder of the shipped materials, below `config/`."""
_FIRST_LIBRARY_FILE: Final = "okamura1998.yaml"
"""First file of the library: the materials of Okamura et al."""
MAX_TAP_POINTS: Final = 256
"""Maximum number of `tap.amplitudes`: the core's HD_TAP_POINTS."""
MIN_TAP_STEP_M_PER_S: Final = 1e-6
"""Minimum difference of successive approach speeds of `tap.amplitudes`."""
MAX_PROVENANCE_FILES: Final = 1000
"""Maximum number of recordings that the provenance of a material lists."""
MAX_REASONS: Final = 64
"""Maximum number of reasons that the verdict on a fit (good, fair or poor) lists."""
MAX_REASON_CHARACTERS: Final = 1000
"""Maximum length of one reason of a verdict on a fit."""

TapPoint: TypeAlias = Annotated[
    tuple[Annotated[float, Field(ge=1e-4, le=100)], Annotated[float, Field(ge=0, le=1e5)]], Strict(False)
]
"""A point of a tap's amplitude over approach speed: [speed in m/s, amplitude in m/s^2]."""


def _rising(interval: tuple[float, float]) -> tuple[float, float]:
    if interval[0] > interval[1]:
        raise ValueError(f"must be [low, high], low <= high, is {list(interval)}")
    return interval


def _a_day(text: str) -> str:
    try:
        datetime.date.fromisoformat(text)
    except ValueError:
        raise ValueError(f"must be a date such as 2026-11-29, is {quoted(text)}") from None
    return text


Interval: TypeAlias = Annotated[
    tuple[Annotated[float, Field(ge=-1e12, le=1e12)], Annotated[float, Field(ge=-1e12, le=1e12)]],
    Strict(False),
    AfterValidator(_rising),
]
"""A confidence interval [low, high], in the unit of the fitted value."""
Words: TypeAlias = Annotated[str, StringConstraints(min_length=1, max_length=256, pattern=r"^[^\u0000-\u001f\u007f]+$")]


Reason: TypeAlias = Annotated[str, StringConstraints(min_length=1, max_length=MAX_REASON_CHARACTERS)]


class SecondMode(ModeKeys):
    """A second mode that starts together with the tap's first mode."""

    ratio: float = Field(ge=-10, le=10, description="Amplitude relative to the first mode.")


_RINGING_KEYS: Final[tuple[str, ...]] = (
    "frequency_hz",
    "angular_frequency_rad_per_s",
    "decay_time_s",
    "decay_rate_per_s",
    "mode_table",
    "second",
)
"""Keys of a tap that is played as modes, not as a waveform."""
_ONE_MODE_KEYS: Final = _RINGING_KEYS[:4]
"""Keys of a tap with the same mode at all approach speeds."""


class Tap(AimedKeys):
    """Vibration at the moment of contact; its amplitude A depends on the approach speed."""

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
        default=None, description="Amplitude divided by approach speed."
    )
    amplitudes: (
        Annotated[
            tuple[TapPoint, ...],
            Strict(False),
            Field(min_length=1, max_length=MAX_TAP_POINTS),
            at_most(MAX_TAP_POINTS),
        ]
        | None
    ) = Field(
        default=None, description="Instead of the slope: [approach speed in m/s, amplitude in m/s^2], in rising order."
    )
    attack: Attack = Field(
        default="coefficient",
        description="Meaning of the amplitude: A of the equation, or the largest acceleration (of a mode, in its first "
        "cycle).",
    )
    mode_table: ModeTable | None = Field(
        default=None, description="Table of frequency and decay time over approach speed, instead of one mode."
    )
    second: SecondMode | None = Field(default=None, description="A second mode that starts together with the first.")
    waveform: Waveform | None = Field(default=None, description="A waveform that is played instead of a mode.")

    def mode_faults(self) -> list[str]:
        """Return the faults of the keys of the tap's ringing modes."""
        if self.waveform is not None:
            why, excluded = "has a waveform instead of a mode", _RINGING_KEYS
        elif self.mode_table is not None:
            why, excluded = "has a mode_table, which gives frequency and decay", _ONE_MODE_KEYS
        else:
            return super().mode_faults()
        given = [name for name in excluded if getattr(self, name) is not None]
        return [f"{why}: leave out {' and '.join(given)}"] if given else []

    @property
    def mode(self) -> Mode:
        """The tap's ringing mode; for a table of modes over approach speed, the mode in the middle of the speeds."""
        return super().mode if self.mode_table is None else self.mode_table.middle

    def mode_at(self, speed_m_per_s: float) -> Mode:
        """Return the ringing mode of a tap at this approach speed."""
        return self.mode if self.mode_table is None else self.mode_table.at(speed_m_per_s)

    @property
    def modes(self) -> tuple[Mode, ...]:
        """The tap's ringing mode; for a mode table its modes of lowest and highest frequency; empty for a waveform."""
        if self.waveform is not None:
            return ()
        return (self.mode,) if self.mode_table is None else self.mode_table.bounds

    @property
    def ringing(self) -> Mode | None:
        """The tap's ringing mode as in `mode`, but None for a tap that is played as a waveform."""
        return None if self.waveform is not None else self.mode

    @property
    def one_mode(self) -> Mode | None:
        """The tap's ringing mode if it is the same at all approach speeds; None for a mode table or a waveform."""
        return None if self.mode_table is not None else self.ringing

    def coefficient(self, amplitude: float) -> float:
        """Return the coefficient A of the mode Q(t) or of the waveform, for an amplitude as `attack` defines it."""
        return (self.waveform or self.mode).coefficient(amplitude, self.attack)

    @property
    def largest_slope_per_s(self) -> float:
        """Largest amplitude A over the approach speed, in 1/s."""
        if self.attack_slope_per_s is not None:
            return self.attack_slope_per_s
        assert self.amplitudes is not None
        points = ((0.0, 0.0), *self.amplitudes)
        (before, low), (speed, high) = points[-2:]
        beyond = (high - low) / (speed - before)
        return max(beyond, *(amplitude / speed for speed, amplitude in self.amplitudes))

    def cross_faults(self) -> list[str]:
        """Return a text for each invalid combination of keys."""
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
        """Return the amplitude of a tap at an approach speed of at least 0.

        The amplitude is interpolated linearly between (0, 0) and the points. Beyond the last point the last segment is
        extended, but not below 0.
        """
        if self.attack_slope_per_s is not None:
            return self.attack_slope_per_s * speed_m_per_s
        assert self.amplitudes is not None
        points = ((0.0, 0.0), *self.amplitudes)
        end = next((i for i in range(1, len(points)) if points[i][0] >= speed_m_per_s), len(points) - 1)
        (from_speed, low), (to_speed, high) = points[end - 1], points[end]
        return max(0.0, low + (high - low) * (speed_m_per_s - from_speed) / (to_speed - from_speed))


class Rupture(AimedKeys):
    """Rupture of a membrane, and the ringing that it starts. Other objects ignore it."""

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
        default=None, description="Strain at which the membrane ruptures, with radius_m, instead of depth_m."
    )
    radius_m: Annotated[float, Field(ge=1e-4, le=1)] | None = Field(
        default=None, description="Radius over which the membrane is stretched, with max_strain."
    )
    amplitude_m_per_s2: float = Field(ge=0, le=1e5, description="Amplitude A of the ringing, at any speed.")
    heals: bool = Field(default=False, description="Whether the membrane heals when the probe withdraws.")

    def cross_faults(self) -> list[str]:
        """Return a text for each invalid combination of keys."""
        faults = super().cross_faults()
        given = [name for name in ("depth_m", "max_strain", "radius_m") if getattr(self, name) is not None]
        if given not in (["depth_m"], ["max_strain", "radius_m"]):
            has = " and ".join(given) or "none of them"
            faults.append(f"needs either depth_m or both max_strain and radius_m, has {has}")
        return faults

    @property
    def rupture_depth_m(self) -> float:
        """Depth at rupture: depth_m, or R sqrt((1 + strain)^2 - 1) for a membrane of radius R stretched to a cone."""
        if self.depth_m is not None:
            return self.depth_m
        assert self.max_strain is not None
        assert self.radius_m is not None
        return self.radius_m * math.sqrt(self.max_strain * (2 + self.max_strain))


class Friction(Model):
    """Coulomb friction: at rest a spring holds the probe until it slides."""

    coefficient: float = Field(ge=0, le=10, description="Tangential force divided by normal force while sliding.")
    stiffness_n_per_m: float = Field(
        default=500.0, ge=1e-3, le=1e5, description="Stiffness of the spring that holds the probe while it sticks."
    )


class ProvenanceFile(Model):
    """A recording that a material was fitted to."""

    path: Annotated[str, StringConstraints(min_length=1, max_length=4096)] = Field(
        description="Path of the recording at the time of the fit."
    )
    sha256: Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}$")] | None = Field(
        default=None, description="Hash of the file, in hex digits; left out for data that was not read from a file."
    )


class FitVerdict(Model):
    """Quality of a fit: good; fair if there are reasons to doubt it; poor if it should not be used."""

    quality: Literal["good", "fair", "poor"] = Field(description="Quality of the fit.")
    reasons: Annotated[
        tuple[Reason, ...],
        Strict(False),
        Field(max_length=MAX_REASONS),
        at_most(MAX_REASONS),
    ] = Field(default=(), description="Reasons why the quality is not good.")


class Provenance(Model):
    """Origin of a material's values. It has no influence on forces."""

    files: Annotated[tuple[ProvenanceFile, ...], Strict(False), at_most(MAX_PROVENANCE_FILES)] = Field(
        min_length=1, max_length=MAX_PROVENANCE_FILES, description="The recordings that were fitted."
    )
    date: Annotated[str, StringConstraints(pattern=r"^[0-9]{4}-[0-9]{2}-[0-9]{2}$"), AfterValidator(_a_day)] = Field(
        description="Day of the fit, year-month-day."
    )
    version: Annotated[str, StringConstraints(min_length=1, max_length=64)] = Field(description="Version of hapticd.")
    intervals: Annotated[dict[Words, Interval], Field(max_length=256)] | None = Field(
        default=None, description="95 % intervals, [low, high], by the name of the fitted value."
    )
    verdict: Annotated[dict[Words, FitVerdict], Field(max_length=16)] | None = Field(
        default=None, description="Verdict of each fit, by its kind: tap, grooves, texture, puncture."
    )
    choices: Annotated[dict[Words, Reason], Field(max_length=64)] | None = Field(
        default=None, description="Model chosen among several, and the reason, by the name of the fitted value."
    )


class Material(Model):
    """Properties of a surface."""

    model_config = ConfigDict(
        json_schema_extra={
            "if": {"required": ["texture"], "properties": {"texture": WITHOUT_MODE}},
            "then": {"allOf": [given("tap"), {"properties": {"tap": absent("mode_table", "waveform")}}]},
        }
    )

    stiffness_n_per_m: Stiffness = Field(description="Normal force per penetration depth or deflection.")
    damping_n_s_per_m: Damping = Field(default=0.0, description="Normal force per normal speed.")
    tap: Tap | None = Field(default=None, description="Vibration at contact; without it a contact makes no vibration.")
    rupture: Rupture | None = Field(
        default=None, description="Rupture of a membrane; without it a membrane never ruptures."
    )
    friction: Friction | None = Field(default=None, description="Coulomb friction; without it there is no friction.")
    # Defined after `tap`, whose mode grooves may use.
    texture: Texture | None = Field(
        default=None, description="Texture under a stroke; without it the surface is smooth."
    )
    provenance: Provenance | None = Field(default=None, description="Origin of the values of a fitted material.")

    @field_validator("texture", mode="after")
    @classmethod
    def _has_a_mode(cls, texture: Texture | None, info: ValidationInfo) -> Texture | None:
        if not isinstance(texture, Grooves) or texture.display != "vibration" or texture.own_modes:
            return texture
        # A faulty tap is not in `data`; then its fault is enough.
        tap = info.data.get("tap", True)
        if tap is None:
            other = "or a tap of the material"
        elif isinstance(tap, Tap) and tap.one_mode is None:
            other = f"because the tap {'is a waveform' if tap.mode_table is None else 'has a mode_table'}"
        else:
            return texture
        raise ValueError(f"needs a mode: frequency_hz and decay_time_s of the texture, {other}")

    @property
    def fitted(self) -> Mapping[str, FitVerdict]:
        """Verdict of each fit, by its kind; empty if nothing was fitted."""
        return {} if self.provenance is None else self.provenance.verdict or {}

    @property
    def groove_modes(self) -> tuple[Mode, ...]:
        """Ringing modes of grooves that are displayed as vibration; empty for another texture.

        They are the texture's mode, for a frequency table its modes of lowest and highest frequency, or without both
        the tap's mode.
        """
        if not isinstance(self.texture, Grooves) or self.texture.display != "vibration":
            return ()
        own = self.texture.own_modes
        if own:
            return own
        assert self.tap is not None
        return (self.tap.mode,)

    @property
    def groove_mode(self) -> Mode | None:
        """The first mode with which grooves ring (see groove_modes), or None if no groove rings."""
        return next(iter(self.groove_modes), None)

    def groove_mode_at(self, speed_m_per_s: float, force_n: float) -> Mode | None:
        """Return the mode of a groove at this tangential speed and normal force, or None if no groove rings."""
        mode = self.groove_mode
        if mode is None or not isinstance(self.texture, Grooves) or self.texture.frequency_table is None:
            return mode
        frequency_hz = self.texture.frequency_table.at(speed_m_per_s, force_n)
        return Mode(mode.decay_rate_per_s, 2 * math.pi * frequency_hz)


class _Library(Model):
    materials: dict[Name, Material] = Field(max_length=MAX_MATERIALS)


Materials: TypeAlias = Mapping[str, Material]


def validate_materials(data: object, root: Path = ()) -> dict[str, Material]:
    """Validate materials by name, given as plain data. Raises InvalidError with paths that begin with `root`."""
    return finish(material_steps(data, root))


def material_steps(data: object, root: Path = ()) -> Steps[dict[str, Material]]:
    """Validate materials as validate_materials does, and pause after each: a large texture takes tens of ms."""
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
    """Load the shipped library: all files of `config/materials`, those of Okamura et al. first.

    Raises InvalidError for a fault in a file, and for a material that two files define.
    """
    library: dict[str, Material] = {}
    for file in library_files():
        document = shipped_document(file)
        try:
            added = _Library.parsed(document.data).materials
        except ValidationError as error:
            raise InvalidError(Problem(document.where(path), text) for path, text in faults_of(error)) from None
        twice = [Problem(document.where(("materials", name)), "is defined twice") for name in added if name in library]
        if twice:
            raise InvalidError(twice)
        library |= added
    return MappingProxyType(library)


def library_files() -> list[str]:
    """Return the paths of the shipped library's files, below `config/`."""
    folder = resources.files("hapticd.shipped").joinpath(LIBRARY_FOLDER)
    names = [file.name for file in folder.iterdir() if file.name.endswith(".yaml")]
    return [f"{LIBRARY_FOLDER}/{name}" for name in sorted(names, key=lambda name: (name != _FIRST_LIBRARY_FILE, name))]


def shipped_document(name: str) -> Document:
    """Load a shipped YAML file by its path below `config/`."""
    resource = resources.files("hapticd.shipped").joinpath(name)
    return load_bytes(resource.read_bytes(), f"hapticd/shipped/{name}")
