"""Materials: what a surface is made of, and the library that ships with hapticd.

A ringing mode is Q(t) = A exp(-B t) sin(w t) (Okamura, Dennerlein and Howe, "Vibration Feedback Models for
Virtual Environments", ICRA 1998, eq. 1 and 3), B the decay rate in 1/s, w the angular frequency in rad/s.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from types import MappingProxyType
from typing import Annotated, Literal, Self, TypeAlias

from pydantic import ConfigDict, Field, ValidationError, model_validator
from pydantic.config import JsonDict

from hapticd.errors import InvalidError, Path, Problem
from hapticd.model import Damping, Model, Name, Stiffness, faults_of, problems_of
from hapticd.yaml_source import Document, load_bytes

MAX_MATERIALS = 4096
LIBRARY = "materials/okamura1998.yaml"

Attack: TypeAlias = Literal["coefficient", "first_peak"]


@dataclass(frozen=True, slots=True)
class Mode:
    """A decaying sinusoid exp(-B t) sin(w t), t >= 0."""

    decay_rate_per_s: float
    angular_frequency_rad_per_s: float

    @property
    def frequency_hz(self) -> float:
        return self.angular_frequency_rad_per_s / (2 * math.pi)

    @property
    def decay_time_s(self) -> float:
        return 1 / self.decay_rate_per_s

    @property
    def peak_time_s(self) -> float:
        """Time of the first maximum: atan(w/B)/w, where the derivative is zero."""
        w = self.angular_frequency_rad_per_s
        return math.atan2(w, self.decay_rate_per_s) / w

    @property
    def peak(self) -> float:
        """The first maximum, a number below 1."""
        time_s = self.peak_time_s
        return math.exp(-self.decay_rate_per_s * time_s) * math.sin(self.angular_frequency_rad_per_s * time_s)

    def coefficient(self, amplitude: float, attack: Attack) -> float:
        """The A of eq. 1 for an amplitude that means A itself, or the largest value of the first cycle."""
        return amplitude if attack == "coefficient" else amplitude / self.peak


def _one_of(*names: str) -> JsonDict:
    return {"oneOf": [{"required": [*name.split()]} for name in names]}


class ModeKeys(Model):
    """A ringing mode: one of frequency and angular frequency, and one of decay time and decay rate."""

    model_config = ConfigDict(
        json_schema_extra={
            "allOf": [
                _one_of("frequency_hz", "angular_frequency_rad_per_s"),
                _one_of("decay_time_s", "decay_rate_per_s"),
            ]
        }
    )

    frequency_hz: Annotated[float, Field(ge=0.01, le=1e5)] | None = Field(
        default=None, description="Frequency of the ringing."
    )
    angular_frequency_rad_per_s: Annotated[float, Field(ge=0.05, le=1e6)] | None = Field(
        default=None, description="2 pi times the frequency, instead of it."
    )
    decay_time_s: Annotated[float, Field(ge=1e-6, le=10)] | None = Field(
        default=None, description="Time in which the ringing falls to 1/e; it ends after five of them."
    )
    decay_rate_per_s: Annotated[float, Field(ge=0.1, le=1e6)] | None = Field(
        default=None, description="1 over the decay time, instead of it."
    )

    def cross_faults(self) -> list[str]:
        """Faults between keys that are each sound."""
        faults = []
        for one, other in (
            ("frequency_hz", "angular_frequency_rad_per_s"),
            ("decay_time_s", "decay_rate_per_s"),
        ):
            given = [name for name in (one, other) if getattr(self, name) is not None]
            if len(given) != 1:
                faults.append(f"needs exactly one of {one} and {other}, has {'both' if given else 'neither'}")
        return faults

    @model_validator(mode="after")
    def _refuse_cross_faults(self) -> Self:
        faults = self.cross_faults()
        if faults:
            raise ValueError("; ".join(faults))
        return self

    @property
    def mode(self) -> Mode:
        if self.decay_rate_per_s is not None:
            decay_rate_per_s = self.decay_rate_per_s
        else:
            assert self.decay_time_s is not None
            decay_rate_per_s = 1 / self.decay_time_s
        if self.angular_frequency_rad_per_s is not None:
            angular_frequency_rad_per_s = self.angular_frequency_rad_per_s
        else:
            assert self.frequency_hz is not None
            angular_frequency_rad_per_s = 2 * math.pi * self.frequency_hz
        return Mode(decay_rate_per_s, angular_frequency_rad_per_s)


class Tap(ModeKeys):
    """The ringing that begins when the surface is touched: A is the slope times the approach speed."""

    attack_slope_per_s: float = Field(ge=0, le=1e5, description="Amplitude per approach speed.")
    attack: Attack = Field(
        default="coefficient",
        description="What the amplitude means: A of eq. 1, or the largest acceleration of the first cycle.",
    )


class Rupture(ModeKeys):
    """How a membrane breaks, and the ringing when it does. Means something for membranes only."""

    model_config = ConfigDict(
        json_schema_extra={
            "allOf": [
                _one_of("frequency_hz", "angular_frequency_rad_per_s"),
                _one_of("decay_time_s", "decay_rate_per_s"),
                _one_of("depth_m", "max_strain radius_m"),
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


class Material(Model):
    """What a wall or a membrane is made of."""

    stiffness_n_per_m: Stiffness = Field(description="Force per penetration or deflection.")
    damping_n_s_per_m: Damping = Field(default=0.0, description="Force per speed along the normal.")
    tap: Tap | None = Field(default=None, description="Ringing at the touch; without it a touch is silent.")
    rupture: Rupture | None = Field(
        default=None, description="How a membrane breaks; without it a membrane never does."
    )


class _Library(Model):
    materials: dict[Name, Material] = Field(max_length=MAX_MATERIALS)


Materials: TypeAlias = Mapping[str, Material]


def validate_materials(data: object, root: Path = ()) -> dict[str, Material]:
    """Materials by name from plain data. Raises InvalidError; `where` starts with `root`, `materials`."""
    try:
        return _Library.model_validate({"materials": data}).materials
    except ValidationError as error:
        raise InvalidError(problems_of(error, root)) from None


@cache
def shipped_materials() -> Materials:
    """The shipped library: the seven materials and the cellophane of the paper."""
    document = shipped_document(LIBRARY)
    try:
        return MappingProxyType(_Library.model_validate(document.data).materials)
    except ValidationError as error:
        raise InvalidError(Problem(document.where(path), text) for path, text in faults_of(error)) from None


def shipped_document(name: str) -> Document:
    """A YAML file that ships with hapticd, by its path below `config/`."""
    resource = resources.files("hapticd.shipped").joinpath(name)
    return load_bytes(resource.read_bytes(), f"hapticd/shipped/{name}")
