"""Textures: force and vibration of a surface while the probe strokes along it.

Grooves lie at s = k spacing, with s the tangential coordinate of the surface; they are displayed as vibration, as
geometry or as damping. Sandpaper is coloured noise whose power depends on tangential speed v and normal force F. It is
given by the peak and the mean of its spectrum (`stochastic`) or by models identified from recordings
(`autoregressive`).
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Final, Literal, Self, TypeAlias

from pydantic import (
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    Strict,
    model_serializer,
    model_validator,
)
from pydantic.config import JsonDict, JsonValue

from hapticd.base.lattice import reflection_of
from hapticd.base.model import CheckedTogether, Damping, Model, at_most, one_of_two
from hapticd.config.modes import (
    MAX_TABLE_POINTS,
    AngularFrequency,
    DecayRate,
    DecayTime,
    Direction,
    Frequency,
    Mode,
    ModeKeys,
    absent,
    around,
    given,
    one_of,
    rising_faults,
)

MAX_ORDER: Final = 32
"""Maximum order p of an autoregressive model."""
MAX_MODELS: Final = 64
"""Maximum number of autoregressive models of a texture."""
MAX_SEED: Final = 2**53
"""Maximum seed of a texture's noise: the largest integer that a JSON number holds exactly."""
MAX_RMS_M_PER_S2: Final = 1e6
"""Maximum RMS acceleration of a model."""

Display: TypeAlias = Literal["vibration", "geometry", "damping"]
Gain: TypeAlias = Annotated[float, Field(ge=-1e5, le=1e5)]
Threshold: TypeAlias = Annotated[float, Field(ge=1e-5, le=1)]
Seed: TypeAlias = Annotated[int, Field(ge=0, le=MAX_SEED)]
Coefficient: TypeAlias = Annotated[float, Field(ge=-1e9, le=1e9)]

_RINGING_MODE_KEYS: Final = tuple(ModeKeys.model_fields)
_ONE_FREQUENCY: Final = ("frequency_hz", "angular_frequency_rad_per_s")
_GAIN_KEYS: Final = ("velocity_gain_per_s", "force_gain_m_per_s2_per_n")
_KEYS_OF: Final[dict[Display, tuple[str, ...]]] = {
    "vibration": (*_GAIN_KEYS, *_RINGING_MODE_KEYS, "frequency_table"),
    "geometry": ("depth_m",),
    "damping": ("damping_n_s_per_m",),
}


def _displayed(display: Display) -> JsonDict:
    """Return the JSON Schema rule of a display: its keys are required, those of other displays are forbidden."""
    others = (key for other, keys in _KEYS_OF.items() if other != display for key in keys)
    rules: list[JsonValue] = [absent(*others)]
    if display == "vibration":
        mode: JsonDict = {
            "allOf": [one_of(*_ONE_FREQUENCY, "frequency_table"), one_of("decay_time_s", "decay_rate_per_s")]
        }
        rules += [_ABOVE_0, {"anyOf": [absent(*_RINGING_MODE_KEYS, "frequency_table"), mode]}]
    else:
        rules += map(given, _KEYS_OF[display])
    return {"if": {"properties": {"display": {"const": display}}}, "then": {"allOf": rules}}


_ABOVE_0: Final[JsonDict] = {
    "anyOf": [{"required": [key], "properties": {key: {"exclusiveMinimum": 0}}} for key in _GAIN_KEYS]
}
"""JSON Schema of a texture with a gain above 0."""
WITHOUT_MODE: Final[JsonDict] = {
    "allOf": [
        {"type": "object", "required": ["kind", "display"]},
        {"properties": {"kind": {"const": "grooves"}, "display": {"const": "vibration"}}},
        absent(*_RINGING_MODE_KEYS, "frequency_table"),
    ]
}
"""JSON Schema of grooves that use the mode of the material's tap."""


class FrequencyTable(CheckedTogether):
    """Table of the frequency of a groove's strikes over tangential speed and normal force."""

    speeds_m_per_s: Annotated[
        tuple[Annotated[float, Field(ge=0, le=100)], ...], Strict(False), at_most(MAX_TABLE_POINTS)
    ] = Field(min_length=1, max_length=MAX_TABLE_POINTS, description="Tangential speeds, in rising order.")
    forces_n: Annotated[
        tuple[Annotated[float, Field(ge=0, le=1000)], ...], Strict(False), at_most(MAX_TABLE_POINTS)
    ] = Field(min_length=1, max_length=MAX_TABLE_POINTS, description="Normal forces, in rising order.")
    frequencies_hz: Annotated[
        tuple[
            Annotated[
                tuple[Frequency, ...],
                Strict(False),
                Field(min_length=1, max_length=MAX_TABLE_POINTS),
                at_most(MAX_TABLE_POINTS),
            ],
            ...,
        ],
        Strict(False),
        at_most(MAX_TABLE_POINTS),
    ] = Field(
        min_length=1, max_length=MAX_TABLE_POINTS, description="For each speed a list with a frequency for each force."
    )

    def cross_faults(self) -> list[str]:
        """Return a text for each invalid combination of keys."""
        faults = [fault for key in ("speeds_m_per_s", "forces_n") for fault in rising_faults(key, getattr(self, key))]
        speeds, forces, rows = len(self.speeds_m_per_s), len(self.forces_n), self.frequencies_hz
        if len(rows) != speeds:
            faults.append(f"frequencies_hz must have a list for each speed, {speeds}, has {len(rows)}")
        for index, row in enumerate(rows):
            if len(row) != forces:
                faults.append(f"frequencies_hz[{index}] must have a frequency for each force, {forces}, has {len(row)}")
                break
        return faults

    @property
    def bounds_hz(self) -> tuple[float, float]:
        """The lowest and the highest frequency of the table, in Hz."""
        every = [frequency for row in self.frequencies_hz for frequency in row]
        return min(every), max(every)

    def at(self, speed_m_per_s: float, force_n: float) -> float:
        """Return the frequency in Hz by bilinear interpolation; outside the table, that at the nearest edge."""
        i, j, speed_share = around(self.speeds_m_per_s, abs(speed_m_per_s))
        k, m, force_share = around(self.forces_n, force_n)
        slower, faster = self.frequencies_hz[i], self.frequencies_hz[j]
        low, high = (row[k] + force_share * (row[m] - row[k]) for row in (slower, faster))
        return low + speed_share * (high - low)


class Grooves(CheckedTogether):
    """Grooves at equal distances, displayed as vibration, as geometry or as damping."""

    model_config = ConfigDict(
        json_schema_extra={"allOf": [_displayed("vibration"), _displayed("geometry"), _displayed("damping")]}
    )

    kind: Literal["grooves"] = Field(description="Kind of the texture.")
    display: Display = Field(description="How grooves are displayed: as strikes, as a lower surface, or as drag.")
    spacing_m: float = Field(ge=1e-5, le=1, description="Distance from one groove to the next.")
    width_m: float = Field(ge=1e-6, le=1, description="Width of a groove, at most the spacing.")
    velocity_gain_per_s: float = Field(
        default=0.0, ge=0, le=1e5, description="Vibration: amplitude of a strike divided by tangential speed."
    )
    force_gain_m_per_s2_per_n: float = Field(
        default=0.0, ge=0, le=1e5, description="Vibration: amplitude of a strike divided by normal force."
    )
    frequency_hz: Frequency | None = Field(
        default=None, description="Vibration: frequency of the ringing; without a mode, the tap's is used."
    )
    angular_frequency_rad_per_s: AngularFrequency | None = Field(
        default=None, description="Vibration: 2 pi times the frequency, instead of the frequency."
    )
    decay_time_s: DecayTime | None = Field(
        default=None, description="Vibration: time in which the ringing falls to 1/e."
    )
    decay_rate_per_s: DecayRate | None = Field(
        default=None, description="Vibration: 1/decay time, instead of the decay time."
    )
    frequency_table: FrequencyTable | None = Field(
        default=None, description="Vibration: table of the frequency over speed and force, instead of one frequency."
    )
    depth_m: Annotated[float, Field(ge=1e-6, le=0.1)] | None = Field(
        default=None, description="Geometry: depth of a groove in its middle; required."
    )
    damping_n_s_per_m: Damping | None = Field(
        default=None,
        description="Damping: force divided by tangential speed in the middle of a groove; required.",
    )

    @property
    def own_modes(self) -> tuple[Mode, ...]:
        """Ringing mode that each groove strikes; for a frequency table its modes of lowest and highest frequency.

        Empty if the texture itself has no mode.
        """
        keys = self._mode_keys()
        if keys is None:
            return ()
        if self.frequency_table is None:
            return (keys.mode,)
        bounds_hz = dict.fromkeys(self.frequency_table.bounds_hz)
        return tuple(replace(keys.mode, angular_frequency_rad_per_s=2 * math.pi * hz) for hz in bounds_hz)

    def _mode_keys(self) -> ModeKeys | None:
        """Return the keys of the grooves' ringing mode, at the lowest frequency of a table; None without a mode."""
        given = {key: value for key in _RINGING_MODE_KEYS if (value := getattr(self, key)) is not None}
        if self.frequency_table is not None:
            given = {key: value for key, value in given.items() if key not in _ONE_FREQUENCY}
            given["frequency_hz"] = self.frequency_table.bounds_hz[0]
        return ModeKeys.model_construct(**given) if given else None

    def _mode_faults(self) -> list[str]:
        mode = self._mode_keys()
        faults = [] if mode is None else mode.cross_faults()
        if self.frequency_table is not None:
            faults += [
                f"needs exactly one of frequency_table and {key}, has both"
                for key in _ONE_FREQUENCY
                if getattr(self, key) is not None
            ]
        return faults

    def cross_faults(self) -> list[str]:
        """Return a text for each invalid combination of keys."""
        faults = []
        if self.width_m > self.spacing_m:
            faults.append(f"width_m must be at most spacing_m, {self.spacing_m:.15g}, is {self.width_m:.15g}")
        for display, keys in _KEYS_OF.items():
            if display != self.display:
                faults += [
                    f"{key} belongs to display {display}, but display is {self.display}"
                    for key in keys
                    if key in self.model_fields_set and getattr(self, key) is not None
                ]
        match self.display:
            case "vibration":
                if not any(getattr(self, key) > 0 for key in _GAIN_KEYS):
                    faults.append(f"needs {_GAIN_KEYS[0]} or {_GAIN_KEYS[1]} above 0; otherwise the texture is silent")
                faults += self._mode_faults()
            case "geometry" if self.depth_m is None:
                faults.append("needs depth_m to be displayed as geometry")
            case "damping" if self.damping_n_s_per_m is None:
                faults.append("needs damping_n_s_per_m to be displayed as damping")
        return faults

    @model_serializer(mode="wrap")
    def _without_keys_of_other_displays(self, serialized: SerializerFunctionWrapHandler) -> dict[str, object]:
        others = {key for display, keys in _KEYS_OF.items() if display != self.display for key in keys}
        data: dict[str, object] = serialized(self)
        return {key: value for key, value in data.items() if key not in others}


class Stochastic(Model):
    """Coloured noise with a given spectrum, whose RMS grows with speed and force."""

    model_config = ConfigDict(json_schema_extra=_ABOVE_0)

    kind: Literal["stochastic"] = Field(description="Kind of the texture.")
    peak_hz: Frequency = Field(description="Frequency of the spectrum's maximum.")
    mean_hz: Frequency = Field(description="Mean frequency: the power's centroid from 0 to half the servo rate.")
    velocity_gain_per_s: Gain = Field(default=0.0, description="RMS acceleration divided by tangential speed.")
    force_gain_m_per_s2_per_n: Gain = Field(default=0.0, description="RMS acceleration divided by normal force.")
    threshold_m_per_s: Threshold = Field(
        default=0.002, description="Tangential speed below which the noise fades; at rest it is silent."
    )
    direction: Direction = Field(
        default="tangent", description="Direction of the force: `tangent` or `normal` to the surface."
    )
    seed: Seed = Field(default=1, description="The same seed and motion give the same samples.")

    @model_validator(mode="after")
    def _is_not_silent(self) -> Self:
        if max(self.velocity_gain_per_s, self.force_gain_m_per_s2_per_n) <= 0:
            raise ValueError(f"needs {_GAIN_KEYS[0]} or {_GAIN_KEYS[1]} above 0; otherwise the texture is silent")
        return self


class AutoregressiveModel(CheckedTogether):
    """A noise model x[n] = -(a_1 x[n-1] + ... + a_p x[n-p]) + e[n], identified at one speed and force; e is noise."""

    model_config = ConfigDict(json_schema_extra=one_of("rms_m_per_s2", "variance_m2_per_s4"))

    speed_m_per_s: float = Field(ge=0, le=10, description="Tangential speed of the recording.")
    force_n: float = Field(ge=0, le=100, description="Normal force of the recording.")
    coefficients: Annotated[tuple[Coefficient, ...], Strict(False), at_most(MAX_ORDER)] = Field(
        min_length=1, max_length=MAX_ORDER, description="a_1 to a_p; all poles are inside the unit circle."
    )
    rms_m_per_s2: Annotated[float, Field(ge=0, le=1e5)] | None = Field(
        default=None, description="RMS of x, the texture's acceleration."
    )
    variance_m2_per_s4: Annotated[float, Field(ge=0, le=1e10)] | None = Field(
        default=None, description="Variance of the innovation e, instead of the RMS of x."
    )

    def level(self, reflection: Sequence[float]) -> float:
        """Return the RMS of x in m/s^2: as given, or sqrt(variance / prod(1 - k^2)) for reflection coefficients k."""
        if self.rms_m_per_s2 is not None:
            return self.rms_m_per_s2
        assert self.variance_m2_per_s4 is not None
        power = math.prod(1.0 - k * k for k in reflection)
        return math.sqrt(self.variance_m2_per_s4 / power) if power > 0 else math.inf

    def cross_faults(self) -> list[str]:
        """Return a text for each invalid combination of keys."""
        faults = one_of_two(self, "rms_m_per_s2", "variance_m2_per_s4")
        one_level = not faults
        try:
            reflection = reflection_of(self.coefficients)
        except ValueError:
            return [*faults, "is unstable: all poles must lie inside the unit circle"]
        if one_level and not self.level(reflection) <= MAX_RMS_M_PER_S2:
            rms = self.level(reflection)
            faults.append(f"has an RMS of {rms:.6g} m/s^2 with these coefficients, at most {MAX_RMS_M_PER_S2:g}")
        return faults


class Autoregressive(CheckedTogether):
    """Coloured noise of autoregressive models identified from recordings, interpolated over speed and force."""

    kind: Literal["autoregressive"] = Field(description="Kind of the texture.")
    rate_hz: float = Field(ge=100, le=1e5, description="Sampling rate of the recordings.")
    models: Annotated[tuple[AutoregressiveModel, ...], Strict(False), at_most(MAX_MODELS)] = Field(
        min_length=1, max_length=MAX_MODELS, description="Models at distinct speeds and forces, on a grid or scattered."
    )
    threshold_m_per_s: Threshold = Field(
        default=0.002, description="Tangential speed below which the noise fades; at rest it is silent."
    )
    direction: Direction = Field(
        default="tangent", description="Direction of the force: `tangent` or `normal` to the surface."
    )
    seed: Seed = Field(default=1, description="The same seed and motion give the same samples.")

    def cross_faults(self) -> list[str]:
        """Return a text for each invalid combination of keys."""
        faults = []
        first: dict[tuple[float, float], int] = {}
        for index, model in enumerate(self.models):
            place = (model.speed_m_per_s + 0.0, model.force_n + 0.0)  # -0 is 0
            before = first.setdefault(place, index)
            if before != index:
                faults.append(
                    f"models[{before}] and models[{index}] are both at {place[0]:.15g} m/s and {place[1]:.15g} N"
                )
                break
        return faults


Texture: TypeAlias = Annotated[Grooves | Stochastic | Autoregressive, Field(discriminator="kind")]
