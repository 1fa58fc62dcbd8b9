"""The values of axes, and their combination into points."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from scipy import stats

from hapticd.base.errors import InvalidError
from hapticd.sweeps.axes import axes_of, settings
from hapticd.sweeps.keys import SweepStudy


def points(vary: dict[str, Any], **keys: Any) -> list[tuple[Any, ...]]:
    study = SweepStudy.parsed({"vary": vary, "measure": ["peak_force_n"], **keys})
    return list(zip(*([axis.values[index] for index in axis.of_point] for axis in axes_of(study)), strict=True))


def column(vary: dict[str, Any], **keys: Any) -> np.ndarray[Any, Any]:
    return np.array([point[0] for point in points(vary, **keys)])


def test_crossed_points_are_all_combinations_the_last_key_fastest() -> None:
    found = points({"a.x": [1, 2, 3], "b.x": [0.5, 1.5], "c.x": ["p", "q"]})
    assert found == list(itertools.product([1, 2, 3], [0.5, 1.5], ["p", "q"]))


def test_zipped_points_are_the_nth_values_together() -> None:
    assert points({"a.x": [1, 2], "b.x": ["p", "q"]}, combine="zipped") == [(1, "p"), (2, "q")]
    with pytest.raises(InvalidError, match=r"the same number of values, have: a.x 2, b.x 3"):
        points({"a.x": [1, 2], "b.x": [1, 2, 3]}, combine="zipped")


def test_without_an_axis_there_is_one_point() -> None:
    study = SweepStudy.parsed({"measure": ["peak_force_n"]})
    assert axes_of(study) == ()


def test_a_linear_range_has_equal_steps_and_a_logarithmic_one_equal_ratios() -> None:
    linear = column({"a.x": {"low": 1.0, "high": 2.0, "count": 5}})
    assert linear.tolist() == [1.0, 1.25, 1.5, 1.75, 2.0]
    ratios = column({"a.x": {"low": 10.0, "high": 1000.0, "count": 5, "spacing": "logarithmic"}})
    assert ratios == pytest.approx([10, 10**1.5, 100, 10**2.5, 1000], rel=1e-14)


def test_a_linear_range_of_integers_has_integers() -> None:
    found = points({"parameters.seed": {"low": 0, "high": 3, "count": 4}})
    assert found == [(0,), (1,), (2,), (3,)] and all(type(value) is int for (value,) in found)


@pytest.mark.parametrize(
    ("axis", "expected"),
    [
        ({"low": 2.0, "high": 5.0}, stats.uniform(2.0, 3.0)),
        ({"low": 0.1, "high": 100.0, "spacing": "logarithmic"}, stats.loguniform(0.1, 100.0)),
        ({"mean": -1.0, "standard_deviation": 0.5}, stats.norm(-1.0, 0.5)),
    ],
)
def test_draws_have_their_distribution(axis: dict[str, Any], expected: Any) -> None:
    drawn = column({"a.x": axis}, combine="random", count=4000)
    assert stats.kstest(drawn, expected.cdf).pvalue > 1e-3
    stratified = column({"a.x": axis}, combine="latin_hypercube", count=500)
    # One value in each of 500 equally probable strata.
    assert sorted((expected.cdf(stratified) * 500).astype(int)) == list(range(500))


def test_a_latin_hypercube_pairs_its_axes_at_random() -> None:
    axis = {"low": 0.0, "high": 1.0}
    found = np.array(points({"a.x": axis, "b.x": axis}, combine="latin_hypercube", count=2000))
    assert abs(np.corrcoef(found.T)[0, 1]) < 0.1


def test_drawn_lists_and_levels_are_equally_frequent() -> None:
    found = points({"a.x": ["p", "q", "r"]}, combine="latin_hypercube", count=300)
    assert [found.count((each,)) for each in "pqr"] == [100, 100, 100]


def test_draws_depend_only_on_seed_and_key() -> None:
    axis = {"low": 0.0, "high": 1.0}
    alone = column({"a.x": axis}, combine="random", count=10, seed=3)
    crossed = column({"a.x": axis, "b.x": axis}, combine="random", count=10, seed=3)
    assert alone.tolist() == crossed.tolist()
    assert alone.tolist() != column({"a.x": axis}, combine="random", count=10, seed=4).tolist()


def test_draws_of_an_axis_are_crossed_with_the_others() -> None:
    found = points({"a.x": {"low": 0.0, "high": 1.0, "draws": 3}, "b.x": [1, 2]})
    assert len(found) == 6 and len({a for a, _ in found}) == 3


def test_a_level_sets_its_keys() -> None:
    levels = {"light": {"device.sim.hand.mass_kg": 0.005}, "firm": {"device.sim.hand.mass_kg": 0.02}}
    study = SweepStudy.parsed({"vary": {"grip": {"levels": levels}, "a.x": [1]}, "measure": ["peak_force_n"]})
    assert settings(study, "grip", "firm") == {"device.sim.hand.mass_kg": 0.02}
    assert settings(study, "a.x", 1) == {"a.x": 1}


def test_too_many_points_are_refused_before_they_are_made() -> None:
    axis = {"low": 0.0, "high": 1.0, "count": 10_000}
    with pytest.raises(InvalidError, match="10000 x 10000 = 100000000 points are too many, at most 10000000"):
        points({"a.x": axis, "b.x": axis})


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"vary": {"a.x": {"low": 1.0}}}, "low and high must be given together"),
        ({"vary": {"a.x": {"low": 1.0, "high": 2.0}}}, "needs count or draws"),
        ({"vary": {"a.x": {"mean": 1.0, "standard_deviation": 1.0}}}, "needs draws"),
        ({"vary": {"a.x": {"low": 0.0, "high": 1.0, "count": 3, "spacing": "logarithmic"}}}, "above 0"),
        ({"vary": {"a.x": {"values": [1], "low": 1.0, "high": 2.0}}}, "needs one of: values"),
        ({"vary": {"a.x": [1]}, "combine": "random"}, "needs count, the number of points"),
        ({"vary": {"a.x": [1]}, "count": 3}, "count needs combine: latin_hypercube or random"),
        (
            {"vary": {"a.x": {"low": 1.0, "high": 2.0, "count": 3}}, "combine": "random", "count": 3},
            "must not have count or draws",
        ),
        ({"vary": {"a.x": [None]}}, "must be a number, a string, true or false, is null"),
    ],
)
def test_incompatible_keys_are_reported(keys: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidError, match=message):
        SweepStudy.model_validate({"measure": ["peak_force_n"], **keys})
