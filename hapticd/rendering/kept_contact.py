"""Taps that stay in contact: how much of the compensation of a tap the push of the hand allows.

A compensated tap moves the handle as the mode says, against the surface and the hand. A surface pushes and never pulls,
so the tap may push the handle off the surface, and the surface is tapped again. Per metre per second of approach, with
the depth d into the surface and the height x by which the tap lifts the handle, the dynamics are linear in contact:

    M d'' + B d' + (k + K) d = push of the hand - force of the tap,      d = h - x,

with all masses M, all dampers B, the spring k of the hand and that of the surface, K. A hand that comes at a constant
speed and stops T seconds after the onset makes the depth h_T(t) without a tap; its push grows with T.

Two forces are designed for a tap, with the same poles:

    kept    the least displayed error for which the tap never lifts the handle higher than a tap without compensation
            does. So it stays in contact wherever that one does, whatever the hand.
    full    a smaller error, which needs a hand that stops after the onset: h_T >= x for the later stops.

In flight the core mixes them by the measured depth: `kept` at or below the depth h - x of `kept` with a hand that stops
at the onset, `full` at or above that of `full` with T = full_s, linearly between. The part of `full` never grows again
(csrc/tick/hd_preload.h). The closed forms take held samples for the continuous force of the same momentum, which shifts
them by less than a period.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt

from hapticd.config.dynamics import Dynamics
from hapticd.config.modes import Mode
from hapticd.rendering.compensation import (
    Load,
    Ringing,
    Shape,
    bounded_shape,
    pole_of,
    shapes_of,
)

PRELOAD_POINTS: Final = 160
"""Number of times at which depths are compared."""
_STOP_COUNT: Final = 121
"""Number of hands that are tried: times at which they stop."""
_LATER_STOPS: Final = 4
"""`full` is mixed in completely for a hand that stops later, by this number of hands, than the weakest that holds it:
where both forces sound in part, a tap may lift the handle a little further than both designs say."""
_EARLIEST_FULL: Final = 0.7
"""Earliest stop of the weakest hand for which `full` is designed, times the angular frequency of the undamped handle on
the surface. An earlier one would leave a larger error for little."""
_LATEST_FULL: Final = 1.3
"""Latest stop of that hand, times the same frequency: a later reduction of the force would be felt as a separate
vibration."""
_LATEST_STOP_PERIODS: Final = 1.5
"""Latest stop of a hand, in periods of the undamped handle on the surface. Later stops make no difference to a tap."""
_MIN_DEPTH: Final = 0.15
"""Part of the depth that a tap without compensation has at a time, and that one with `full` has at least."""
_MAX_INWARD_RATIO: Final = 1.5
"""Largest distance by which a tap pushes the handle into the surface, over that by which a plain one lifts it; at least
the depth that the approach alone reaches."""
_MIN_SEPARATION: Final = 0.1
"""Depths of `full` and `kept` that differ by less than this part of their largest difference are not compared: there
the step of an encoder would decide."""
_TAIL_PAIRS: Final = tuple((decay + 0.2j, decay + high) for decay in (-0.3, -0.45) for high in (0.5j, 0.8j))
"""Poles of the two tails, over the angular frequency of the undamped handle on the surface: pairs to try."""
_LEAST_TAIL_DECAY: Final = 0.3
"""The least decay rate of them, over that angular frequency."""
_KEPT_WEIGHT: Final = 0.1
"""Weight of the displayed error of `kept`, over that of `full`, in the choice of the pair."""
_FULL_ERROR: Final = 0.085
"""Displayed error of `full` that a push of the hand is asked for."""
_FULL_ERROR_FACTOR: Final = 1.25
"""The same where the least possible error is larger, as a factor on that error."""
_UNKNOWN_HAND: Final = (5.0, 300.0)
"""Damping (N s/m) and stiffness (N/m) with which an unknown hand is assumed to push: those of the simulated hand."""

_Floats = npt.NDArray[np.float64]
_Complex = npt.NDArray[np.complex128]


@dataclass(frozen=True, slots=True)
class KeptTap:
    """The two forces of each mode of a tap, and the hands for which they are designed."""

    full: tuple[Shape, ...]
    kept: tuple[Shape, ...]
    full_s: float
    """Time from the onset to the stop of the hand from which on `full` sounds completely."""
    step_s: float
    """Distance between two times of the depths."""
    kept_depth_s: tuple[float, ...]
    """Depth over approach speed (m per m/s) at or below which `kept` alone sounds, PRELOAD_POINTS times from step_s."""
    full_depth_s: tuple[float, ...]
    """Depth over approach speed from which `full` sounds; equal to kept_depth_s where the depth does not count."""

    def full_of(self, mode: Mode, default: Shape) -> Shape:
        """Return the full force of a mode of the tap; `default` for another mode."""
        return next((shape for shape in self.full if shape.mode.pole == pole_of(mode)), default)


class _Contact:
    """Closed forms of the motion of handle and hand on a surface, at the times `t`, as the module describes."""

    def __init__(self, dynamics: Dynamics, load: Load, period_s: float) -> None:
        mass = dynamics.mass_kg
        hand = dynamics.grip_damping_n_s_per_m, dynamics.grip_stiffness_n_per_m
        self._period_s = period_s
        self._stiffness = (dynamics.grip_stiffness_n_per_m + load.stiffness_n_per_m) / mass
        # The surface answers late: by its age and half a period. To first order that is a negative damper.
        late = load.stiffness_n_per_m * (load.age_s + period_s / 2)
        damper = dynamics.damping_n_s_per_m + load.damping_n_s_per_m - late
        self._damping = max(damper, 0.0) / mass
        damping, stiffness = hand if hand != (0.0, 0.0) else _UNKNOWN_HAND
        # A hand at a constant speed balances the dampers.
        self._steady = (dynamics.handle_damping_n_s_per_m + damping) / mass
        self._drop = (damping if stiffness > 0.0 else self._steady * mass) / mass
        self._ramp = stiffness / mass
        self.frequency_per_s = math.sqrt(self._stiffness)
        longest = 2 * math.pi * _LATEST_STOP_PERIODS / self.frequency_per_s
        self.stops_s: _Floats = np.asarray(np.linspace(0.0, longest, _STOP_COUNT), np.float64)
        self.step_s = (
            Ringing(complex(-_LEAST_TAIL_DECAY * self.frequency_per_s), 0j).end_s + longest / 2
        ) / PRELOAD_POINTS
        self.t: _Floats = np.asarray(self.step_s * np.arange(1, PRELOAD_POINTS + 1), np.float64)
        depths = np.array([self._depth(float(stop)) for stop in self.stops_s], np.float64)
        self.depths: _Floats = depths
        """Depths h_T without a tap, (_STOP_COUNT, PRELOAD_POINTS), in m per m/s."""
        self._least: _Floats = np.asarray(np.minimum.accumulate(depths[::-1])[::-1], np.float64)
        """The least depth of any hand that stops no earlier: a late push may swing back."""

    def _free(self, t: _Floats) -> tuple[_Floats, _Floats]:
        """Return the motions from position 1 at rest, and from speed 1 at position 0; both 0 before t = 0."""
        half = self._damping / 2
        root = np.sqrt(complex(half * half - self._stiffness))
        root = root if abs(root) > 1e-6 * self.frequency_per_s else complex(1e-6 * self.frequency_per_s)
        after = np.maximum(t, 0.0)
        grown, shrunk = np.exp((root - half) * after), np.exp((-root - half) * after)
        moving = ((grown - shrunk) / (2 * root)).real * (t >= 0)
        return ((grown + shrunk) / 2).real * (t >= 0) + half * moving, moving

    def _pushed(self, t: _Floats) -> tuple[_Floats, _Floats]:
        """Return the motions under an acceleration of 1 m/s^2 from t = 0 on, and of 1 m/s^3 times t."""
        still, moving = self._free(t)
        after = np.maximum(t, 0.0)
        step = (1.0 - still) / self._stiffness * (t >= 0)
        ramp = (after - (self._stiffness * moving + self._damping * (1.0 - still)) / self._stiffness) / self._stiffness
        return step, ramp * (t >= 0)

    def _depth(self, stop_s: float) -> _Floats:
        step, ramp = self._pushed(self.t)
        dropped, stopped = self._pushed(self.t - stop_s)
        _, moving = self._free(self.t)
        pushed = self._steady * step + self._ramp * ramp - self._drop * dropped - self._ramp * stopped
        return np.asarray(moving + pushed, np.float64)

    def lift(self, pole: complex) -> _Complex:
        """Return Z(t): sampled forces Im(g exp(p k T)), in units of the mass, lift the handle by Im(g Z(t))."""
        end_s = Ringing(pole, 0j).end_s
        beyond = np.exp(pole * end_s) * self._endless_lift(pole, self.t - end_s)
        return np.asarray(self._endless_lift(pole, self.t) - beyond, np.complex128)

    def _endless_lift(self, pole: complex, t: _Floats) -> _Complex:
        still, moving = self._free(t)
        momentum = -pole * self._period_s / (-np.expm1(pole * self._period_s))
        motion = np.exp(pole * np.maximum(t, 0.0)) * (t >= 0) - still - pole * moving
        return np.asarray(momentum * motion / (pole * pole + self._damping * pole + self._stiffness), np.complex128)

    def kicked(self, shape: Shape) -> _Floats:
        """Return how far the kicks of a strike at a tick lift the handle."""
        _, moving = self._free(self.t)
        return self._period_s * sum(kick for kick, _ in shape.kicks) * moving

    def lifted(self, shape: Shape) -> _Floats:
        """Return how far the force of a strike lifts the handle, in m per m/s^2."""
        height = self.kicked(shape)
        for ringing in shape.parts:
            height = height + (ringing.gain * self.lift(ringing.pole)).imag
        return height

    def rows(self, poles: list[complex]) -> _Floats:
        """Return how far unit gains lift the handle: real and imaginary part of each pole, (PRELOAD_POINTS, 2 n)."""
        lifts = [self.lift(pole) for pole in poles]
        return np.array([part for lift in lifts for part in (lift.imag, lift.real)]).T

    def slack(self, plain: _Floats) -> _Floats:
        """Return how much further than `plain` each hand lets a tap lift the handle, (_STOP_COUNT, PRELOAD_POINTS)."""
        return (1.0 - _MIN_DEPTH) * np.maximum(self._least - plain, 0.0)

    def stop_at(self, time_s: float) -> int:
        """Return the index of the stop nearest to a time."""
        return int(np.abs(self.stops_s - time_s).argmin())


@lru_cache(maxsize=1024)
def kept_tap(
    pushes: tuple[tuple[Mode, float], ...], dynamics: Dynamics, rate_hz: float, load: Load, best_in_contact: bool
) -> KeptTap | None:
    """Return the forces of a tap that stays in contact, or None if the least error lifts no further than a plain tap.

    `pushes` has, for each mode of the tap, the largest coefficient along the normal over the approach speed, in 1/s,
    with its sign. Takes some tens of milliseconds.
    """
    least = [shapes_of(mode, dynamics, rate_hz, "full", load, best_in_contact)[1] for mode, _ in pushes]
    contact = _Contact(dynamics, load, 1 / rate_hz)
    plain = [push * (contact.lift(pole_of(mode))).imag for mode, push in pushes]
    total = np.asarray(np.sum(plain, axis=0), np.float64)
    slack = contact.slack(total)
    weights = np.abs([push for _, push in pushes]) / sum(abs(push) for _, push in pushes)

    def designed(poles: tuple[Shape, ...], further: _Floats) -> tuple[Shape, ...] | None:
        """Return shapes with the poles of `poles` and the least error that lift at most `further` than a plain tap."""
        found = []
        for index, (mode, push) in enumerate(pushes):
            shape = poles[index]
            bounds = plain[index] + weights[index] * further - push * contact.kicked(shape)
            rows = push * contact.rows([part.pole for part in shape.parts])
            farthest = max(_MAX_INWARD_RATIO * float(np.abs(plain[index]).max()), float(contact.depths[0].max()))
            inward = farthest + push * contact.kicked(shape)
            both = np.vstack((rows, -rows)), np.concatenate((bounds, inward))
            found.append(bounded_shape(mode, dynamics, rate_hz, load, shape, *both))
        held = tuple(shape for shape in found if shape is not None)
        return held if len(held) == len(pushes) else None

    def height(shapes: tuple[Shape, ...]) -> _Floats:
        """Return how far the tap lifts the handle, in m per m/s."""
        lifts = [push * contact.lifted(shape) for (_, push), shape in zip(pushes, shapes, strict=True)]
        return np.asarray(np.sum(lifts, axis=0), np.float64)

    if (height(tuple(least)) <= total).all():
        return None
    nothing, latest_stop = np.zeros(PRELOAD_POINTS), contact.stop_at(_LATEST_FULL / contact.frequency_per_s)
    tried = [(designed(poles, nothing), designed(poles, slack[latest_stop])) for poles in _with_tails(least, contact)]
    held = [(kept, full) for kept, full in tried if kept is not None and full is not None]
    if not held:
        return None
    kept, full = min(held, key=lambda pair: _error(pair[1]) + _KEPT_WEIGHT * _error(pair[0]))
    wanted = max(_FULL_ERROR, _FULL_ERROR_FACTOR * _error(designed(kept, slack[-1]) or full))
    # The weakest hand with which the error is at most the wanted one, by bisection: the error falls with the push.
    low_stop, high_stop = contact.stop_at(_EARLIEST_FULL / contact.frequency_per_s), latest_stop
    if _error(kept) <= wanted:
        full, high_stop = kept, 0
    while high_stop - low_stop > 1:
        middle = (low_stop + high_stop) // 2
        shapes = designed(kept, slack[middle])
        if shapes is not None and _error(shapes) <= wanted:
            full, high_stop = shapes, middle
        else:
            low_stop = middle
    full_stop = 0 if full == kept else high_stop + _LATER_STOPS
    low = np.maximum(contact.depths[0] - height(kept), 0.0)
    high = contact.depths[full_stop] - height(full)
    separation = high - low
    high = np.where(separation > _MIN_SEPARATION * separation.max(), high, low)
    return KeptTap(
        full,
        kept,
        float(contact.stops_s[full_stop]),
        contact.step_s,
        tuple(low.tolist()),
        tuple(high.tolist()),
    )


def _error(shapes: tuple[Shape, ...]) -> float:
    """Return the largest displayed error of the modes of a tap."""
    return max(shape.error for shape in shapes)


def _with_tails(shapes: list[Shape], contact: _Contact) -> list[tuple[Shape, ...]]:
    """Return the shapes with each pair of tails, or their own tail and a further one; gains are not set."""
    found = []
    for pair in _TAIL_PAIRS:
        poles = (ratio * contact.frequency_per_s for ratio in pair)
        tail, second_tail = (Ringing(pole, 0j) for pole in poles)
        found.append(tuple(replace(shape, tail=tail, second_tail=second_tail) for shape in shapes))
    if any(shape.tail is not None for shape in shapes):
        found.append(
            tuple(replace(pair, tail=shape.tail or pair.tail) for pair, shape in zip(found[0], shapes, strict=True))
        )
    return found
