"""What an effect of the PID class does over time, by the specification: envelope, waves, ramps and conditions, loops.
Levels are parts of the full force, times are in s, and nothing of it is taken from the product."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

ENDLESS: Final = math.inf
PERIODIC: Final = ("square", "sine", "triangle", "sawtooth_up", "sawtooth_down")
CONDITIONS: Final = ("spring", "damper", "inertia", "friction")


@dataclass(frozen=True)
class Condition:
    """How a force answers to where the handle is along one axis, or how it moves: all as parts of the full range."""

    center: float = 0.0
    positive_coefficient: float = 0.0
    negative_coefficient: float = 0.0
    positive_saturation: float = 1.0
    negative_saturation: float = 1.0
    dead_band: float = 0.0

    def force(self, metric: float) -> float:
        beyond = metric - self.center
        if beyond > self.dead_band:
            return -min(self.positive_coefficient * (beyond - self.dead_band), self.positive_saturation)
        if beyond < -self.dead_band:
            return min(-self.negative_coefficient * (beyond + self.dead_band), self.negative_saturation)
        return 0.0


@dataclass(frozen=True)
class Effect:
    """What the device has in one block. Levels are parts of the full force."""

    kind: str = ""
    is_set: bool = False
    """It was given a Set Effect."""
    duration_s: float = 0.0
    delay_s: float = 0.0
    gain: float = 1.0
    axes: tuple[str, ...] = ()
    is_directed: bool = False
    """Direction Enable."""
    direction: tuple[float, ...] = ()
    """Turns, or parts of a vector."""
    attack_level: float = 0.0
    attack_s: float = 0.0
    fade_level: float = 0.0
    fade_s: float = 0.0
    magnitude: float = 0.0
    offset: float = 0.0
    phase: float = 0.0
    """Turns."""
    period_s: float = 0.0
    ramp: tuple[float, float] = (0.0, 0.0)
    conditions: tuple[tuple[int, Condition], ...] = ()
    started_s: float | None = None
    loops: float = 1.0

    def elapsed(self, t_s: float) -> float | None:
        """The time in the loop that plays, from when its delay is over; None: it does not play then."""
        if self.started_s is None or not self.is_set or t_s < self.started_s:
            return None
        once = self.delay_s + self.duration_s
        passed = t_s - self.started_s
        if once <= 0.0 or passed >= once * self.loops:
            return None
        within = (passed % once if once < ENDLESS else passed) - self.delay_s
        return within if within >= 0.0 else None

    def level(self, within_s: float) -> float:
        """The strength of anything but a condition, so long after it began."""
        if self.kind == "constant_force":
            return self._enveloped(within_s, self.magnitude)
        if self.kind == "ramp":
            share = within_s / self.duration_s if self.duration_s < ENDLESS else 0.0
            return self._enveloped(within_s, self.ramp[0] + (self.ramp[1] - self.ramp[0]) * share)
        if self.kind in PERIODIC and self.period_s > 0.0:
            return self.offset + self._enveloped(within_s, self.magnitude) * self._wave(within_s)
        return 0.0

    def _enveloped(self, within_s: float, magnitude: float) -> float:
        size, sign = abs(magnitude), math.copysign(1.0, magnitude)
        if self.attack_s > 0.0 and within_s < self.attack_s:
            return sign * (self.attack_level + (size - self.attack_level) * within_s / self.attack_s)
        left_s = self.duration_s - within_s
        if self.fade_s > 0.0 and left_s < self.fade_s:
            return sign * (self.fade_level + (size - self.fade_level) * left_s / self.fade_s)
        return magnitude

    def _wave(self, within_s: float) -> float:
        turn = (within_s / self.period_s + self.phase) % 1.0
        match self.kind:
            case "sine":
                return math.sin(2.0 * math.pi * turn)
            case "square":
                return 1.0 if turn < 0.5 else -1.0
            case "triangle":
                return 1.0 - 4.0 * abs((turn + 0.25) % 1.0 - 0.5)
            case "sawtooth_up":
                return 2.0 * turn - 1.0
            case _:
                return 1.0 - 2.0 * turn
