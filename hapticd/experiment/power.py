"""The statistical power of a study, by simulated experiments: the probability of finding the effect that it states.

A proportion of correct answers is tested against chance by the exact binomial test of all answers of all participants.
A difference of a measure is tested against 0 by a t test of the participants' mean differences. Both are two-sided.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from hapticd.analysis.statistics import require_scipy
from hapticd.experiment.keys import DifferenceEffect, ProportionEffect

SIMULATED_EXPERIMENTS: Final = 4000
"""Number of simulated experiments: the standard error of the power is then at most 0.8 %."""
_SIMULATION_SEED: Final = 1
"""Random seed of the simulation, fixed for a reproducible power."""


@dataclass(frozen=True, slots=True)
class Power:
    """The statistical power of a study, from simulated experiments."""

    power: float
    """Fraction of the experiments in which the test finds the effect, in its direction."""
    standard_error: float
    """Standard error of `power`, due to the number of simulated experiments."""
    participants: int
    trials: int
    """Number of answers of each participant; for a difference, number of pairs of trials."""
    test: str
    """Name of the statistical test, with its sample size."""


def power_of_proportion(effect: ProportionEffect, chance: float, trials: int) -> Power:
    """Simulate the power of a test of correct answers against chance, with `trials` answers of each participant.

    The probability of a correct answer is normally distributed over participants, with mean `effect.correct` and
    standard deviation `effect.between`, clipped to 0..1.
    """
    generator = np.random.default_rng(_SIMULATION_SEED)
    size = (SIMULATED_EXPERIMENTS, effect.participants)
    own = np.clip(generator.normal(effect.correct, effect.between, size), 0.0, 1.0)
    right = generator.binomial(trials, own).sum(axis=1)
    total = trials * effect.participants
    low, high = critical_counts(total, chance, effect.significance)
    found = right >= high if effect.correct > chance else right <= low
    return _power(found, effect.participants, trials, f"exact binomial test of {total} answers")


def critical_counts(total: int, chance: float, significance: float) -> tuple[int, int]:
    """Return the lower and the upper critical count of the two-sided exact binomial test of `total` answers.

    The test rejects chance if the number of correct answers is at most the lower or at least the upper count. Each tail
    has at most half of the significance. If no count is critical, the lower one is -1 and the upper one total + 1.
    """
    counts = np.arange(total + 1)
    lgamma = np.array([math.lgamma(count + 1) for count in range(total + 1)])
    log_density = lgamma[-1] - lgamma - lgamma[::-1] + counts * math.log(chance) + counts[::-1] * math.log1p(-chance)
    density = np.exp(log_density)
    below, above = np.cumsum(density), np.cumsum(density[::-1])[::-1]
    low = np.flatnonzero(below <= significance / 2)
    high = np.flatnonzero(above <= significance / 2)
    return (int(low[-1]) if len(low) else -1), (int(high[0]) if len(high) else total + 1)


def power_of_difference(effect: DifferenceEffect, pairs: int) -> Power:
    """Simulate the power of a t test of the difference of a measure, with `pairs` pairs of trials per participant.

    Raises HapticdError if scipy is not installed.
    """
    require_scipy("the power of a difference", "experiment")
    from scipy.special import stdtrit

    generator = np.random.default_rng(_SIMULATION_SEED)
    size = (SIMULATED_EXPERIMENTS, effect.participants)
    deviation = math.hypot(effect.between, effect.standard_deviation / math.sqrt(pairs))
    means = generator.normal(effect.mean, deviation, size)
    t = means.mean(axis=1) / (means.std(axis=1, ddof=1) / math.sqrt(effect.participants))
    critical = float(stdtrit(effect.participants - 1, 1 - effect.significance / 2))
    found = np.sign(effect.mean) * t > critical
    return _power(found, effect.participants, pairs, f"t test of {effect.participants} mean differences")


def _power(found: npt.NDArray[np.bool_], participants: int, trials: int, test: str) -> Power:
    power = float(found.mean())
    return Power(power, math.sqrt(power * (1 - power) / len(found)), participants, trials, test)
