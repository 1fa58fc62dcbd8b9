"""`hapticd experiment check`: what cannot be displayed, minutes, trials per cell and simulated power."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
import yaml
from scipy import stats

from hapticd.base.errors import HapticdError
from hapticd.cli import main
from hapticd.config.configuration import load_config
from hapticd.experiment.behaviour import facts_of
from hapticd.experiment.check import breaks_of, check_study
from hapticd.experiment.keys import DifferenceEffect, ProportionEffect
from hapticd.experiment.plan import plan
from hapticd.experiment.power import SIMULATED_EXPERIMENTS, critical_counts, power_of_difference, power_of_proportion
from hapticd.experiment.study import study_of
from tests.experiment.studies import ADAPTIVE, LISTED, PAIRS, RATING

FAST = load_config({})
SLOW = load_config({"servo": {"rate_hz": 1000}})


def _study(text: str, **changes: Any) -> Any:
    return study_of({**yaml.safe_load(text), **changes})


def test_trials_minutes_and_breaks_are_counted() -> None:
    report = check_study(_study(PAIRS), FAST)
    assert (report.practice_trials, report.training_trials, report.test_trials) == (2, 0, 20)
    assert [cell.trials for cell in report.cells] == [1] * 20
    # 22 trials at 20 s, and a break of 10 s after 5, 10 and 15 of the test's 20.
    assert report.breaks == 3
    assert report.minutes == pytest.approx((22 * 20 + 3 * 10) / 60)
    assert report.chance is None
    assert not report.at_most and report.faults == 0 and report.to_look_at == ()


def test_breaks_between_blocks_are_counted_once_with_others() -> None:
    study = _study(PAIRS, breaks={"every_trials": 2, "between_blocks": True})
    # After 2, 4, ..., 18 trials of the test. The second block begins after 10.
    assert breaks_of(plan(study, "P1", 1, 1)) == 9


def test_procedures_have_at_most_their_trials() -> None:
    report = check_study(_study(ADAPTIVE), FAST)
    assert report.at_most
    assert {cell.cell: cell.trials for cell in report.cells} == {"one": 20, "two": 15}


@pytest.mark.long
def test_what_the_rate_cannot_carry_is_named_with_its_stimuli() -> None:
    assert check_study(_study(PAIRS), FAST).undisplayable == ()
    found = check_study(_study(PAIRS), SLOW).undisplayable
    problems = [problem for problem in found if problem.where.startswith("materials.")]
    text = " ".join(map(str, problems))
    # 0.4 of 1 kHz: glass (1721 Hz) and steel (1682 Hz) cannot be carried, wood (67 Hz) and acrylic (128 Hz) can.
    assert "glass" in text and "steel" in text
    assert "wood" not in text and "acrylic" not in text
    assert not any("Hz" in str(problem) for problem in check_study(_study(ADAPTIVE), SLOW).undisplayable)
    data = yaml.safe_load(ADAPTIVE)
    data["trial"]["procedures"]["one"]["method"]["most"] = 900
    assert any("1100" in str(problem) for problem in check_study(study_of(data), SLOW).undisplayable)


def test_names_that_tell_are_reported() -> None:
    data = yaml.safe_load(PAIRS)
    data["questions"]["stiffer"]["answers"][0]["label"] = "Steel"
    warnings = check_study(study_of(data), FAST).to_look_at
    assert [problem.where for problem in warnings] == ["questions.stiffer.answers[0].label"]


def test_a_staircase_that_cannot_reach_its_hardest_level_is_reported() -> None:
    """Before the last of twenty trials are nine steps down of 10 Hz each, as there is no reversal."""
    data = yaml.safe_load(ADAPTIVE)
    method = data["trial"]["procedures"]["one"]["method"]
    method["start"], method["steps"] = 91, [10, 5]
    assert check_study(study_of(data), FAST).to_look_at == ()
    method["start"] = 92
    (warning,) = check_study(study_of(data), FAST).to_look_at
    assert warning.where == "trial.procedures.one.method.steps"
    assert "20 trials reach only 2, not the hardest level 1;" in warning.problem


@pytest.mark.parametrize(
    ("study", "correct"),
    [
        (PAIRS, "the answer that names the stimulus with the highest material, in the order of its levels"),
        (LISTED, "the answer whose level is that of the stimulus"),
        (ADAPTIVE, "the answer that names the target"),
        (RATING, None),
    ],
)
def test_the_correct_answer_is_described_in_words(study: str, correct: str | None) -> None:
    assert check_study(_study(study), FAST).correct == correct


@pytest.mark.long
def test_chance_is_what_the_study_names_as_in_the_analysis() -> None:
    for named in (None, 0.4):
        analysis = {} if named is None else {"chance": named}
        data = {**yaml.safe_load(PAIRS), "analysis": analysis}
        assert check_study(study_of(data), FAST).chance == facts_of(data, "").chance == named


def test_a_proportion_has_no_power_without_chance() -> None:
    effect = {"kind": "proportion", "correct": 0.6, "participants": 8}
    with pytest.raises(HapticdError, match=r"^analysis\.effect: .* analysis\.chance"):
        check_study(_study(PAIRS, analysis={"effect": effect}), FAST)


@pytest.mark.parametrize(("total", "chance"), [(10, 0.5), (56, 1 / 3), (224, 1 / 3), (7, 0.01)])
def test_critical_counts_are_those_of_the_binomial_distribution(total: int, chance: float) -> None:
    low, high = critical_counts(total, chance, 0.05)
    binomial = stats.binom(total, chance)
    assert low < 0 or binomial.cdf(low) <= 0.025
    assert binomial.cdf(low + 1) > 0.025
    assert high > total or binomial.sf(high - 1) <= 0.025
    assert binomial.sf(high - 2) > 0.025


@pytest.mark.parametrize("correct", [0.4, 0.45, 0.25])
def test_the_power_of_a_proportion_is_that_of_the_binomial_test(correct: float) -> None:
    effect = ProportionEffect(kind="proportion", correct=correct, participants=8)
    found = power_of_proportion(effect, 1 / 3, 28)
    low, high = critical_counts(8 * 28, 1 / 3, 0.05)
    binomial = stats.binom(8 * 28, correct)
    exact = binomial.sf(high - 1) if correct > 1 / 3 else binomial.cdf(low)
    assert abs(found.power - exact) < 4 * math.sqrt(exact * (1 - exact) / SIMULATED_EXPERIMENTS)


def test_the_power_of_a_difference_is_that_of_the_noncentral_t() -> None:
    effect = DifferenceEffect(kind="difference", mean=-0.5, standard_deviation=2.0, between=0.3, participants=8)
    found = power_of_difference(effect, 10)
    noncentrality = 0.5 / math.hypot(0.3, 2.0 / math.sqrt(10)) * math.sqrt(8)
    exact = stats.nct(7, noncentrality).sf(stats.t(7).ppf(0.975))
    assert abs(found.power - exact) < 4 * math.sqrt(exact * (1 - exact) / SIMULATED_EXPERIMENTS)


def test_participants_that_differ_spread_the_power() -> None:
    alike = ProportionEffect(kind="proportion", correct=0.4, participants=8)
    unlike = alike.model_copy(update={"between": 0.2})
    assert power_of_proportion(unlike, 1 / 3, 28).power != power_of_proportion(alike, 1 / 3, 28).power


@pytest.mark.long
def test_the_command_prints_the_report_and_its_exit_code_reports_undisplayable_stimuli(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    file = tmp_path / "study.yaml"
    effect = "analysis: {chance: 0.4, effect: {kind: proportion, correct: 0.5, participants: 8}}\n"
    file.write_text(PAIRS.replace("analysis: {published: okamura1998.tapping}\n", effect))
    slow = tmp_path / "slow.yaml"
    slow.write_text("servo: {rate_hz: 1000}")
    fast = tmp_path / "fast.yaml"
    fast.write_text("servo: {rate_hz: 10000}")
    assert main(["experiment", "check", str(file), "-c", str(fast)]) == 0
    output = capsys.readouterr().out
    assert "20 trials" in output and "10 cells of 1 trial" in output and "chance: 40 %" in output
    assert "correct: the answer that names the stimulus with the highest material" in output
    assert "power: " in output and "every stimulus can be displayed as written" in output
    assert main(["experiment", "check", str(file), "-c", str(slow)]) == 1
    assert main(["experiment", "check", str(file), "-c", str(fast), "--json"]) == 0
    capsys.readouterr()
    assert main(["experiment", "check", str(file), "-c", str(slow), "--json"]) == 1
    report = json.loads(capsys.readouterr().out)
    assert report["can_be_shown"] is False and report["test_trials"] == 20


def test_the_command_reports_a_mistake_on_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "study.yaml"
    file.write_text(PAIRS.replace("question: stiffer", "question: stifer"))
    assert main(["experiment", "check", str(file)]) == 1
    output = capsys.readouterr().err
    assert output.count("\n") == 1 and "did you mean stiffer?" in output
    assert main(["experiment", "check", "okamura1998_taping"]) == 1
    assert "did you mean okamura1998_tapping" in capsys.readouterr().err


def test_the_command_lists_what_ships(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["experiment", "list"]) == 0
    names = [line.split()[0] for line in capsys.readouterr().out.splitlines()]
    assert main(["experiment", "list", "--json"]) == 0
    assert [each["name"] for each in json.loads(capsys.readouterr().out)] == names
    assert "okamura1998_tapping" in names and len(names) == 6
