"""A ringing mode, Q(t) = A exp(-B t) sin(w t): its keys, its direction, and its table over the approach speed.

Okamura, Dennerlein and Howe, "Vibration Feedback Models for Virtual Environments", ICRA 1998, eq. 1 and 3: B is the
decay rate in 1/s, w the angular frequency in rad/s. A vibration acts along a surface's normal n, its tangent
t = (n_y, -n_x), or at an angle between them. The tick interpolates tables in the same way
(csrc/tick/hd_strike_mode.c).
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
        """Frequency w/(2 pi), in Hz."""
        return self.angular_frequency_rad_per_s / (2 * math.pi)

    @property
    def decay_time_s(self) -> float:
        """Time constant 1/B of the decay, in s."""
        return 1 / self.decay_rate_per_s

    @property
    def peak_time_s(self) -> float:
        """Time of the first maximum, atan(w/B)/w, in s."""
        w = self.angular_frequency_rad_per_s
        return math.atan2(w, self.decay_rate_per_s) / w

    @property
    def peak(self) -> float:
        """Value of the first maximum of exp(-B t) sin(w t), below 1."""
        time_s = self.peak_time_s
        return math.exp(-self.decay_rate_per_s * time_s) * math.sin(self.angular_frequency_rad_per_s * time_s)

    def coefficient(self, amplitude: float, attack: Attack) -> float:
        """Return A of Q(t) for an amplitude that, depending on `attack`, is A or the maximum of the first cycle."""
        return amplitude if attack == "coefficient" else amplitude / self.peak


def given(*names: str) -> JsonDict:
    """Return a JSON Schema that requires each of the keys `names`, with a value other than null."""
    return {"required": [*names], "properties": {name: {"not": {"type": "null"}} for name in names}}


def absent(*names: str) -> JsonDict:
    """Return a JSON Schema that requires each of the keys `names` to be absent or null."""
    return {"properties": {name: {"type": "null"} for name in names}}


def one_of(*names: str) -> JsonDict:
    """Return a JSON Schema that requires exactly one of the keys `names`; "a b" stands for both keys together."""
    alternatives = [name.split() for name in names]
    return {
        "oneOf": [
            {"allOf": [given(*keys), absent(*(key for other in alternatives if other is not keys for key in other))]}
            for keys in alternatives
        ]
    }


ONE_OF_EACH_PAIR: JsonDict = {
    "allOf": [
        one_of("frequency_hz", "angular_frequency_rad_per_s"),
        one_of("decay_time_s", "decay_rate_per_s"),
    ]
}
"""JSON Schema of a mode: exactly one key for the frequency, and one for the decay."""


class ModeKeys(CheckedTogether):
    """A ringing mode: one of frequency and angular frequency, and one of decay time and decay rate."""

    model_config = ConfigDict(json_schema_extra=ONE_OF_EACH_PAIR)

    frequency_hz: Frequency | None = Field(default=None, description="Frequency of the ringing.")
    angular_frequency_rad_per_s: AngularFrequency | None = Field(
        default=None, description="2 pi times the frequency, instead of the frequency."
    )
    decay_time_s: DecayTime | None = Field(
        default=None, description="Time in which the ringing falls to 1/e; it ends after five decay times."
    )
    decay_rate_per_s: DecayRate | None = Field(default=None, description="1/decay time, instead of the decay time.")

    def cross_faults(self) -> list[str]:
        """Return a text for each invalid combination of keys."""
        return self.mode_faults()

    def mode_faults(self) -> list[str]:
        """Return a text for each invalid combination of the keys of a ringing mode."""
        return [
            *one_of_two(self, "frequency_hz", "angular_frequency_rad_per_s"),
            *one_of_two(self, "decay_time_s", "decay_rate_per_s"),
        ]

    @property
    def mode(self) -> Mode:
        """The ringing mode with the frequency and the decay that these keys give."""
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
"""JSON Schema that allows at most one of `direction` and `angle_rad`."""


class AimedKeys(ModeKeys):
    """A ringing mode with its direction."""

    direction: Direction | None = Field(
        default=None, description="Direction of the vibration: `normal` to the surface (the default) or `tangent`."
    )
    angle_rad: float | None = Field(
        default=None, ge=-10, le=10, description="Angle from the normal towards the tangent, instead of a direction."
    )

    def cross_faults(self) -> list[str]:
        """Return a text for each invalid combination of keys."""
        faults = super().cross_faults()
        if self.direction is not None and self.angle_rad is not None:
            faults.append("needs at most one of direction and angle_rad, has both")
        return faults

    @property
    def aim(self) -> tuple[float, float]:
        """Direction of the force in the first half wave: components along the surface's normal n and tangent t."""
        if self.angle_rad is not None:
            return math.cos(self.angle_rad), math.sin(self.angle_rad)
        return (0.0, 1.0) if self.direction == "tangent" else (1.0, 0.0)


MAX_TABLE_POINTS: Final = 16
"""Maximum number of speeds, or forces, of a table: the core's HD_TUNE_POINTS."""
MIN_TABLE_STEP: Final = 1e-6
"""Minimum difference of successive speeds (in m/s) or forces (in N) of a table."""


def rising_faults(key: str, points: Sequence[float]) -> Iterator[str]:
    """Yield the fault of the first point less than MIN_TABLE_STEP above its predecessor; `key` names the list."""
    for index, (before, point) in enumerate(pairwise(points)):
        if point < before + MIN_TABLE_STEP:
            limit = f"{MIN_TABLE_STEP:g} above the one before, {before:.15g}"
            yield f"{key}[{index + 1}] must be at least {limit}, is {point:.15g}"
            return


def around(points: Sequence[float], value: float) -> tuple[int, int, float]:
    """Return the indices of the two points around a value, and its relative position between them, 0 to 1.

    Outside the range of the points both indices are those of the nearest point.
    """
    end = bisect_right(points, value)
    if end in (0, len(points)):
        here = max(end - 1, 0)
        return here, here, 0.0
    return end - 1, end, (value - points[end - 1]) / (points[end] - points[end - 1])


class ModeTable(CheckedTogether):
    """Frequency and decay time of a tap over the approach speed."""

    speeds_m_per_s: Annotated[
        tuple[Annotated[float, Field(ge=0, le=100)], ...], Strict(False), at_most(MAX_TABLE_POINTS)
    ] = Field(min_length=1, max_length=MAX_TABLE_POINTS, description="Approach speeds, in rising order.")
    frequencies_hz: Annotated[tuple[Frequency, ...], Strict(False), at_most(MAX_TABLE_POINTS)] = Field(
        min_length=1, max_length=MAX_TABLE_POINTS, description="A frequency for each speed."
    )
    decay_times_s: Annotated[tuple[DecayTime, ...], Strict(False), at_most(MAX_TABLE_POINTS)] = Field(
        min_length=1, max_length=MAX_TABLE_POINTS, description="A decay time for each speed."
    )

    def cross_faults(self) -> list[str]:
        """Return a text for each invalid combination of keys."""
        faults = list(rising_faults("speeds_m_per_s", self.speeds_m_per_s))
        count = len(self.speeds_m_per_s)
        for key, what in (("frequencies_hz", "a frequency"), ("decay_times_s", "a decay time")):
            if len(getattr(self, key)) != count:
                faults.append(f"{key} must have {what} for each speed, {count}, has {len(getattr(self, key))}")
        return faults

    def at(self, speed_m_per_s: float) -> Mode:
        """Return the ringing mode of a strike at this approach speed."""
        first, last, share = around(self.speeds_m_per_s, speed_m_per_s)

        def along(values: Sequence[float]) -> float:
            return values[first] + share * (values[last] - values[first])

        return Mode(1 / along(self.decay_times_s), 2 * math.pi * along(self.frequencies_hz))

    @property
    def modes(self) -> tuple[Mode, ...]:
        """Ringing modes at the points of the table, in the order of the approach speeds."""
        return tuple(self.at(speed) for speed in self.speeds_m_per_s)

    @property
    def bounds(self) -> tuple[Mode, ...]:
        """Modes of the lowest and of the highest frequency in the table; a single mode if both are the same."""
        modes = sorted(self.modes, key=lambda mode: mode.angular_frequency_rad_per_s)
        return tuple(dict.fromkeys((modes[0], modes[-1])))

    @property
    def middle(self) -> Mode:
        """Ringing mode in the middle of the table's speeds, for strikes without an approach speed."""
        return self.at((self.speeds_m_per_s[0] + self.speeds_m_per_s[-1]) / 2)
