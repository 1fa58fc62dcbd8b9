"""How a simulated motion ends: at rest, or in a cycle that goes on for ever.

A drop of energy proves nothing, as a motion that comes down to a limit cycle drops, too. So the energy of stretches of
half a second is followed until the handle rests, or until it no longer changes over hundreds of stretches.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from hapticd.config.configuration import Config
from hapticd.rendering.offline import CompiledScene, Simulation

Fate = Literal["rests", "cycles", "grows", "falls"]
"""`falls`: the energy still falls after the longest time; nobody knows to what."""

STRETCH_S: Final = 0.5
NOTHING_M_PER_S: Final = 1e-7
"""A handle whose speed stays within this of its mean over two stretches, and does not grow, is at rest."""
FIRST_LOOK: Final = 64
"""Energies are compared after so many stretches, and whenever their number has doubled."""
STEADY: Final = 0.01
"""In a regular cycle no stretch has an energy further from their mean than this part of it."""
CHANGES: Final = 0.1
"""What is not regular (chaotic, or beating) grows or falls if its energy changes by more than this part within the last
quarter of the time."""
RESTED_S: Final = 0.2
"""A motion is judged from so long after the hand's last waypoint on."""


@dataclass(frozen=True, slots=True)
class EndState:
    """How a motion ends."""

    fate: Fate
    peak_m_per_s: float
    """How far the speed of an axis was from its mean, at most, in the last stretch."""
    after_s: float
    """So long it took to be certain."""


def end_state(go_on: Callable[[float], npt.NDArray[np.float64]], longest_s: float = 640.0) -> EndState:
    """The end of the motion that `go_on` continues.

    `go_on(duration_s)` returns position and velocity, (n, 4) in m and m/s, at the ticks of the time to come. The hand
    must have stopped to move, and vibrations must be off. A handle that slides at a constant speed is at rest.

    A cycle is certain where the energies of the last half of all stretches agree to 1 %, and what is left of a trend
    has at least halved while the time doubled (a slow decay doubles it). Everything else is followed for `longest_s`.
    """
    energies: list[float] = []
    look = FIRST_LOOK
    before, trend = math.inf, 0.0
    weights = np.empty(0)
    peak = 0.0
    while len(energies) * STRETCH_S < longest_s:
        speeds = go_on(STRETCH_S)[:, 2:]
        if len(weights) != len(speeds):
            # A smooth window: the energy of a cycle does not depend on where in it the stretch begins.
            weights = np.hanning(len(speeds) + 2)[1:-1]
            weights /= weights.sum()
        speeds = speeds - weights @ speeds
        peak = float(np.abs(speeds).max())
        energies.append(float(weights @ np.einsum("ij,ij->i", speeds, speeds)))
        if max(peak, before) <= NOTHING_M_PER_S and peak <= before:
            return EndState("rests", peak, len(energies) * STRETCH_S)
        before = peak
        if len(energies) == look:
            look *= 2
            last = np.array(energies[len(energies) // 2 :])
            now = abs(_change(energies))
            regular = float(np.abs(last / last.mean() - 1.0).max()) < STEADY
            if regular and now <= max(0.5 * trend, 1e-9):
                return EndState("cycles", peak, len(energies) * STRETCH_S)
            trend = now
    change = _change(energies)
    fate: Fate = "grows" if change > CHANGES else "falls" if change < -CHANGES or _fades(energies) else "cycles"
    return EndState(fate, peak, len(energies) * STRETCH_S)


def _change(energies: list[float]) -> float:
    """Of the energy, from the third quarter of the time to the fourth, as the logarithm of their ratio."""
    quarter = max(1, len(energies) // 4)
    third, fourth = (math.fsum(energies[-end : len(energies) - end + quarter]) for end in (2 * quarter, quarter))
    return math.log(max(fourth, 1e-300) / max(third, 1e-300))


def _fades(energies: list[float]) -> bool:
    """Whether each eighth of the last half has less energy than the one before, by no less each time: a slow decay."""
    eighth = max(1, len(energies) // 8)
    means = [math.fsum(energies[len(energies) - k * eighth :][:eighth]) for k in (4, 3, 2, 1)]
    falls = np.diff(np.log(np.maximum(means, 1e-300)))
    return bool((falls < 0.0).all() and falls[-1] <= 0.75 * falls[0])


def end_of(
    config: Config,
    waypoints: Sequence[Sequence[float]],
    longest_s: float = 640.0,
    interpolation: Literal["linear", "minimum_jerk"] = "linear",
) -> EndState:
    """How the motion of the simulated handle ends once the hand's reference rests, as end_state judges it."""
    simulation = Simulation(CompiledScene(config), waypoints, interpolation)
    simulation.go_on(waypoints[-1][0] + RESTED_S)
    return end_state(simulation.go_on, longest_s)
