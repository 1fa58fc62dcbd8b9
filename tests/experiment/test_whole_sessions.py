"""Complete sessions, from the study to the analysis, by the commands: simulated participants, offline."""

from __future__ import annotations

import csv
from collections import defaultdict
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from hapticd.cli import cli
from hapticd.experiment.analyze import analyze
from hapticd.experiment.behaviour import read_behaviour

RANKING = """\
experiment: 1
title: Put them in order
instructions: Tap all.
base:
  materials: {surface: wood}
  scene:
    objects:
      floor: {kind: wall, point_m: [0, 0], normal: [0, 1], material: surface}
factors:
  material:
    at: materials.surface
    levels: [wood, delrin, glass, steel]
conditions:
  both: {}
  vibration_only: {changes: {scene: {display: {force: false}}}}
trial: {type: ranking, alternatives: 3, cross: [material], question: order}
practice: {trials: 1}
repetitions: 2
questions:
  order: {kind: ranking, text: From hard to soft?, asks: {factor: material, which: highest}}
"""
PEOPLE = ("A", "B", "C")


def _run(study: Path, root: Path, *more: str, people: tuple[str, ...] = PEOPLE) -> Result:
    given = [word for name in people for word in ("--participant", f"simulated:{name}")]
    return CliRunner().invoke(cli, ["experiment", "run", str(study), *given, "-o", str(root), *more])


@pytest.fixture(scope="module")
def ranked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the data set of a ranking study with three simulated participants."""
    root = tmp_path_factory.mktemp("ranking")
    study = root / "ranking.yaml"
    study.write_text(RANKING)
    result = _run(study, root / "data", "--offline")
    assert result.exit_code == 0, result.output
    assert result.output.count("complete") == len(PEOPLE)
    return root / "data"


def _by_hand(root: Path) -> dict[tuple[str, str], list[list[str]]]:
    """Return the stimuli of each condition and cell, in the order of each answer, from the files alone."""
    found: dict[tuple[str, str], list[list[str]]] = defaultdict(list)
    words = ("first", "second", "third")
    for file in root.rglob("*_beh.tsv"):
        with file.open(encoding="utf-8", newline="") as lines:
            for row in csv.DictReader(lines, delimiter="\t"):
                if row["phase"] == "test":
                    shown = [row[f"stimulus_{number}"] for number in (1, 2, 3)]
                    answer = [shown[words.index(word)] for word in row["response"].split(">")]
                    found[row["condition"], row["cell"]].append(answer)
    return found


@pytest.mark.long
def test_rankings_from_the_hand_to_the_analysis(ranked: Path) -> None:
    """Mean ranks and Kendall's W, by its definition from sums of squares of ranks, of the cells of four sets."""
    listed = next(each for each in analyze([ranked]).tables if each.name == "rankings")
    assert listed.columns == ("condition", "cell", "item", "rankings", "mean rank", "Kendall's W")
    by_hand = _by_hand(ranked)
    assert len(by_hand) == 2 * 4
    assert {row[:2] for row in listed.rows} == set(by_hand)
    assert len(listed.rows) == 3 * len(by_hand)
    for condition, cell, item, count, mean, agreement in listed.rows:
        rankings = by_hand[str(condition), str(cell)]
        assert count == len(rankings) == len(PEOPLE) * 2
        assert mean == pytest.approx(sum(each.index(str(item)) + 1 for each in rankings) / len(rankings))
        sums = [sum(each.index(name) + 1 for each in rankings) for name in set(rankings[0])]
        spread = sum((each - 2 * len(rankings)) ** 2 for each in sums)
        largest = sum((rank * len(rankings) - 2 * len(rankings)) ** 2 for rank in (1, 2, 3))
        assert agreement == pytest.approx(spread / largest)


@pytest.mark.long
def test_simulated_participants_rank_by_what_they_feel(ranked: Path) -> None:
    """Wood feels softer than steel by nearly seven times the noise, and is never ranked before it."""
    every = [each for rankings in _by_hand(ranked).values() for each in rankings]
    with_both = [each for each in every if {"wood", "steel"} <= set(each)]
    assert len(with_both) == 2 * 2 * len(PEOPLE) * 2
    assert all(each.index("steel") < each.index("wood") for each in with_both)


def test_the_correct_ranking_is_that_of_the_study(ranked: Path) -> None:
    """It is from the hardest to the softest, in the order of the factor's levels."""
    order = ["steel", "glass", "delrin", "wood"]
    by_hand = _by_hand(ranked)
    right = sum(each == sorted(each, key=order.index) for rankings in by_hand.values() for each in rankings)
    counted = sum(1 for row in read_behaviour([ranked]).rows if row["phase"] == "test" and row.right)
    assert counted == right > 0


def test_several_participants_are_simulated_ones_offline(tmp_path: Path) -> None:
    study = tmp_path / "ranking.yaml"
    study.write_text(RANKING)
    for more, text in (((), "several participants need --offline"), (("--text",), "several participants")):
        result = _run(study, tmp_path / "data", *more)
        assert result.exit_code == 2
        assert text in result.output
    assert not (tmp_path / "data").exists()


def test_a_folder_holds_the_sessions_of_one_study(ranked: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.yaml"
    other.write_text(RANKING.replace("Put them in order", "Order them"))
    before = sorted(ranked.rglob("*"))
    many = _run(other, ranked, "--offline", "--count", "2", people=("D",))
    assert (
        str(many.exception)
        == f"{ranked}: contains sessions of another study, PutThemInOrder; give each study a separate folder with -o"
    )
    result = _run(other, ranked, "--offline", people=("D",))
    assert result.exit_code == 1
    assert "contains sessions of another study, PutThemInOrder" in str(result.exception)
    assert sorted(ranked.rglob("*")) == before


def test_what_has_no_session_left_to_run_starts_no_daemon_and_no_page(ranked: Path) -> None:
    """Neither `resume` of a session that is over nor `run` of one that already exists."""
    session = ranked / "sub-simA" / "ses-01"
    result = CliRunner().invoke(cli, ["experiment", "resume", str(session), "--demo"])
    assert result.output == ""
    assert str(result.exception) == f"{session}: this session is over (all trials are done) and cannot be resumed"
    study = ["experiment", "run", str(ranked.parent / "ranking.yaml"), "--participant", "simA", "--demo"]
    result = CliRunner().invoke(cli, [*study, "-o", str(ranked)])
    assert result.output == ""
    assert str(result.exception).startswith(f"{session}: this session already exists; resume it with")


@pytest.mark.long
def test_a_study_that_was_changed_since_is_reported(
    ranked: Path, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    changed = tmp_path / "ranking.yaml"
    changed.write_text(RANKING.replace("repetitions: 2", "repetitions: 1"))
    data = tmp_path / "data"
    assert _run(ranked.parent / "ranking.yaml", data, "--offline", people=("A",)).exit_code == 0
    same = _run(ranked.parent / "ranking.yaml", data, "--offline", people=("B",))
    assert "was changed" not in same.output + capfd.readouterr().err
    other = _run(changed, data, "--offline", people=("C",))
    assert f"{changed}: changed since the session in {data}" in other.output + capfd.readouterr().err


@pytest.mark.long
def test_undisplayable_stimuli_are_reported_before_a_session(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    study = tmp_path / "stiff.yaml"
    study.write_text(
        RANKING.replace("surface: wood}", "surface: wood, hard: {stiffness_n_per_m: 90000}}").replace(
            "    objects:\n",
            "    objects:\n      below: {kind: wall, point_m: [0, -0.05], normal: [0, 1], material: hard}\n",
        )
    )
    found = _run(study, tmp_path / "data", "--offline", people=("A",))
    assert "on this device: " in found.output + capfd.readouterr().err


def test_a_demo_at_the_terminal_has_no_hand(ranked: Path, tmp_path: Path) -> None:
    study = ["experiment", "run", str(ranked.parent / "ranking.yaml"), "--participant", "P01"]
    result = CliRunner().invoke(cli, [*study, "-o", str(tmp_path), "--text", "--demo"])
    assert result.exit_code == 2
    assert "--text cannot be combined with --demo" in result.output


@pytest.mark.long
def test_no_trial_begins_after_the_time_of_the_test(tmp_path: Path) -> None:
    """On the clock of the simulated hand a trial of three intervals takes several seconds."""
    study = tmp_path / "ranking.yaml"
    study.write_text(RANKING + "stop: {after_s: 20}\n")
    assert _run(study, tmp_path / "data", "--offline", people=("A",)).exit_code == 0
    rows = [row for row in read_behaviour([tmp_path / "data"]).rows if row["phase"] == "test"]
    onsets = [float(row["onset"]) for row in rows]
    assert 1 < len(onsets) < 16
    assert onsets[-1] < onsets[0] + 20
    assert onsets[-1] + float(rows[-1]["duration"]) >= onsets[0] + 20
