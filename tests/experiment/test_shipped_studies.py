"""The shipped studies are valid, the default device displays them, and the paper's are as the paper describes."""

from __future__ import annotations

from collections import Counter

import pytest

from hapticd.config.configuration import load_config
from hapticd.config.shipped_files import described, shipped
from hapticd.experiment.check import check_study
from hapticd.experiment.keys import ChoiceQuestion
from hapticd.experiment.plan import plan
from hapticd.experiment.published import published
from hapticd.experiment.stimuli import config_with
from hapticd.experiment.study import load_study

NAMES = [
    "identify_materials",
    "jnd_frequency",
    "okamura1998_puncture",
    "okamura1998_tapping",
    "okamura1998_texture",
    "realism",
]


def test_six_studies_ship_each_with_a_sentence() -> None:
    assert sorted(shipped("experiments")) == NAMES
    assert all(each.shows.endswith("?") or each.shows.endswith(".") for each in described("experiments"))


@pytest.mark.long
@pytest.mark.parametrize("name", NAMES)
def test_the_default_device_shows_all_of_it_and_no_name_tells(name: str) -> None:
    report = check_study(load_study(name), load_config({}))
    assert report.undisplayable == ()
    assert report.to_look_at == ()
    assert report.test_trials > 0 and report.minutes < 60


@pytest.mark.parametrize("name", NAMES)
def test_no_material_of_the_library_is_named_in_a_scene(name: str) -> None:
    """The participant's page gets the scene. Its materials have the same names in every trial, except those that all
    trials share."""
    study = load_study(name)
    seen = set()
    for trial in plan(study, "P01", 1, 1).trials:
        scene = config_with(study, trial.stimuli).scene
        seen.add(str(sorted((id, item.model_dump_json()) for id, item in scene.objects.items())))
    assert len(seen) == 1


def test_tapping_is_as_in_the_paper() -> None:
    study = load_study("okamura1998_tapping")
    paper = published("okamura1998.tapping")
    assert list(study.factors["material"].names) == paper["order_of_stiffness"]
    trials = [each for each in plan(study, "P01", 1, 1).trials if each.phase == "test"]
    assert Counter(each.condition for each in trials) == {
        "force_and_vibration": paper["pairs"],
        "vibration_only": paper["pairs"],
    }
    for condition in study.conditions:
        cells = Counter(each.cell for each in trials if each.condition == condition)
        assert len(cells) == 28 and set(cells.values()) == {1}
    same = [each for each in trials if each.correct == "same"]
    assert len(same) == 14
    assert isinstance(study.asked, ChoiceQuestion)
    assert len(study.asked.answers) == 3
    for trial in trials:
        config = config_with(study, trial.stimuli)
        left, right = config.materials["left"], config.materials["right"]
        assert left.stiffness_n_per_m == right.stiffness_n_per_m == 800
        assert left.tap is not None and right.tap is not None
        assert (left.tap == right.tap) == (trial.correct == "same")
        assert config.scene.display.force == (trial.condition == "force_and_vibration")
        assert config.scene.display.vibration


def test_texture_is_as_in_the_paper() -> None:
    study = load_study("okamura1998_texture")
    trials = [each for each in plan(study, "P01", 1, 1).trials if each.phase == "test"]
    # The lower triangle of Table 3 with its diagonal: ten pairs in each of three displays.
    assert Counter(each.condition for each in trials) == {"geometry": 10, "damping": 10, "vibration": 10}
    assert study.factors["spacing_m"].names == (0.0016, 0.0024, 0.0048, 0.0064)
    shipped_materials = load_config({}).materials
    for trial in trials:
        config = config_with(study, trial.stimuli)
        for place, stimulus in zip(("left", "right"), trial.stimuli, strict=True):
            spacing_m = stimulus.levels["spacing_m"]
            assert isinstance(spacing_m, float)
            assert config.materials[place] == shipped_materials[f"comb_{round(1e6 * spacing_m)}um_{trial.condition}"]
        spacings = [float(str(stimulus.levels["spacing_m"])) for stimulus in trial.stimuli]
        finer = "first" if spacings[0] < spacings[1] else "second" if spacings[0] > spacings[1] else "same"
        assert trial.correct == finer


def test_puncture_is_with_and_without_vibration() -> None:
    study = load_study("okamura1998_puncture")
    trials = [each for each in plan(study, "P01", 1, 1).trials if each.phase == "test"]
    assert Counter(each.condition for each in trials) == {"with_vibration": 10, "without_vibration": 10}
    for trial in trials:
        config = config_with(study, trial.stimuli)
        assert config.scene.display.vibration == (trial.condition == "with_vibration")
        assert config.scene.display.force
        assert config.materials["cellophane"].rupture is not None


def test_the_letters_of_the_identification_name_all_seven_materials() -> None:
    study = load_study("identify_materials")
    trials = plan(study, "P01", 1, 1).trials
    pairs = Counter((each.cell, each.correct) for each in trials if each.phase == "test")
    assert len(pairs) == 7 and set(pairs.values()) == {10}
    assert len({correct for _, correct in pairs}) == 7
    for repetition in range(1, 11):
        cells = [each.cell for each in trials if each.phase == "test" and each.repetition == repetition]
        assert len(set(cells)) == 7
