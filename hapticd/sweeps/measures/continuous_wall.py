"""The continuous loop of a hand, a handle and one wall, in closed form: the limit of a servo with infinite rate.

With the height y of the handle above the surface, along the wall's normal, and the height w of the hand's reference,

    M y'' = k (w - y) + c (w' - y') - b y' + P + F,    F = max(0, -K y - D y') if y < 0, else 0.

M is the mass of handle and hand, b the damping of the handle, k and c are stiffness and damping of the hand, K and D
those of the wall, P is a constant force, and F that of the wall. Between two waypoints the reference is a polynomial in
time. So between two events (waypoint, touch or release) the equation is linear, and its solution is

    y(t) = polynomial(t) + exp(-a t) (A cos(q t) + B sin(q t)/q),    a = R/2M,  q^2 = S/M - a^2,

where R is the total damping and S the total stiffness; q may be imaginary or 0. Events are found by bisection.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from numpy.polynomial import Polynomial

Floats = npt.NDArray[np.float64]
_MAX_BISECTIONS: Final = 80
"""Maximum number of bisections for the time of an event; fewer suffice for the last bit of a float."""
_MAX_SEGMENTS: Final = 100_000
"""A motion with more segments is refused, since it touches and leaves the wall without end."""
_MINIMUM_JERK_COEFFICIENTS: Final = (0.0, 0.0, 0.0, 10.0, -15.0, 6.0)
"""Polynomial of minimum-jerk motion between two waypoints, from the lowest power up (Flash and Hogan 1985).

It maps the fraction of the time to the fraction of the distance.
"""


@dataclass(frozen=True, slots=True)
class WallLoop:
    """Parameters of hand, handle and wall."""

    mass_kg: float
    """Mass of handle and hand."""
    damping_n_s_per_m: float
    """Damping of the handle."""
    hand_stiffness_n_per_m: float
    hand_damping_n_s_per_m: float
    wall_stiffness_n_per_m: float
    wall_damping_n_s_per_m: float
    push_n: float
    """Constant force along the normal; negative if it points into the wall."""


@dataclass(frozen=True)
class _Segment:
    """The motion between two successive events: either the wall exerts a force all the time, or never."""

    begin_s: float
    pressed: bool
    """Whether the wall exerts a force during the segment."""
    forced: Polynomial
    """The polynomial part of the height, in m, as a function of the time since `begin_s`."""
    decay_per_s: float
    """Decay rate a of the solution, in 1/s."""
    square: float
    """Square q^2 of the solution's angular frequency, in 1/s^2; negative if q is imaginary."""
    first: float
    """Coefficient A of the cosine, in m."""
    second: float
    """Coefficient B of the sine, in m/s."""

    def at(self, time_s: Floats) -> tuple[Floats, Floats]:
        """Return height in m and speed in m/s of the handle at times `time_s`, each of the shape of `time_s`."""
        t = time_s - self.begin_s
        a, q = self.decay_per_s, math.sqrt(abs(self.square))
        if self.square > 0.0:
            fade = np.exp(-a * t)
            cosine, sine = fade * np.cos(q * t), fade * np.sin(q * t) / q
        elif self.square < 0.0:
            # Two exponentials that do not grow; cosh and sinh might overflow.
            slow, fast = np.exp((q - a) * t), np.exp((-q - a) * t)
            cosine, sine = 0.5 * (slow + fast), 0.5 * (slow - fast) / q
        else:
            cosine, sine = np.exp(-a * t), t * np.exp(-a * t)
        y = self.forced(t) + self.first * cosine + self.second * sine
        v = self.forced.deriv()(t) + self.first * (-a * cosine - self.square * sine) + self.second * (cosine - a * sine)
        return y, v


class ContinuousWall:
    """The motion of the handle, which begins at rest at the hand's first waypoint, above the wall."""

    def __init__(self, loop: WallLoop, waypoints: Floats, minimum_jerk: bool, end_s: float, step_s: float) -> None:
        """Compute the motion of the handle from 0 s to `end_s`.

        `waypoints` are rows [t_s, height_m] of the hand's reference, (n, 2), which begin at 0 s. If a touch and its
        release are separated by less than `step_s`, both may be missed.
        """
        self._loop = loop
        self._minimum_jerk = minimum_jerk
        self._waypoints = waypoints
        self._segments: list[_Segment] = []
        self._compute(end_s, step_s)

    def at(self, time_s: Floats) -> tuple[Floats, Floats]:
        """Return the handle's height above the wall in m and the wall's normal force in N at n times, each (n,)."""
        loop = self._loop
        height, force = np.empty_like(time_s), np.zeros_like(time_s)
        begins = [segment.begin_s for segment in self._segments]
        which = np.searchsorted(begins, time_s, side="right") - 1
        for index in np.unique(which):
            here, segment = which == index, self._segments[index]
            height[here], speed = segment.at(time_s[here])
            if segment.pressed:
                pressed = -loop.wall_stiffness_n_per_m * height[here] - loop.wall_damping_n_s_per_m * speed
                force[here] = np.maximum(pressed, 0.0)
        return height, force

    def _compute(self, end_s: float, step_s: float) -> None:
        loop = self._loop
        now, height, speed, pressed = 0.0, float(self._waypoints[0, 1]), 0.0, False
        while now < end_s:
            if len(self._segments) == _MAX_SEGMENTS:
                raise ArithmeticError("the continuous loop touches and leaves the wall without end")
            until = min(end_s, self._next_waypoint(now))
            segment = self._segment(now, height, speed, pressed)
            self._segments.append(segment)

            def changes(y: Floats, v: Floats, pressed: bool = pressed) -> npt.NDArray[np.bool_]:
                """Return where the wall begins to exert a force if it exerted none in the segment, or vice versa."""
                force = -loop.wall_stiffness_n_per_m * y - loop.wall_damping_n_s_per_m * v
                found: npt.NDArray[np.bool_] = ((y < 0.0) & (force > 0.0)) != pressed
                return found

            times = np.append(np.arange(now + step_s, until, step_s), until)
            changed = np.flatnonzero(changes(*segment.at(times)))
            if len(changed):
                low = now if changed[0] == 0 else float(times[changed[0] - 1])
                high = float(times[changed[0]])
                for _ in range(_MAX_BISECTIONS):
                    middle = 0.5 * (low + high)
                    if middle in (low, high):
                        break
                    low, high = (low, middle) if changes(*segment.at(np.array([middle])))[0] else (middle, high)
                until = high
                pressed = not pressed
            (height,), (speed,) = (each.tolist() for each in segment.at(np.array([until])))
            now = until

    def _next_waypoint(self, now_s: float) -> float:
        later = self._waypoints[self._waypoints[:, 0] > now_s, 0]
        return float(later[0]) if len(later) else math.inf

    def _reference(self, now_s: float) -> Polynomial:
        """Return the height of the hand's reference until the next waypoint: a polynomial in the time since `now_s`."""
        waypoints = self._waypoints
        index = int(np.searchsorted(waypoints[:, 0], now_s, side="right")) - 1
        if index < 0 or index + 1 >= len(waypoints):
            return Polynomial([waypoints[max(index, 0), 1]])
        (begin_s, begin), (end_s, end) = waypoints[index], waypoints[index + 1]
        time_fraction = Polynomial([(now_s - begin_s) / (end_s - begin_s), 1.0 / (end_s - begin_s)])
        path_fraction = Polynomial(_MINIMUM_JERK_COEFFICIENTS)(time_fraction) if self._minimum_jerk else time_fraction
        found: Polynomial = begin + (end - begin) * path_fraction
        return found

    def _segment(self, now_s: float, height: float, speed: float, pressed: bool) -> _Segment:
        loop = self._loop
        damping = loop.damping_n_s_per_m + loop.hand_damping_n_s_per_m
        stiffness = loop.hand_stiffness_n_per_m
        if pressed:
            damping += loop.wall_damping_n_s_per_m
            stiffness += loop.wall_stiffness_n_per_m
        wanted = self._reference(now_s)
        drive = loop.hand_stiffness_n_per_m * wanted + loop.hand_damping_n_s_per_m * wanted.deriv() + loop.push_n
        forced = Polynomial(_particular(loop.mass_kg, damping, stiffness, np.atleast_1d(drive.coef).tolist()))
        decay = damping / (2.0 * loop.mass_kg)
        square = stiffness / loop.mass_kg - decay * decay
        first = height - float(forced(0.0))
        second = speed - float(forced.deriv()(0.0)) + decay * first
        return _Segment(now_s, pressed, forced, decay, square, first, second)


def _particular(mass: float, damping: float, stiffness: float, drive: Sequence[float]) -> list[float]:
    """Return the coefficients of a polynomial y that solves M y'' + R y' + S y = drive, from the lowest power up.

    M, R and S are `mass`, `damping` and `stiffness`; `drive` has the coefficients of a polynomial. The degree of y is
    that of `drive`, without stiffness one higher, and without stiffness and damping two higher, with y(0) = 0.
    """
    if stiffness == 0.0:
        if damping == 0.0:
            return [0.0, 0.0, *(each / (mass * (n + 1) * (n + 2)) for n, each in enumerate(drive))]
        speed = _particular(0.0, mass, damping, drive)
        return [0.0, *(each / (n + 1) for n, each in enumerate(speed))]
    found = [0.0] * (len(drive) + 2)
    for n in range(len(drive) - 1, -1, -1):
        found[n] = (drive[n] - damping * (n + 1) * found[n + 1] - mass * (n + 1) * (n + 2) * found[n + 2]) / stiffness
    return found[: len(drive)]
