"""Staircases: where they converge, what they estimate, and that a stored staircase continues as before."""

from __future__ import annotations

import json
import math

import numpy as np
import numpy.typing as npt
import pytest

from hapticd.base.errors import HapticdError, InvalidError
from hapticd.experiment.procedures.procedure import ProcedureError
from hapticd.experiment.procedures.staircase import Rule, Staircase, StaircaseParameters

Floats = npt.NDArray[np.float64]
OBSERVERS = 1000
TARGETS: dict[Rule, float] = {"1-up-1-down": 0.5, "1-up-2-down": math.sqrt(0.5), "1-up-3-down": 0.5 ** (1 / 3)}


def logistic(level: float, threshold: float, spread: float, guess: float) -> float:
    """The logistic function, written out: the reference shares no code with the tested module."""
    return guess + (1 - guess) / (1 + math.exp(-(level - threshold) / spread))


def level_of(proportion: float, threshold: float, spread: float, guess: float) -> float:
    share = (proportion - guess) / (1 - guess)
    return threshold + spread * math.log(share / (1 - share))


def run(staircase: Staircase, threshold: float, spread: float, guess: float, generator: np.random.Generator) -> None:
    while (level := staircase.level()) is not None:
        right = generator.random() < logistic(level, threshold, spread, guess)
        staircase.answer(level, bool(right))


def parameters(rule: Rule, guess: float, **more: object) -> StaircaseParameters:
    given: dict[str, object] = {
        "rule": rule,
        "guess": guess,
        "start": 130.0,
        "least": 20.0,
        "most": 200.0,
        "steps": [16.0, 8.0, 4.0],
        "reversals": 1000,
        "trials": 90,
    }
    return StaircaseParameters(**{**given, **more})


@pytest.mark.slow
@pytest.mark.parametrize(
    "rule, guess, target",
    [
        ("1-up-1-down", 0.0, 0.5),
        ("1-up-2-down", 0.5, math.sqrt(0.5)),
        ("1-up-3-down", 0.5, 0.5 ** (1 / 3)),
        ("weighted", 0.5, 0.75),
    ],
)
def test_a_thousand_observers(rule: Rule, guess: float, target: float) -> None:
    """The bias is at most 5 %, 95 % intervals cover 93 to 97 %, and reversals are near the target proportion."""
    generator = np.random.Generator(np.random.PCG64(20))
    given = parameters(rule, guess, target=0.75 if rule == "weighted" else None)
    errors, covered, proportions = [], 0, []
    for _ in range(OBSERVERS):
        threshold, spread = 100 * math.exp(generator.normal(0, 0.08)), 10 * math.exp(generator.normal(0, 0.3))
        staircase = Staircase(given)
        run(staircase, threshold, spread, guess, generator)
        found, truth = staircase.estimate(), level_of(target, threshold, spread, guess)
        errors.append(found.threshold / truth - 1)
        covered += found.low <= truth <= found.high
        mean = staircase.reversal_mean()
        assert mean is not None
        proportions.append(logistic(mean, threshold, spread, guess))
    assert abs(np.mean(errors)) < 0.05
    assert 0.93 <= covered / OBSERVERS <= 0.97
    assert np.mean(proportions) == pytest.approx(target, abs=0.025)


@pytest.mark.long
@pytest.mark.parametrize("rule", TARGETS)
def test_levels_converge_at_the_rules_proportion(rule: Rule) -> None:
    """With small steps and many trials the proportion of positive answers becomes the target (Levitt, 1971). The
    reference is the stationary distribution of the rule's Markov chain over its levels."""
    spread, step, in_a_row = 10.0, 2.0, {"1-up-1-down": 1, "1-up-2-down": 2, "1-up-3-down": 3}[rule]
    levels = np.arange(20.0, 201.0, step)
    chances = np.array([logistic(level, 100, spread, 0) for level in levels])
    size = len(levels)
    chain = np.zeros((size * in_a_row, size * in_a_row))
    for place in range(size):
        for row in range(in_a_row):
            here = place * in_a_row + row
            harder = max(place - 1, 0) * in_a_row if row == in_a_row - 1 else here + 1
            chain[here, harder] += chances[place]
            chain[here, min(place + 1, size - 1) * in_a_row] += 1 - chances[place]
    values, vectors = np.linalg.eig(chain.T)
    stationary = np.real(vectors[:, np.argmax(np.real(values))])
    mean_level = float(np.sum(stationary / stationary.sum() * np.repeat(levels, in_a_row)))
    assert logistic(mean_level, 100, spread, 0) == pytest.approx(TARGETS[rule], abs=0.02)

    generator = np.random.Generator(np.random.PCG64(3))
    staircase = Staircase(parameters(rule, 0.0, steps=[step], start=100.0, reversals=1000, trials=6000))
    run(staircase, 100, spread, 0, generator)
    visited = [each.level for each in staircase.answers]
    assert np.mean(visited) == pytest.approx(mean_level, abs=1.5)
    assert staircase.parameters.proportion == pytest.approx(TARGETS[rule])


def test_a_weighted_staircase_steps_by_the_odds() -> None:
    staircase = Staircase(parameters("weighted", 0.0, target=0.75, steps=[4.0]))
    staircase.answer(130.0, True)
    assert staircase.level() == 126.0
    staircase.answer(126.0, False)
    assert staircase.level() == 138.0  # 3 steps back: 0.75 / 0.25


def test_the_rule_is_followed_step_by_step() -> None:
    """1-up-2-down by hand, with smaller steps after each reversal."""
    staircase = Staircase(parameters("1-up-2-down", 0.5, trials=8))
    visited = []
    for positive in (True, True, True, False, True, True, False, False):
        level = staircase.level()
        assert level is not None
        visited.append(level)
        staircase.answer(level, positive)
    assert visited == [130, 130, 114, 114, 122, 122, 118, 122]
    assert staircase.reversals == [114, 122, 118]
    assert staircase.level() is None
    with pytest.raises(ProcedureError, match="has ended"):
        staircase.answer(126.0, False)


def test_factors_on_a_logarithmic_axis_and_harder_upwards() -> None:
    given = parameters(
        "1-up-1-down", 0.0, axis="logarithmic", steps=[2.0], start=40.0, least=10.0, most=100.0, harder="higher"
    )
    staircase = Staircase(given)
    for positive, level in ((True, 80.0), (True, 100.0), (False, 50.0)):
        now = staircase.level()
        assert now is not None
        staircase.answer(now, positive)
        assert staircase.level() == level


def test_a_stored_staircase_continues_as_before() -> None:
    generator = np.random.Generator(np.random.PCG64(5))
    one = Staircase(parameters("1-up-3-down", 0.5, axis="logarithmic", steps=[1.5, 1.2, 1.1]))
    while (level := one.level()) is not None:
        other = Staircase.restored(json.loads(json.dumps(one.state())))
        assert other.level() == level
        assert (other.reversals, other.answers) == (one.reversals, one.answers)
        one.answer(level, generator.random() < 0.8)
    assert Staircase.restored(one.state()).estimate() == one.estimate()


def test_an_answer_to_another_level_is_refused() -> None:
    staircase = Staircase(parameters("1-up-1-down", 0.0))
    with pytest.raises(ProcedureError, match="level 99, but level 130 was shown"):
        staircase.answer(99.0, False)


@pytest.mark.parametrize(
    "wrong, text",
    [
        ({"rule": "weighted"}, "target is required with rule weighted"),
        ({"target": 0.6}, "not allowed with other rules"),
        ({"guess": 0.8}, "converges at 70.7 % positive answers; guess must be less, is 80 %"),
        ({"start": 300.0}, "start .300. must be between"),
        ({"axis": "logarithmic", "steps": [0.5]}, "each must be more than 1"),
        ({"reversals": 4}, "discard must be at most reversals - 2 = 2, is 4"),
        ({"steps": []}, "at least 1 item"),
        ({"shape": "weibull"}, "shape weibull needs axis: logarithmic"),
    ],
)
def test_bad_parameters(wrong: dict[str, object], text: str) -> None:
    with pytest.raises(InvalidError, match=text):
        parameters(**{"rule": "1-up-2-down", "guess": 0.5, **wrong})  # type: ignore[arg-type]


@pytest.mark.parametrize("state", [None, {"parameters": {}}, {"parameters": {}, "answers": [[1.0]]}, {"answers": []}])
def test_an_invalid_state_is_refused(state: object) -> None:
    with pytest.raises(HapticdError):
        Staircase.restored(state)  # type: ignore[arg-type]
