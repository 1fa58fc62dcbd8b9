"""The law of a tap's amplitude versus speed: the chosen law, the criterion, and the points of a power law."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import optimize

from hapticd.analysis.statistics import Floats
from hapticd.fit.speed_law import law_of

SPEEDS = np.geomspace(0.05, 0.5, 12)


def scattered(amplitudes: Floats, part: float, seed: int = 1) -> Floats:
    return amplitudes * (1 + part * np.random.default_rng(seed).standard_normal(len(amplitudes)))


def test_a_power_law_is_the_one_of_scipy() -> None:
    amplitudes = scattered(100 * SPEEDS**0.5, 0.05)
    law = law_of(SPEEDS, amplitudes, np.full(12, 1e-9))
    best, covariance = optimize.curve_fit(
        lambda v, a, e: a * v**e, SPEEDS, amplitudes, p0=(100, 0.5), sigma=100 * SPEEDS**0.5, absolute_sigma=False
    )
    assert law.kind == "power" and law.power is not None
    assert law.power.exponent.value == pytest.approx(best[1], abs=0.003)
    assert law.power.coefficient_m_per_s2.value == pytest.approx(best[0], rel=0.003)
    wide = 2.228 * math.sqrt(covariance[1, 1])  # Student's t of 10
    assert law.power.exponent.high - law.power.exponent.value == pytest.approx(wide, rel=0.05)


@pytest.mark.parametrize("exponent", [0.3, 0.5, 1.5, 3.0])
def test_the_points_of_a_power_law_are_as_near_to_it_as_they_say(exponent: float) -> None:
    power = law_of(SPEEDS, 100 * SPEEDS**exponent, np.full(12, 1e-12)).power
    assert power is not None and len(power.points) <= 256
    nodes, heights = np.array([(speed, amplitude.value) for speed, amplitude in power.points]).T
    assert nodes[0] == pytest.approx(0.025) and nodes[-1] == pytest.approx(1.0)
    speeds = np.geomspace(nodes[0], nodes[-1], 20_001)
    off = np.abs(np.interp(speeds, nodes, heights) / (100 * speeds**exponent) - 1).max()
    assert off == pytest.approx(power.off, rel=0.01, abs=1e-9) and off <= 1e-3


def test_the_criterion_is_that_of_its_definition() -> None:
    """If the error is only scatter proportional to the amplitude, the weights are those of the amplitudes."""
    amplitudes = scattered(100 * SPEEDS**0.5, 0.03, 4)
    law = law_of(SPEEDS, amplitudes, np.full(12, 1e-12))
    weights = 1 / (100 * SPEEDS**0.5) ** 2

    def criterion(squares: float, unknowns: int) -> float:
        known = unknowns + 1
        return 12 * math.log(squares / 12) + 2 * known + 2 * known * (known + 1) / (12 - known - 1)

    slope = np.sum(weights * SPEEDS * amplitudes) / np.sum(weights * SPEEDS**2)
    power = optimize.least_squares(
        lambda p: np.sqrt(weights) * (amplitudes - p[0] * SPEEDS ** p[1]), (100.0, 0.5), x_scale=(100, 1)
    )
    line = criterion(float(np.sum(weights * (amplitudes - slope * SPEEDS) ** 2)), 1)
    assert law.above["line"] - law.above["power"] == pytest.approx(line - criterion(2 * power.cost, 2), abs=1.0)


@pytest.mark.slow
def test_a_line_is_seldom_taken_for_another_law() -> None:
    kinds = [law_of(SPEEDS, scattered(500 * SPEEDS, 0.1, seed), np.full(12, 1e-6)).kind for seed in range(60)]
    # About 10 % of the sets have an AICc lower by 2 by chance; more than 12 of 60 are improbable.
    assert sum(kind != "line" for kind in kinds) <= 12
    # A law that differs from the line by less than 5 % is a line, however certain.
    assert law_of(SPEEDS, 500 * SPEEDS**1.01, np.full(12, 1e-9)).kind == "line"


def test_amplitudes_that_hardly_follow_the_speed_are_a_law_too() -> None:
    law = law_of(SPEEDS, scattered(np.full(12, 80.0), 0.03), np.full(12, 0.01))
    assert law.kind in ("power", "table") and law.left < 0.06
    assert "for a line" in law.why


def test_few_taps_are_a_line() -> None:
    law = law_of(SPEEDS[:3], 500 * SPEEDS[:3] ** 0.5, np.full(3, 1e-6))
    assert law.kind == "line" and law.why == "too few taps to compare laws"
