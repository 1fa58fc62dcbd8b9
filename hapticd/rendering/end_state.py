"""How a simulated motion ends: at rest, or in a lasting cycle.

The energy of a motion that approaches a limit cycle falls, too, so a falling energy does not prove rest. The energy is
followed in windows of half a second until the handle rests, or until the energy has stopped changing.
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
"""`falls`: the energy still falls after the longest time; its limit is unknown."""

ENERGY_WINDOW_S: Final = 0.5
"""Length of the windows over which the energy is averaged."""
REST_SPEED_M_PER_S: Final = 1e-7
"""A handle is at rest if its speed stays within this of its mean over two windows and does not grow."""
FIRST_COMPARISON_WINDOWS: Final = 64
"""Energies are compared after this number of windows, and whenever the number of windows has doubled."""
MAX_CYCLE_ENERGY_DEVIATION: Final = 0.01
"""In a regular cycle, the energies of all windows deviate from their mean by at most this fraction."""
MIN_ENERGY_TREND: Final = 0.1
"""An irregular motion grows or falls if its energy changes by more than this fraction in the last quarter."""
WAIT_AFTER_MOTION_S: Final = 0.2
"""Time from the hand's last waypoint to the beginning of the analysis."""


@dataclass(frozen=True, slots=True)
class EndState:
    """How a simulated motion ends, and when that was certain."""

    fate: Fate
    peak_m_per_s: float
    """Largest deviation of an axis's speed from its mean in the last window."""
    after_s: float
    """Simulated time until the way in which the motion ends was certain."""


def end_state(advance: Callable[[float], npt.NDArray[np.float64]], longest_s: float = 640.0) -> EndState:
    """Return the end state of the motion that `advance` continues.

    `advance(duration_s)` returns position and velocity, (n, 4) in m and m/s, at the next ticks. The hand must have
    stopped moving, and vibrations must be off. A handle that slides at a constant speed counts as at rest.

    A cycle is certain if the energies of the last half of all windows agree to 1 %, and the remaining trend has at
    least halved while the time doubled (a slow decay would double it). Every other motion is followed for `longest_s`.
    """
    energies: list[float] = []
    next_comparison = FIRST_COMPARISON_WINDOWS
    before, trend = math.inf, 0.0
    weights = np.empty(0)
    peak = 0.0
    while len(energies) * ENERGY_WINDOW_S < longest_s:
        speeds = advance(ENERGY_WINDOW_S)[:, 2:]
        if len(weights) != len(speeds):
            # A smooth window makes the energy independent of the phase at which the window begins.
            weights = np.hanning(len(speeds) + 2)[1:-1]
            weights /= weights.sum()
        speeds = speeds - weights @ speeds
        peak = float(np.abs(speeds).max())
        energies.append(float(weights @ np.einsum("ij,ij->i", speeds, speeds)))
        if max(peak, before) <= REST_SPEED_M_PER_S and peak <= before:
            return EndState("rests", peak, len(energies) * ENERGY_WINDOW_S)
        before = peak
        if len(energies) == next_comparison:
            next_comparison *= 2
            last = np.array(energies[len(energies) // 2 :])
            now = abs(_log_energy_change(energies))
            regular = float(np.abs(last / last.mean() - 1.0).max()) < MAX_CYCLE_ENERGY_DEVIATION
            if regular and now <= max(0.5 * trend, 1e-9):
                return EndState("cycles", peak, len(energies) * ENERGY_WINDOW_S)
            trend = now
    change = _log_energy_change(energies)
    fate: Fate = (
        "grows"
        if change > MIN_ENERGY_TREND
        else "falls"
        if change < -MIN_ENERGY_TREND or _decays_slowly(energies)
        else "cycles"
    )
    return EndState(fate, peak, len(energies) * ENERGY_WINDOW_S)


def _log_energy_change(energies: list[float]) -> float:
    """Return ln(E4 / E3), with the energies of the motion in the fourth and third quarter of the simulated time."""
    quarter = max(1, len(energies) // 4)
    third, fourth = (math.fsum(energies[-end : len(energies) - end + quarter]) for end in (2 * quarter, quarter))
    return math.log(max(fourth, 1e-300) / max(third, 1e-300))


def _decays_slowly(energies: list[float]) -> bool:
    """Return whether the energy falls in each eighth of the later half, at last at 75 % of its first rate or more."""
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
    """Return how the motion of the simulated handle ends (see end_state) after the hand's reference has stopped."""
    simulation = Simulation(CompiledScene(config), waypoints, interpolation)
    simulation.advance(waypoints[-1][0] + WAIT_AFTER_MOTION_S)
    return end_state(simulation.advance, longest_s)
