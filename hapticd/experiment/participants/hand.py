"""The motions of a simulated hand: taps, strokes and presses of varied speed and depth, with tremor.

A hand knows the surfaces but not their materials. Its waypoints are the target of the grip of the simulated joystick.
Grip and rendered force move the handle, in a closed loop.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hapticd.analysis.statistics import Floats
from hapticd.experiment.front import Seen
from hapticd.experiment.stage import Waypoints

WAYPOINT_INTERVAL_S: Final = 0.005
"""Time between two waypoints."""
WAY_OUT_DURATION_S: Final = 0.5
"""Duration of the motion out of a surface."""
HOVER_HEIGHT_M: Final = 0.008
"""Height of the hand above a surface before a touch."""
TREMOR_BAND_HZ: Final = (8.0, 12.0)
"""Range of frequencies of the physiological tremor of a hand (Elble and Koller, Tremor, 1990)."""


@dataclass(frozen=True, slots=True)
class HandParameters:
    """Parameters of a hand's motions, chosen for hapticd. Speeds, depths and reaction times are lognormal medians."""

    tap_speed_m_per_s: float = 0.12
    stroke_speed_m_per_s: float = 0.06
    press_speed_m_per_s: float = 0.03
    depth_m: float = 0.006
    """Depth below the surface to which the hand aims."""
    spread: float = 0.2
    """Standard deviation of the logarithm of speeds, depths and reaction times."""
    tremor_m: float = 40e-6
    """Root mean square of the tremor on each axis."""
    reaction_s: float = 0.16
    """Median time from a felt event to the start of a movement."""


class Hand:
    """A simulated hand, which returns waypoints of taps, strokes and presses. They are random."""

    def __init__(self, chance: np.random.Generator, parameters: HandParameters | None = None) -> None:
        self._chance = chance
        self.parameters = parameters or HandParameters()

    def taps(self, surface: Seen, count: int = 3) -> Waypoints:
        """Return waypoints (n, 3) of `count` taps near the middle of a surface."""
        given = self.parameters
        points: list[tuple[float, float, float]] = [(0.2, 0.0, HOVER_HEIGHT_M)]
        for _ in range(count):
            at = self._near(surface)
            speed, depth = self._varied(given.tap_speed_m_per_s), self._varied(given.depth_m)
            points += [
                (0.15, at, HOVER_HEIGHT_M),
                ((HOVER_HEIGHT_M + depth) / speed, at, -depth),
                (0.08, at, -depth),
                (0.15, at, HOVER_HEIGHT_M),
            ]
        return self._waypoints(surface, points)

    def strokes(self, surface: Seen, count: int = 2) -> Waypoints:
        """Return waypoints (n, 3) of `count` strokes over a surface, in alternating directions."""
        given = self.parameters
        reach = 0.8 * min(surface.half_m, 0.03)
        points: list[tuple[float, float, float]] = [(0.2, -reach, HOVER_HEIGHT_M)]
        side = -1.0
        depth = self._varied(given.depth_m)
        points.append((0.2, -reach, -depth))
        for _ in range(count):
            side = -side
            speed, depth = self._varied(given.stroke_speed_m_per_s), self._varied(given.depth_m)
            points.append((2.0 * reach / speed, side * reach, -depth))
        points.append((0.15, side * reach, HOVER_HEIGHT_M))
        return self._waypoints(surface, points)

    def press(self, surface: Seen) -> Waypoints:
        """Return waypoints (n, 3) of a slow press, 5 cm into a surface."""
        speed = self._varied(self.parameters.press_speed_m_per_s)
        deep = 0.05
        return self._waypoints(
            surface, [(0.2, 0.0, HOVER_HEIGHT_M), ((HOVER_HEIGHT_M + deep) / speed, 0.0, -deep)], smooth=False
        )

    def way_out(self, surface: Seen) -> Waypoints:
        """Return the waypoint (1, 3) above the middle of a surface, to which the hand moves to leave it."""
        (x, y), (n_x, n_y) = surface.point_m, surface.normal
        return np.array([[WAY_OUT_DURATION_S, x + HOVER_HEIGHT_M * n_x, y + HOVER_HEIGHT_M * n_y]])

    def withdrawal(self, surface: Seen, pressed: Waypoints, at_s: float) -> Waypoints:
        """Return waypoints (n, 3) that end the press `pressed` at the time `at_s` and move out of the surface."""
        here = np.array([np.interp(at_s, pressed[:, 0], pressed[:, axis]) for axis in (1, 2)])
        (x, y), (n_x, n_y) = surface.point_m, surface.normal
        out = np.array([x + HOVER_HEIGHT_M * n_x, y + HOVER_HEIGHT_M * n_y])
        times = np.arange(WAYPOINT_INTERVAL_S, 0.4, WAYPOINT_INTERVAL_S)
        fraction = _smooth(times / times[-1])[:, None]
        return np.column_stack((at_s + times, here + fraction * (out - here)))

    def reaction_s(self) -> float:
        """Return a random time in s from a felt event to the start of the movement that responds to it."""
        return self._varied(self.parameters.reaction_s)

    def _varied(self, median: float) -> float:
        return median * math.exp(self.parameters.spread * float(self._chance.standard_normal()))

    def _near(self, surface: Seen) -> float:
        return float(self._chance.uniform(-1.0, 1.0)) * 0.3 * min(surface.half_m, 0.02)

    def _waypoints(self, surface: Seen, points: Sequence[tuple[float, float, float]], smooth: bool = True) -> Waypoints:
        """Return waypoints (n, 3) through points (duration in s, position along the surface in m, height in m).

        The way begins above the middle. A point is reached after its duration. Between two points the speed is smooth,
        but it is constant on the way down, and everywhere without `smooth`.
        """
        at = (0.0, HOVER_HEIGHT_M)
        parts, begun = [], 0.0
        for duration, along, height in points:
            steps = max(1, round(duration / WAYPOINT_INTERVAL_S))
            times = np.arange(1, steps + 1) / steps
            # A motion down onto a surface has constant speed: a hand does not brake before a tap.
            fraction = _smooth(times) if smooth and height >= at[1] else times
            parts.append(
                np.column_stack(
                    (begun + duration * times, at[0] + fraction * (along - at[0]), at[1] + fraction * (height - at[1]))
                )
            )
            at, begun = (along, height), begun + duration
        way = np.vstack(([[0.0, 0.0, HOVER_HEIGHT_M]], *parts))
        way[:, 1:] += self._tremor(way[:, 0])
        (x, y), (n_x, n_y) = surface.point_m, surface.normal
        return np.column_stack(
            (way[:, 0], x + way[:, 1] * n_y + way[:, 2] * n_x, y - way[:, 1] * n_x + way[:, 2] * n_y)
        )

    def _tremor(self, times_s: Floats) -> Floats:
        """Return a tremor (n, 2) at times (n,): eight sinusoids of random frequency and phase on each axis, in m."""
        frequency = self._chance.uniform(*TREMOR_BAND_HZ, (8, 2))
        phase = self._chance.uniform(0.0, 2.0 * math.pi, (8, 2))
        angle = 2.0 * math.pi * frequency * times_s[:, None, None] + phase
        return np.asarray(self.parameters.tremor_m * 0.5 * np.sin(angle).sum(axis=1))


def _smooth(times: Floats) -> Floats:
    """Return the path, from 0 to 1, of a minimum-jerk motion at `times` from 0 to 1 (Flash and Hogan, 1985)."""
    return times**3 * (10.0 - 15.0 * times + 6.0 * times**2)
