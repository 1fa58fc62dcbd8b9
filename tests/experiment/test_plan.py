"""A plan has each cell as often as the study asks, with the correct answers, and equal plans for equal seeds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from itertools import combinations_with_replacement
from typing import Any

import pytest
import yaml

from hapticd.base.errors import InvalidError
from hapticd.base.merge_patch import merge_patch
from hapticd.config.configuration import load_config
from hapticd.experiment.cells import cells_of
from hapticd.experiment.key_paths import difference
from hapticd.experiment.plan import Plan, PlannedTrial, plan
from hapticd.experiment.stimuli import at_level, config_with
from hapticd.experiment.study import study_of
from tests.experiment.studies import ADAPTIVE, CONSTANT, LISTED, PAIRS, RATING

LEVELS = ["wood", "acrylic", "glass", "steel"]


def _plan(text: str, participant: str = "P01", session: int = 1, seed: int = 1, **changes: Any) -> Plan:
    return plan(study_of({**yaml.safe_load(text), **changes}), participant, session, seed)


def _test(made: Plan) -> list[PlannedTrial]:
    return [trial for trial in made.trials if trial.phase == "test"]


@pytest.mark.parametrize("text", [PAIRS, ADAPTIVE, LISTED, RATING, CONSTANT])
def test_the_same_seed_gives_the_same_plan_and_another_another(text: str) -> None:
    made = _plan(text, seed=5)
    assert made == _plan(text, seed=5)
    assert [trial.index for trial in made.trials] == list(range(len(made.trials)))
    others = [_plan(text, seed=seed).trials for seed in range(6, 12)]
    assert any(other != made.trials for other in others)
    counts = Counter((trial.condition, trial.cell) for trial in _test(made))
    assert all(
        Counter((each.condition, each.cell) for each in other if each.phase == "test") == counts for other in others
    )


@pytest.mark.parametrize("repetitions", [1, 2, 3])
@pytest.mark.parametrize("both_orders", [False, True])
def test_every_pair_comes_as_often_as_asked(repetitions: int, both_orders: bool) -> None:
    trial = {**yaml.safe_load(PAIRS)["trial"], "both_orders": both_orders}
    made = _plan(PAIRS, repetitions=repetitions, trial=trial)
    for condition in ("both", "alone"):
        trials = [each for each in _test(made) if each.condition == condition]
        pairs = Counter(tuple(sorted(stimulus.name for stimulus in each.stimuli)) for each in trials)
        for one, other in combinations_with_replacement(LEVELS, 2):
            times = 2 if both_orders and one != other else 1
            assert pairs[tuple(sorted((one, other)))] == repetitions * times
        for level in LEVELS:
            left = sum(each.stimuli[0].name == level for each in trials if len({s.name for s in each.stimuli}) == 2)
            right = sum(each.stimuli[1].name == level for each in trials if len({s.name for s in each.stimuli}) == 2)
            assert abs(left - right) <= 1
        assert len({each.block for each in trials}) == 1


def test_the_correct_answer_is_that_of_the_harder_material() -> None:
    for trial in _plan(PAIRS, repetitions=3).trials:
        ranks = [LEVELS.index(stimulus.name) for stimulus in trial.stimuli]
        expected = "same" if ranks[0] == ranks[1] else "first" if ranks[0] > ranks[1] else "second"
        assert trial.correct == expected
        assert trial.cell == "/".join(sorted((stimulus.name for stimulus in trial.stimuli), key=LEVELS.index))
    asked = yaml.safe_load(PAIRS)["questions"]
    asked["stiffer"]["asks"]["which"] = "lowest"
    for trial in _plan(PAIRS, questions=asked).trials:
        ranks = [LEVELS.index(stimulus.name) for stimulus in trial.stimuli]
        assert trial.correct == ("same" if ranks[0] == ranks[1] else "first" if ranks[0] < ranks[1] else "second")


def test_the_scene_holds_the_materials_at_their_places_and_no_name_of_them() -> None:
    made = _plan(PAIRS)
    shipped = load_config({}).materials
    for trial in made.trials:
        config = config_with(made.study, trial.stimuli)
        for place, stimulus in zip(("left", "right"), trial.stimuli, strict=True):
            assert config.materials[place] == shipped[stimulus.name]
            assert config.scene.objects[place].material == place  # type: ignore[union-attr]
        assert config.scene.display.force == (trial.condition == "both")


def test_practice_comes_first_with_stimuli_of_its_own() -> None:
    made = _plan(PAIRS)
    assert [trial.phase for trial in made.trials[:3]] == ["practice", "practice", "test"]
    assert [trial.block for trial in made.trials[:3]] == [1, 1, 2]
    assert {trial.block for trial in _test(made)} == {2, 3}


def test_listed_trials_keep_their_stimuli_and_conditions() -> None:
    trials = _plan(LISTED).trials
    counts = Counter((trial.condition, trial.stimuli[0].name, trial.correct) for trial in trials)
    assert counts == {("first", "wood", "A"): 1, ("first", "steel", "B"): 2, ("second", "steel", "B"): 2}


def test_a_forced_choice_shows_one_target_among_references() -> None:
    trials = _test(_plan(CONSTANT))
    assert Counter(trial.cell for trial in trials) == {"600": 7, "700": 7, "900": 7, "1000": 7}
    names = ["one", "two", "three"]
    for trial in trials:
        values = [stimulus.levels["stiffness"] for stimulus in trial.stimuli]
        assert values.count(800) == 2
        assert trial.correct == names[next(index for index, value in enumerate(values) if value != 800)]
    positions = Counter(trial.correct for trial in trials)
    assert max(positions.values()) - min(positions.values()) <= 1


def test_a_latin_square_by_cell_orders_the_trials_of_all_participants() -> None:
    orders = []
    for number in range(1, 5):
        trials = _plan(RATING, participant=f"P{number}").trials
        cells = [trial.cell for trial in trials]
        orders.append(list(dict.fromkeys(cells)))
        assert Counter(cells) == dict.fromkeys(orders[-1], 3)
    for position in range(4):
        assert len({order[position] for order in orders}) == 4


def test_an_adaptive_trial_takes_its_level_when_it_is_due() -> None:
    made = _plan(ADAPTIVE)
    practice = [trial for trial in made.trials if trial.phase == "practice"]
    assert len(practice) == 3 and all(trial.procedure is None for trial in practice)
    assert {_hz(made, trial, TARGET) for trial in practice} <= {300.0, 400.0}
    trials = _test(made)
    assert Counter(trial.procedure for trial in trials) == {"one": 20, "two": 15}
    for trial in trials:
        shown = at_level(made.study, trial, 1.5)
        expected = 201.5 if trial.procedure == "one" else 300.0
        target = next(index for index, stimulus in enumerate(shown) if stimulus.name == "target")
        assert trial.correct == ("first", "second")[target]
        found = [config_with(made.study, (stimulus,)).materials["surface"].tap for stimulus in shown]
        hertz = [tap.frequency_hz for tap in found if tap is not None]
        assert hertz[target] == expected and hertz[1 - target] == 200.0
        assert shown[target].levels["frequency_hz"] == expected
    with pytest.raises(InvalidError, match="frequency_hz"):
        at_level(made.study, trials[0], -1e6)


@pytest.mark.parametrize(
    ("method", "ends", "trials"),
    [
        ({"kind": "quest_plus", "levels": [10, 20, 50], "slopes": [3.5], "trials": 31}, (10, 50), 31),
        ({"kind": "quest_plus", "levels": {"least": 5, "most": 90, "count": 4}, "slopes": [3.5]}, (5, 90), 60),
        ({"kind": "constant_stimuli", "levels": [20, 10, 50], "repetitions": 4}, (10, 50), 12),
    ],
)
def test_each_kind_of_procedure_has_its_trials_and_ends(
    method: dict[str, Any], ends: tuple[float, float], trials: int
) -> None:
    trial = yaml.safe_load(ADAPTIVE)["trial"]
    trial["procedures"]["one"]["method"] = method
    made = _plan(ADAPTIVE, trial=trial)
    assert made.study.adaptive("one").ends == ends
    assert Counter(each.procedure for each in _test(made))["one"] == trials


TARGET = "target"


def _hz(made: Plan, trial: PlannedTrial, name: str) -> float:
    stimulus = next(each for each in trial.stimuli if each.name == name)
    tap = config_with(made.study, (stimulus,)).materials["surface"].tap
    assert tap is not None and tap.frequency_hz is not None
    return tap.frequency_hz


def test_each_stimulus_of_a_ranking_is_at_each_position_and_the_correct_order_is_known() -> None:
    data = yaml.safe_load(CONSTANT)
    data["trial"] = {"type": "ranking", "alternatives": 4, "cross": ["stiffness"], "question": "order"}
    asks = {"factor": "stiffness", "which": "highest"}
    data["questions"] = {"order": {"kind": "ranking", "text": "Order them.", "asks": asks}}
    trials = plan(study_of({**data, "repetitions": 4}), "P1", 1, 1).trials
    words = ["first", "second", "third", "fourth"]
    for position in range(4):
        assert len({trial.stimuli[position].name for trial in trials}) == 4
    for trial in trials:
        values = [float(stimulus.name) for stimulus in trial.stimuli]
        order = sorted(range(4), key=lambda index, values=values: -values[index])
        assert trial.correct == ">".join(words[index] for index in order)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ({}, {"a": 1}),
        ({"a": {"b": 1, "c": [1, 2]}}, {"a": {"b": 2, "c": [1, 3]}}),
        ({"a": {"b": 1}, "d": 1}, {"a": 3}),
        ({"a": 1, "b": True}, {"a": {"x": {"y": 1}}, "b": 1}),
        ({"a": {"b": {"c": 1}}}, {"a": {"b": {}}}),
    ],
)
def test_a_difference_applied_is_the_other_document(old: Mapping[str, Any], new: Mapping[str, Any]) -> None:
    found = merge_patch(dict(old), difference(old, new))
    assert found == new


@pytest.mark.long
def test_a_long_list_makes_each_stimulus_once() -> None:
    """10,000 listed trials of two levels make 10,000 cells, but only two stimuli."""
    document = yaml.safe_load(LISTED)
    trials = [{"stimuli": [{"material": ("wood", "steel")[number % 2]}]} for number in range(10_000)]
    study = study_of({**document, "conditions": {"all": {}}, "trial": {**document["trial"], "list": trials}})
    cells = cells_of(study)
    assert [cell.name for cell in cells] == ["wood", "steel"] * 5_000
    assert len({id(levels) for cell in cells for levels in cell.levels}) == 2
    made = plan(study, "P01", 1, 1)
    assert len(made.trials) == 10_000
    assert len({id(stimulus) for trial in made.trials for stimulus in trial.stimuli}) == 2
