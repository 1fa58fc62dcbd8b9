"""A ringing mode, Q(t) = A exp(-B t) sin(w t), and the keys by which a person gives one.

Okamura, Dennerlein and Howe, "Vibration Feedback Models for Virtual Environments", ICRA 1998, eq. 1 and 3: B is the
decay rate in 1/s, w the angular frequency in rad/s.
"""

import math
from dataclasses import dataclass
from typing import Annotated, Literal, TypeAlias

from pydantic import ConfigDict, Field
from pydantic.config import JsonDict

from hapticd.base.model import CheckedTogether, one_of_two

Attack: TypeAlias = Literal["coefficient", "first_peak"]

Frequency: TypeAlias = Annotated[float, Field(ge=0.01, le=1e5)]
AngularFrequency: TypeAlias = Annotated[float, Field(ge=0.05, le=1e6)]
DecayTime: TypeAlias = Annotated[float, Field(ge=1e-6, le=10)]
DecayRate: TypeAlias = Annotated[float, Field(ge=0.1, le=1e6)]


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


def given(*names: str) -> JsonDict:
    """JSON Schema of keys that all have a value; null is none."""
    return {"required": [*names], "properties": {name: {"not": {"type": "null"}} for name in names}}


def absent(*names: str) -> JsonDict:
    """JSON Schema of keys of which none has a value."""
    return {"properties": {name: {"type": "null"} for name in names}}


def one_of(*names: str) -> JsonDict:
    """JSON Schema of exactly one of these keys; `a b` is both of them together."""
    together = [name.split() for name in names]
    return {
        "oneOf": [
            {"allOf": [given(*keys), absent(*(key for other in together if other is not keys for key in other))]}
            for keys in together
        ]
    }


ONE_OF_EACH_PAIR: JsonDict = {
    "allOf": [
        one_of("frequency_hz", "angular_frequency_rad_per_s"),
        one_of("decay_time_s", "decay_rate_per_s"),
    ]
}


class ModeKeys(CheckedTogether):
    """A ringing mode: one of frequency and angular frequency, and one of decay time and decay rate."""

    model_config = ConfigDict(json_schema_extra=ONE_OF_EACH_PAIR)

    frequency_hz: Frequency | None = Field(default=None, description="Frequency of the ringing.")
    angular_frequency_rad_per_s: AngularFrequency | None = Field(
        default=None, description="2 pi times the frequency, instead of it."
    )
    decay_time_s: DecayTime | None = Field(
        default=None, description="Time in which the ringing falls to 1/e; it ends after five of them."
    )
    decay_rate_per_s: DecayRate | None = Field(default=None, description="1 over the decay time, instead of it.")

    def cross_faults(self) -> list[str]:
        """Faults between keys that are each sound."""
        return self.mode_faults()

    def mode_faults(self) -> list[str]:
        """Those of the keys of the mode."""
        return [
            *one_of_two(self, "frequency_hz", "angular_frequency_rad_per_s"),
            *one_of_two(self, "decay_time_s", "decay_rate_per_s"),
        ]

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
