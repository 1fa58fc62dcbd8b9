"""The continuous loop of a hand, a handle and one wall, in closed form: the limit of a servo with infinite rate.

With the height y of the handle above the surface, along the wall's normal, and the height w of the hand's reference,

    M y'' = k (w - y) + c (w' - y') - b y' + P + F,    F = max(0, -K y - D y') if y < 0, else 0.

M is the mass of handle and hand, b the damping of the handle, k and c are stiffness and damping of the hand, K and D
those of the wall, and P is a constant push. Between two waypoints the reference is a polynomial in time. So between two
events (waypoint, touch or release) the equation is linear, and its solution is

    y(t) = polynomial(t) + exp(-a t) (A cos(q t) + B sin(q t)/q),    a = R/2M,  q^2 = S/M - a^2,

where R and S are the sums of all damping and all stiffness; q may be imaginary or 0. Events are found by bisection.
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
"""Bisections until the time of an event is exact to the last bit of a float."""
_MAX_STRETCHES: Final = 100_000
"""Number of stretches at which a motion is refused that touches and leaves the wall without end."""
_MINIMUM_JERK_COEFFICIENTS: Final = (0.0, 0.0, 0.0, 10.0, -15.0, 6.0)
"""Coefficients, from the lowest power up, of the fraction of the path over the fraction of the time between waypoints
(Flash and Hogan 1985)."""


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
class _Stretch:
    """The motion between two events, in which the wall either exerts a force or does not."""

    begin_s: float
    pressed: bool
    """Whether the wall exerts a force."""
    forced: Polynomial
    """The polynomial part of the height, in m, over the time since `begin_s`."""
    decay_per_s: float
    """a, in 1/s."""
    square: float
    """q^2, in 1/s^2."""
    first: float
    """A, in m."""
    second: float
    """B, in m/s."""

    def at(self, time_s: Floats) -> tuple[Floats, Floats]:
        """Return height in m and speed in m/s, each of the shape of `time_s`."""
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
    """The motion that begins at rest at the hand's first waypoint, which is above the wall."""

    def __init__(self, loop: WallLoop, waypoints: Floats, minimum_jerk: bool, end_s: float, step_s: float) -> None:
        """Compute the motion from 0 s to `end_s`.

        `waypoints` are rows [t_s, height_m] of the hand's reference, (n, 2), which begin at 0 s. If a touch and its
        release are separated by less than `step_s`, both may be missed.
        """
        self._loop = loop
        self._minimum_jerk = minimum_jerk
        self._way = waypoints
        self._stretches: list[_Stretch] = []
        self._compute(end_s, step_s)

    def at(self, time_s: Floats) -> tuple[Floats, Floats]:
        """Return the height above the surface in m and the normal force of the wall in N at times (n,), each (n,)."""
        loop = self._loop
        height, force = np.empty_like(time_s), np.zeros_like(time_s)
        begins = [stretch.begin_s for stretch in self._stretches]
        which = np.searchsorted(begins, time_s, side="right") - 1
        for index in np.unique(which):
            here, stretch = which == index, self._stretches[index]
            height[here], speed = stretch.at(time_s[here])
            if stretch.pressed:
                pressed = -loop.wall_stiffness_n_per_m * height[here] - loop.wall_damping_n_s_per_m * speed
                force[here] = np.maximum(pressed, 0.0)
        return height, force

    def _compute(self, end_s: float, step_s: float) -> None:
        loop = self._loop
        now, height, speed, pressed = 0.0, float(self._way[0, 1]), 0.0, False
        while now < end_s:
            if len(self._stretches) == _MAX_STRETCHES:
                raise ArithmeticError("the continuous loop touches and leaves the wall without end")
            until = min(end_s, self._next_waypoint(now))
            stretch = self._stretch(now, height, speed, pressed)
            self._stretches.append(stretch)

            def changes(y: Floats, v: Floats, pressed: bool = pressed) -> npt.NDArray[np.bool_]:
                """Return where the wall exerts a force and did not at the begin of the stretch, or vice versa."""
                force = -loop.wall_stiffness_n_per_m * y - loop.wall_damping_n_s_per_m * v
                found: npt.NDArray[np.bool_] = ((y < 0.0) & (force > 0.0)) != pressed
                return found

            times = np.append(np.arange(now + step_s, until, step_s), until)
            changed = np.flatnonzero(changes(*stretch.at(times)))
            if len(changed):
                low = now if changed[0] == 0 else float(times[changed[0] - 1])
                high = float(times[changed[0]])
                for _ in range(_MAX_BISECTIONS):
                    middle = 0.5 * (low + high)
                    if middle in (low, high):
                        break
                    low, high = (low, middle) if changes(*stretch.at(np.array([middle])))[0] else (middle, high)
                until = high
                pressed = not pressed
            (height,), (speed,) = (each.tolist() for each in stretch.at(np.array([until])))
            now = until

    def _next_waypoint(self, now_s: float) -> float:
        later = self._way[self._way[:, 0] > now_s, 0]
        return float(later[0]) if len(later) else math.inf

    def _reference(self, now_s: float) -> Polynomial:
        """Return the height of the reference as a polynomial in the time since `now_s`, up to the next waypoint."""
        way = self._way
        index = int(np.searchsorted(way[:, 0], now_s, side="right")) - 1
        if index < 0 or index + 1 >= len(way):
            return Polynomial([way[max(index, 0), 1]])
        (begin_s, begin), (end_s, end) = way[index], way[index + 1]
        part = Polynomial([(now_s - begin_s) / (end_s - begin_s), 1.0 / (end_s - begin_s)])
        gone = Polynomial(_MINIMUM_JERK_COEFFICIENTS)(part) if self._minimum_jerk else part
        found: Polynomial = begin + (end - begin) * gone
        return found

    def _stretch(self, now_s: float, height: float, speed: float, pressed: bool) -> _Stretch:
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
        return _Stretch(now_s, pressed, forced, decay, square, first, second)


def _particular(mass: float, damping: float, stiffness: float, drive: Sequence[float]) -> list[float]:
    """Return the coefficients of a polynomial y with M y'' + R y' + S y = drive, from the lowest power up.

    Without stiffness its degree is one higher than that of the drive, without damping, too, two higher; then y(0) = 0.
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
