"""`hapticd experiment analyze`: from folders of sessions to tables, CSV, JSON and the page."""

from __future__ import annotations

import csv
import json
import math
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from hapticd.base.errors import HapticdError
from hapticd.cli import cli
from hapticd.experiment import report
from hapticd.experiment.analyze import Analysis, analyze
from hapticd.experiment.published_tables import published_results
from hapticd.experiment.results import ResultTable
from tests.experiment import behaviour_tables as tables

PEOPLE = tuple(f"P{number:02d}" for number in range(1, 9))


def table(found: Analysis, name: str) -> ResultTable:
    return next(each for each in found.tables if each.name == name)


def row(found: Analysis, name: str, *first: object) -> dict[str, object]:
    own = table(found, name)
    return next(dict(zip(own.columns, each, strict=True)) for each in own.rows if each[: len(first)] == first)


@pytest.fixture(scope="module")
def tapping(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("tapping")
    tables.tapping(root, PEOPLE)
    return root


def test_percent_correct_is_counted_as_by_hand(tapping: Path) -> None:
    """Medians and quartiles from the files, read here by csv."""
    found = analyze([tapping])
    assert found.summary.startswith(
        "8 participants, 8 sessions, 448 trials of the test; 8 of practice or training and 8"
    )
    percents = []
    for file in sorted(tapping.rglob("*_beh.tsv")):
        with file.open() as lines:
            own = [each for each in csv.DictReader(lines, delimiter="\t") if each["condition"] == "vibration_only"]
        right = [int(each["correct"]) for each in own if each["correct"] != "n/a"]
        assert len(right) == 28
        percents.append(100 * sum(right) / 28)
    own_row = row(found, "conditions", "vibration_only")
    assert own_row["median, %"] == pytest.approx(np.median(percents))
    assert own_row["Q1, %"] == pytest.approx(np.percentile(percents, 25))
    assert own_row["all trials, %"] == pytest.approx(np.mean(percents))
    assert own_row["published median, %"] == 67.9
    assert table(found, "conditions").rows[0][0] == "force_and_vibration"


def test_pairs_are_shown_next_to_the_papers(tapping: Path) -> None:
    found = analyze([tapping])
    ours, theirs = table(found, "pairs_vibration_only"), table(found, "published_pairs_vibration_only")
    assert ours.columns == theirs.columns == ("", *tables.MATERIALS)
    assert theirs.rows[6][1:] == (100, 80, 80, 60, 0, 60, 60)  # steel, from the paper's Table 2
    trials = 8 * 28
    percent = np.array([each[1:] for each in ours.rows], dtype=float)
    assert np.isfinite(percent).sum() == 28
    assert np.nanmean(percent) == pytest.approx(row(found, "conditions", "vibration_only")["all trials, %"])
    assert row(found, "conditions", "vibration_only")["trials"] == trials
    assert row(found, "rank_correlation", "vibration_only")["pairs"] == 28


def test_the_scale_has_the_order_of_the_materials(tapping: Path) -> None:
    found = analyze([tapping])
    own = [each for each in table(found, "bradley_terry").rows if each[0] == "vibration_only"]
    assert [each[1] for each in own] == [*tables.MATERIALS, "ties (v)"]
    strengths = [float(str(each[2])) for each in own[:-1]]
    assert strengths == sorted(strengths)


def test_measures_are_compared_in_the_papers_direction(tmp_path: Path) -> None:
    """The difference is with minus without vibration, although sessions begin without."""
    tables.puncture(tmp_path, PEOPLE)
    found = analyze([tmp_path])
    own = row(found, "comparisons", "overtravel_m")
    assert own["comparison"] == "with_vibration less without_vibration"
    assert own["unit"] == "m"
    assert own["published difference"] == pytest.approx(-0.000161)
    low, high = own["low 95 %"], own["high 95 %"]
    assert isinstance(low, float) and isinstance(high, float)
    assert low < -1e-3 < high < 0
    assert row(found, "comparisons", "peak_force_n")["published difference"] is None


def test_a_threshold_is_found(tmp_path: Path) -> None:
    tables.frequency(tmp_path, PEOPLE[:2])
    found = analyze([tmp_path])
    own = row(found, "psychometric", "all", "down", "pooled")
    low, high = own["low 95 %"], own["high 95 %"]
    assert isinstance(low, float) and isinstance(high, float)
    truth = 40 * math.log(2) ** (1 / 2.5)
    assert low < truth < high
    assert own["unit"] == "Hz"
    weber = next(each for each in table(found, "psychometric").rows if each[5] == "weber_fraction")
    assert weber[7] == pytest.approx(float(str(own["value"])) / 200)
    assert {each[2] for each in table(found, "psychometric").rows} == {"pooled", "P01", "P02"}


@pytest.mark.parametrize("harder", ["lower", "higher"])
def test_each_cell_has_a_threshold_of_its_own(harder: str, tmp_path: Path) -> None:
    """Two procedures of one variable are fitted together, cells of a factor are not. The chance level is that of the
    method, as the study has none."""
    tables.staircases(tmp_path, PEOPLE[:1], {"0.005": 30.0, "0.02": 60.0}, harder)
    found = analyze([tmp_path])
    for cell, truth in (("0.005", 30.0), ("0.02", 60.0)):
        own = row(found, "psychometric", "all", cell, "far and near", "pooled")
        assert (own["trials"], own["unit"]) == (360, "N/m")
        low, high = own["low 95 %"], own["high 95 %"]
        assert isinstance(low, float) and isinstance(high, float)
        assert low < truth < high and high - low < 15
    assert found.notes == ()


def test_the_mean_of_the_reversals_is_that_by_hand(tmp_path: Path) -> None:
    """Levels 10, 8, 10, 8, 10, 8: the last four of five reversals are at 10, 8, 10 and 8. The answer to one trial at 8
    is missing: the staircase counted it as wrong."""
    variable = {"name": "force_n", "at": "scene.x", "reference": 0, "level": "added"}
    method = {"kind": "staircase", "rule": "1-up-1-down", "start": 10, "least": 0, "most": 20, "steps": [2]}
    parameters = {**method, "reversals": 5, "discard": 1}
    study = {
        "title": "t",
        "trial": {"type": "forced_choice", "procedures": {"down": {"variable": variable, "method": parameters}}},
    }
    answers = [(10, 1, "first"), (8, 0, "first"), (10, 1, "first"), (8, 0, "n/a"), (10, 1, "first"), (8, 0, "first")]
    rows = [
        {
            **{"condition": "all", "cell": "down", "procedure": "down"},
            "level": level,
            "correct": correct,
            "response": response,
        }
        for level, correct, response in answers
    ]
    tables.write_session(tmp_path, "P01", "t", study, rows)
    own = row(analyze([tmp_path]), "staircases", "all", "down", "P01")
    assert (own["trials"], own["reversals"], own["mean of reversals"], own["unit"]) == (6, 5, 9.0, "N")


def test_a_staircase_that_is_not_the_studys_has_a_note_and_no_mean(tmp_path: Path) -> None:
    variable = {"name": "force_n", "at": "scene.x", "reference": 0, "level": "added"}
    method = {"kind": "staircase", "rule": "1-up-1-down", "start": 16, "least": 0, "most": 20, "steps": [2]}
    procedures = {"down": {"variable": variable, "method": method}}
    study = {"title": "t", "trial": {"type": "forced_choice", "procedures": procedures}}
    answer = {"condition": "all", "cell": "down", "procedure": "down", "correct": 1, "response": "first"}
    tables.write_session(tmp_path, "P01", "t", study, [{**answer, "level": 10}, {**answer, "level": 8}])
    found = analyze([tmp_path])
    assert not any(each.name == "staircases" for each in found.tables)
    (note,) = (each for each in found.notes if each.startswith("mean of reversals"))
    assert note.endswith("_task-t_beh.tsv:2: the staircase of the study would not show this level next")


def test_sessions_without_tables_were_interrupted(tmp_path: Path) -> None:
    (tmp_path / "sub-P01" / "ses-01").mkdir(parents=True)
    (tmp_path / "sub-P01" / "ses-01" / "log.jsonl").touch()
    with pytest.raises(HapticdError, match="were interrupted before their tables were written; run"):
        analyze([tmp_path])


def test_a_threshold_that_the_answers_leave_open_is_a_note_and_no_figure(tmp_path: Path) -> None:
    tables.staircases(tmp_path, PEOPLE[:1], {"0.005": 300.0})
    found = analyze([tmp_path])
    assert not any(each.name == "psychometric" for each in found.tables)
    (note,) = found.notes
    assert re.fullmatch(
        "psychometric function, all, 0.005, far and near, pooled: "
        "(the threshold is above the highest level, 90 N/m: levels beyond it are needed|"
        "correct answers do not become more from 15 to 90 N/m: .*)",
        note,
    )
    assert "Psychometric function" in report.page(found)  # the answers are drawn


def test_an_analysis_of_a_session_that_ended_early_reports_what_is_missing(tmp_path: Path) -> None:
    tables.puncture(tmp_path, PEOPLE[:1])
    for file in tmp_path.rglob("*_beh.tsv"):
        lines = file.read_text().splitlines(keepends=True)
        file.write_text("".join([lines[0], *(line for line in lines if "without_vibration" in line)]))
    found = analyze([tmp_path])
    assert found.published is None
    assert "Compared with published results" not in report.page(found)
    assert found.notes == (
        "published results okamura1998.puncture: these sessions have no results yet to compare with them",
        "overtravel_m and peak_force_n, only in trials of without_vibration: a comparison needs two conditions",
    )


def test_information_of_known_confusions(tmp_path: Path) -> None:
    """A quarter of the answers is the next item: the transfer is log2 7 - H(1/4) bits."""
    tables.identification(tmp_path, PEOPLE[:4])
    found = analyze([tmp_path])
    expected = math.log2(7) + 0.25 * math.log2(0.25) + 0.75 * math.log2(0.75)
    assert row(found, "information", "all")["transfer, bits"] == pytest.approx(expected)
    assert row(found, "confusion_all", "wood")["acrylic"] == 8
    assert row(found, "cells", "all", "wood")["correct, %"] == 75


def test_ratings_count_each_participant_once(tmp_path: Path) -> None:
    tables.rating(tmp_path, PEOPLE[:3])
    own = row(analyze([tmp_path]), "ratings", "all", "steel")
    assert (own["median"], own["Q1"], own["Q3"], own["participants"]) == (40, 30, 50, 3)


def test_published_tables_are_the_papers() -> None:
    """Some cells are compared with the paper. The data file has tables in three forms."""
    found = published_results("okamura1998.tapping")
    force = found.matrices["force_and_vibration"]
    assert force.percent[6].tolist() == [87.5, 87.5, 75, 25, 37.5, 25, 50]
    assert np.isnan(force.percent[0, 1:]).all()
    texture = published_results("okamura1998.texture")
    assert texture.matrices["damping"].percent[3].tolist() == [100, 100, 37.5, 87.5]
    assert texture.matrices["damping"].items == ("0.0016", "0.0024", "0.0048", "0.0064")
    assert texture.quartiles["vibration"] == (90, 80, 100)
    assert published_results("okamura1998.puncture").difference == ("overtravel_m", -0.000161, 0.00104)


def test_tables_are_read_by_people() -> None:
    """A small p value is not shown as a number, and texts are aligned left."""
    found = ResultTable("t", "T", ("condition", "p of chance", "p (t)", "participants"), (("a", 3e-9, 0.25, 8),))
    assert found.text() == [("a", "< 0.0001", "0.25", "8")]
    assert found.of_text() == (True, False, False, False)
    assert found.csv().splitlines()[1] == "a,3e-09,0.25,8"


def test_words_of_the_tables_are_not_cut_at_a_narrow_terminal(tapping: Path) -> None:
    result = CliRunner().invoke(cli, ["experiment", "analyze", str(tapping)], env={"COLUMNS": "40"})
    assert result.exit_code == 0, result.output
    assert "force_and_vibration" in result.output
    assert "< 0.0001" in result.output
    for each in analyze([tapping]).tables:
        for head in each.columns:
            assert set(head.split()) <= set(result.output.split())


class _Page(HTMLParser):
    """Parser that finds the open elements and the texts of table cells."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.counts: dict[str, int] = {}

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.counts[tag] = self.counts.get(tag, 0) + 1
        if tag not in ("meta", "br", "img"):
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.counts[tag] = self.counts.get(tag, 0) + 1

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.mark.slow
def test_the_page_has_all_tables_and_pictures(tapping: Path) -> None:
    found = analyze([tapping])
    page = _Page()
    text = report.page(found)
    page.feed(text)
    assert page.open == []
    assert page.counts["table"] == len(found.tables)
    assert page.counts["svg"] == sum(len(section.pictures) for section in found.sections)
    assert "okamura1998.tapping" in text
    assert not re.search(r'(src|href)="https?:', text)
    assert text == report.page(found)


@pytest.mark.slow
def test_the_command(tapping: Path, tmp_path: Path) -> None:
    runner = CliRunner()
    page, folder = tmp_path / "report.html", tmp_path / "csv"
    folder.mkdir()
    arguments = ["experiment", "analyze", str(tapping), "-o", str(page), "--csv", str(folder)]
    result = runner.invoke(cli, arguments)
    assert result.exit_code == 0, result.output
    assert "Correct answers over participants" in result.output
    assert page.read_text().startswith("<!DOCTYPE html>")
    with (folder / "pairs_vibration_only.csv").open() as lines:
        assert len(list(csv.reader(lines))) == 8
    again = runner.invoke(cli, arguments)
    assert isinstance(again.exception, HapticdError)
    assert "already exists" in str(again.exception)
    as_json = json.loads(runner.invoke(cli, ["experiment", "analyze", str(tapping), "--json"]).output)
    assert set(as_json["tables"]) == {each.name for each in analyze([tapping]).tables}


@pytest.mark.parametrize(
    "spoil, text",
    [
        (lambda file: file.unlink(), r"contains no \*_beh.tsv; give the folder"),
        (lambda file: file.write_text("a\tb\n"), r"_beh.tsv:1: not a table of answers: no column participant"),
        (lambda file: file.write_text(file.read_text() + "1\t2\n"), r"_beh.tsv:4: has 2 cells, must have 22"),
        (
            lambda file: file.write_text(file.read_text().replace("\t20\t", "\tmuch\t")),
            r":3: response must be a number",
        ),
        (lambda file: file.write_text(file.read_text().replace("\ttest\t", "\tpractice\t")), "nothing to analyze"),
        (lambda file: file.with_name("sub-P01_ses-01_task-x_beh.tsv").write_bytes(file.read_bytes()), "of 2 studies"),
    ],
)
def test_what_cannot_be_analyzed(tmp_path: Path, spoil: object, text: str) -> None:
    tables.rating(tmp_path, PEOPLE[:1])
    assert callable(spoil)
    spoil(next(tmp_path.rglob("*_beh.tsv")))
    with pytest.raises(HapticdError, match=text) as caught:
        analyze([tmp_path])
    assert "\n" not in str(caught.value)


def test_a_folder_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(HapticdError, match="no such folder"):
        analyze([tmp_path / "nowhere"])
