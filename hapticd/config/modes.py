"""A ringing mode, Q(t) = A exp(-B t) sin(w t), and the keys by which a person gives one, where it acts, and how it
follows the approach speed.

Okamura, Dennerlein and Howe, "Vibration Feedback Models for Virtual Environments", ICRA 1998, eq. 1 and 3: B is the
decay rate in 1/s, w the angular frequency in rad/s. A vibration acts along a surface's normal n, its tangent
t = (n_y, -n_x), or at an angle between. The tick finds the same points of tables (csrc/tick/hd_strike_mode.c).
"""

import math
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Final, Literal, TypeAlias

from pydantic import ConfigDict, Field, Strict
from pydantic.config import JsonDict

from hapticd.base.model import CheckedTogether, at_most, one_of_two

Attack: TypeAlias = Literal["coefficient", "first_peak"]
Direction: TypeAlias = Literal["tangent", "normal"]

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


ONE_DIRECTION: Final[JsonDict] = {"not": given("direction", "angle_rad")}
"""JSON Schema of at most one of the two keys."""


class AimedKeys(ModeKeys):
    """A ringing mode, and where it pushes first."""

    direction: Direction | None = Field(
        default=None, description="Where it acts: across the surface (as without this key) or along it."
    )
    angle_rad: float | None = Field(
        default=None, ge=-10, le=10, description="Angle from the normal towards the tangent, instead of a direction."
    )

    def cross_faults(self) -> list[str]:
        faults = super().cross_faults()
        if self.direction is not None and self.angle_rad is not None:
            faults.append("needs at most one of direction and angle_rad, has both")
        return faults

    @property
    def aim(self) -> tuple[float, float]:
        """The unit vector in which its first half wave pushes, in parts along n and along t."""
        if self.angle_rad is not None:
            return math.cos(self.angle_rad), math.sin(self.angle_rad)
        return (0.0, 1.0) if self.direction == "tangent" else (1.0, 0.0)


MAX_POINTS: Final = 16
"""HD_TUNE_POINTS."""
MIN_STEP: Final = 1e-6
"""Between two speeds (m/s), and between two forces (N)."""


def rising_faults(key: str, points: Sequence[float]) -> Iterator[str]:
    """What is wrong with the first of the points that does not lie MIN_STEP above the one before; `key` names them."""
    for index, (before, point) in enumerate(pairwise(points)):
        if point < before + MIN_STEP:
            yield (
                f"{key}[{index + 1}] must be at least {MIN_STEP:g} above the one before, {before:.15g}, is {point:.15g}"
            )
            return


def around(points: Sequence[float], value: float) -> tuple[int, int, float]:
    """The indices of the points around a value, and how far it is from the first to the second, 0 to 1. Beyond the
    outermost point both are that one."""
    end = bisect_right(points, value)
    if end in (0, len(points)):
        here = max(end - 1, 0)
        return here, here, 0.0
    return end - 1, end, (value - points[end - 1]) / (points[end] - points[end - 1])


class ModeTable(CheckedTogether):
    """Frequency and decay time of a tap over the approach speed."""

    speeds_m_per_s: Annotated[tuple[Annotated[float, Field(ge=0, le=100)], ...], Strict(False), at_most(MAX_POINTS)] = (
        Field(min_length=1, max_length=MAX_POINTS, description="Approach speeds, rising.")
    )
    frequencies_hz: Annotated[tuple[Frequency, ...], Strict(False), at_most(MAX_POINTS)] = Field(
        min_length=1, max_length=MAX_POINTS, description="A frequency for each speed."
    )
    decay_times_s: Annotated[tuple[DecayTime, ...], Strict(False), at_most(MAX_POINTS)] = Field(
        min_length=1, max_length=MAX_POINTS, description="A decay time for each speed."
    )

    def cross_faults(self) -> list[str]:
        faults = list(rising_faults("speeds_m_per_s", self.speeds_m_per_s))
        count = len(self.speeds_m_per_s)
        for key, what in (("frequencies_hz", "a frequency"), ("decay_times_s", "a decay time")):
            if len(getattr(self, key)) != count:
                faults.append(f"{key} must have {what} for each speed, {count}, has {len(getattr(self, key))}")
        return faults

    def at(self, speed_m_per_s: float) -> Mode:
        """The mode of a strike at this approach speed."""
        first, last, share = around(self.speeds_m_per_s, speed_m_per_s)

        def along(values: Sequence[float]) -> float:
            return values[first] + share * (values[last] - values[first])

        return Mode(1 / along(self.decay_times_s), 2 * math.pi * along(self.frequencies_hz))

    @property
    def modes(self) -> tuple[Mode, ...]:
        """Those at its points."""
        return tuple(self.at(speed) for speed in self.speeds_m_per_s)

    @property
    def bounds(self) -> tuple[Mode, ...]:
        """Those at its lowest and at its highest frequency; one where they are the same."""
        modes = sorted(self.modes, key=lambda mode: mode.angular_frequency_rad_per_s)
        return tuple(dict.fromkeys((modes[0], modes[-1])))

    @property
    def middle(self) -> Mode:
        """That in the middle of its speeds, for what strikes without a speed."""
        return self.at((self.speeds_m_per_s[0] + self.speeds_m_per_s[-1]) / 2)
