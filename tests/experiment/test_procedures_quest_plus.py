"""QUEST+ compared with the package questplus and with a thousand simulated observers."""

from __future__ import annotations

import json
import math
import warnings

import numpy as np
import pytest

from hapticd.base.errors import InvalidError
from hapticd.experiment.analysis.psychometric_shapes import axis, level
from hapticd.experiment.procedures.posterior import expected_entropies, interval, marginal, summary, updated
from hapticd.experiment.procedures.procedure import ProcedureError
from hapticd.experiment.procedures.quest_plus import QuestPlus, QuestPlusParameters

OBSERVERS = 1000


def quest_plus(**more: object) -> QuestPlus:
    given: dict[str, object] = {
        "levels": {"least": 10.0, "most": 1000.0, "count": 21, "axis": "logarithmic"},
        "slopes": [1.0, 2.0, 3.0, 5.0],
        "guesses": [0.5],
        "lapses": [0.01, 0.04],
    }
    return QuestPlus(QuestPlusParameters(**{**given, **more}))


@pytest.mark.long
@pytest.mark.parametrize("shape, scale", [("weibull", "log10"), ("weibull", "linear"), ("cumulative_normal", "linear")])
def test_the_posterior_is_that_of_questplus(shape: str, scale: str) -> None:
    """Equal answers give equal posteriors and equal next levels."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        reference = pytest.importorskip("questplus")
    levels = np.geomspace(10, 1000, 21) if shape == "weibull" else np.linspace(10, 210, 21)
    slopes = np.array([1.0, 2.0, 3.0, 5.0]) if shape == "weibull" else 1 / np.array([60.0, 40.0, 20.0, 10.0])
    shown = np.log10(levels) if scale == "log10" else levels
    slope_name = "slope" if shape == "weibull" else "sd"
    theirs = reference.QuestPlus(
        stim_domain={"intensity": shown},
        param_domain={
            **({"threshold": shown} if shape == "weibull" else {"mean": shown}),
            slope_name: slopes if shape == "weibull" else 1 / slopes,
            ("lower_asymptote"): np.array([0.5]),
            "lapse_rate": np.array([0.01, 0.04]),
        },
        outcome_domain={"response": ["Yes", "No"]},
        func="weibull" if shape == "weibull" else "norm_cdf",
        stim_scale=scale,
        stim_selection_method="min_entropy",
        param_estimation_method="mean",
    )
    ours = quest_plus(
        levels=levels.tolist(),
        slopes=slopes.tolist(),
        shape=shape,
        axis="logarithmic" if shape == "weibull" else "linear",
    )
    generator = np.random.Generator(np.random.PCG64(1))
    for _ in range(30):
        due, place = ours.level(), int(np.argmin(np.abs(shown - theirs.next_stim["intensity"])))
        assert due is not None
        assert due == pytest.approx(levels[place])
        positive = bool(generator.random() < 0.5 + 0.48 * (1 - math.exp(-due / 100)))
        theirs.update(stim={"intensity": shown[place]}, outcome={"response": "Yes" if positive else "No"})
        ours.answer(due, bool(positive))
        order = ("threshold" if shape == "weibull" else "mean", slope_name, "lower_asymptote", "lapse_rate")
        expected = theirs.posterior.transpose(*order).values.ravel()
        assert np.abs(ours.posterior - expected).max() < 1e-9


def test_expected_entropies_are_sums_over_both_answers() -> None:
    """The reference is the definition, written out."""
    generator = np.random.Generator(np.random.PCG64(2))
    prior, table = generator.dirichlet(np.ones(40)), generator.random((7, 40))
    expected = []
    for row in table:
        total = 0.0
        for likelihood in (row, 1 - row):
            chance = float(np.sum(prior * likelihood))
            after = prior * likelihood / chance
            total -= chance * sum(float(p) * math.log(p) for p in after)
        expected.append(total)
    assert expected_entropies(prior, table) == pytest.approx(np.array(expected), abs=1e-12)
    assert expected_entropies(np.stack((prior, prior)), table) == pytest.approx(
        np.array((expected, expected)), abs=1e-12
    )


@pytest.mark.slow
def test_a_thousand_observers() -> None:
    """The bias of the threshold is at most 5 %, and 95 % intervals cover 93 to 97 %. Observers are rows of an array,
    which `test_one_observer_of_many` compares with `QuestPlus`."""
    generator = np.random.Generator(np.random.PCG64(3))
    one = quest_plus(
        levels={"least": 20.0, "most": 500.0, "count": 31, "axis": "logarithmic"},
        thresholds={"least": 20.0, "most": 500.0, "count": 61, "axis": "logarithmic"},
        slopes={"least": 1.0, "most": 8.0, "count": 9, "axis": "logarithmic"},
        lapses=[0.02],
    )
    # The observers are drawn from the prior: 95 % of them must lie in their 95 % intervals.
    thresholds = np.exp(generator.uniform(math.log(20), math.log(500), OBSERVERS))
    slopes = np.exp(generator.uniform(math.log(1), math.log(8), OBSERVERS))
    posterior = np.repeat(one.posterior[None], OBSERVERS, axis=0)
    for _ in range(60):
        at = np.argmin(expected_entropies(posterior, one.table), axis=1)
        truth = 0.5 + 0.48 * (1 - np.exp(-((one.levels[at] / thresholds) ** slopes)))
        positive = generator.random(OBSERVERS) < truth
        posterior = updated(posterior, np.where(positive[:, None], one.table[at], 1 - one.table[at]))
    places = axis(one.parameters.threshold_values, True)
    found = np.array(
        [summary(places, marginal(own, one.grid_shape, 0), lambda place: level(place, True)) for own in posterior]
    )
    assert abs(np.mean(found[:, 0] / thresholds) - 1) < 0.05
    assert 0.93 <= np.mean((found[:, 1] <= thresholds) & (thresholds <= found[:, 2])) <= 0.97


def test_one_observer_of_many() -> None:
    """`QuestPlus` has the levels and estimates of one row of the array in `test_a_thousand_observers`."""
    one = quest_plus()
    posterior = np.repeat(one.posterior[None], 2, axis=0)
    for positive in (True, False, True, True):
        due = one.level()
        assert due is not None
        at = np.argmin(expected_entropies(posterior, one.table), axis=1)
        assert one.levels[at].tolist() == [due, due]
        likelihood = one.table[at] if positive else 1 - one.table[at]
        posterior = updated(posterior, likelihood)
        one.answer(due, positive)
        assert posterior[1] == pytest.approx(one.posterior, abs=1e-15)


def test_a_stored_run_continues_as_before() -> None:
    one = quest_plus(trials=20)
    generator = np.random.Generator(np.random.PCG64(4))
    while (due := one.level()) is not None:
        other = QuestPlus.restored(json.loads(json.dumps(one.state())))
        assert other.level() == due
        assert np.array_equal(other.posterior, one.posterior)
        one.answer(due, generator.random() < 0.75)
    assert len(one.answers) == 20


def test_it_ends_when_it_is_precise() -> None:
    one = quest_plus(precision=0.5, trials=200)
    generator = np.random.Generator(np.random.PCG64(5))
    while (due := one.level()) is not None:
        one.answer(due, generator.random() < 0.5 + 0.48 * (1 - math.exp(-((due / 100) ** 3))))
    found = one.estimate()
    assert len(one.answers) < 200
    assert found.high - found.low <= found.threshold


def test_intervals_of_an_even_posterior() -> None:
    """The interval contains 95 % of a uniform distribution from 0 to 1."""
    values = (np.arange(1000) + 0.5) / 1000
    assert interval(values, np.full(1000, 1e-3)) == pytest.approx((0.025, 0.975), abs=1e-12)


def test_what_cannot_be_answered() -> None:
    one = quest_plus()
    with pytest.raises(ProcedureError, match="level 11, which is not a level of QUEST\\+; the nearest is 10"):
        one.answer(11.0, True)
    with pytest.raises(ProcedureError, match="no answers"):
        one.estimate()
    sure = quest_plus(shape="logistic", axis="linear", levels=[0.0, 1e6], slopes=[1.0], guesses=[0.0], lapses=[0.0])
    sure.answer(1e6, True)
    with pytest.raises(ProcedureError, match="has probability 0 at every grid point"):
        quest_plus(levels=[1.0, 1e6], thresholds=[1.0], slopes=[5.0], guesses=[0.0], lapses=[0.0]).answer(1e6, False)


@pytest.mark.parametrize(
    "wrong, text",
    [
        ({"levels": [3.0, 2.0]}, "levels must rise"),
        ({"levels": [-1.0, 2.0]}, "levels must be more than 0 on a logarithmic axis"),
        ({"guesses": [0.5], "lapses": [0.5]}, "must be less than 1"),
        ({"levels": {"least": 1.0, "most": 0.5, "count": 3}}, "least .1. must be less than most"),
        (
            {"thresholds": {"least": 1.0, "most": 2.0, "count": 1000}, "slopes": [float(n) for n in range(1, 900)]},
            "must be at most 2000000, are ",
        ),
    ],
)
def test_bad_parameters(wrong: dict[str, object], text: str) -> None:
    with pytest.raises(InvalidError, match=text):
        quest_plus(**wrong)
