"""The tables of a session, compared with the rules of BIDS."""

from __future__ import annotations

import csv
import json
import re
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner

from hapticd.base.errors import HapticdError
from hapticd.cli import cli
from hapticd.experiment.bids import rows_of, table, task_label, write_tables
from hapticd.experiment.front import Command, Shown
from hapticd.experiment.session_folder import SessionFolder, folder_of
from tests.experiment.bids_validator import issues_of
from tests.experiment.sessions import STAIRCASE, STUDY, NotedStage, ScriptedFront, planned, started

SESSION = Path("sub-P07/ses-01")
STEM = "sub-P07_ses-01_task-WhichIsStiffer"


def _level(shown: Shown) -> str:
    return shown.answers[shown.number % 2].name


@pytest.fixture
def data_set(tmp_path: Path) -> Path:
    """Return a data set of one session, with a note."""
    front = ScriptedFront()
    front.commands = {"ready": [Command("note", "a\tnote")]}
    started(tmp_path, NotedStage(), front).run()
    write_tables(SessionFolder.open(tmp_path / SESSION))
    return tmp_path


def _read(path: Path) -> list[dict[str, str]]:
    with open(path, encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file, delimiter="\t", quoting=csv.QUOTE_NONE))


def test_a_row_a_trial_with_what_was_shown_and_answered(data_set: Path) -> None:
    rows = _read(data_set / SESSION / "beh" / f"{STEM}_beh.tsv")
    plan = planned()
    assert [int(row["trial"]) for row in rows] == [trial.index for trial in plan.trials]
    for row, trial in zip(rows, plan.trials, strict=True):
        assert (row["participant"], row["session"], row["phase"]) == ("P07", "1", "test")
        assert [row["stimulus_1"], row["stimulus_2"]] == [each.name for each in trial.stimuli]
        assert [row["material_1"], row["material_2"]] == [each.levels["material"] for each in trial.stimuli]
        assert (row["cell"], row["condition"], row["question"]) == (trial.cell, trial.condition, "stiffer")
        assert (row["response"], row["correct"]) == ("first", str(int(trial.correct == "first")))
        assert (row["procedure"], row["level"]) == ("n/a", "n/a")
        assert float(row["response_time"]) <= float(row["duration"])
    assert [float(row["onset"]) for row in rows] == sorted(float(row["onset"]) for row in rows)


def test_an_adaptive_trial_has_its_level(tmp_path: Path) -> None:
    started(tmp_path, NotedStage(), ScriptedFront(_level), STAIRCASE).run()
    rows = rows_of(SessionFolder.open(tmp_path / SESSION))
    assert rows[0]["level"] == 100.0
    assert {row["procedure"] for row in rows} != {None}
    values = [sorted(float(str(row[f"frequency_hz_{place}"])) for place in (1, 2)) for row in rows]
    assert values == [[200.0, 200.0 + float(str(row["level"]))] for row in rows]


def test_files_are_where_bids_has_them_and_every_column_is_described(data_set: Path) -> None:
    names = {str(path.relative_to(data_set / SESSION)) for path in (data_set / SESSION / "beh").iterdir()}
    endings = ("beh.tsv", "beh.json", "events.tsv", "events.json")
    assert names == {f"beh/{STEM}_{ending}" for ending in endings}
    for kind in ("beh", "events"):
        table_file = data_set / SESSION / "beh" / f"{STEM}_{kind}.tsv"
        columns = table_file.read_text().splitlines()[0].split("\t")
        described = json.loads(table_file.with_suffix(".json").read_text())
        assert set(columns) <= set(described)
        assert described["TaskName"] == STUDY["title"]
        for name in columns:
            assert described[name]["Description"]
        for line in table_file.read_text().splitlines():
            cells = line.split("\t")
            assert len(cells) == len(columns)
            assert all(cells), "an empty cell is n/a"
    events = data_set / SESSION / "beh" / f"{STEM}_events.tsv"
    assert events.read_text().startswith("onset\tduration\t")
    assert [row["value"] for row in _read(events) if row["trial_type"] == "note"] == ["a note"]
    description = json.loads((data_set / "dataset_description.json").read_text())
    assert re.fullmatch(r"\d+\.\d+\.\d+", description["BIDSVersion"])
    assert description["Name"]
    assert _read(data_set / "participants.tsv") == [{"participant_id": "sub-P07"}]


def test_the_tables_are_made_of_the_log_alone(data_set: Path) -> None:
    beh = data_set / SESSION / "beh"
    before = {path.name: path.read_bytes() for path in beh.iterdir()}
    shutil.rmtree(beh)
    write_tables(SessionFolder.open(data_set / SESSION))
    assert {path.name: path.read_bytes() for path in beh.iterdir()} == before


def test_cells_and_labels_are_those_of_bids() -> None:
    rows = [{"a": None, "b": True, "c": 1 / 3}, {"a": "x\ty\nz", "b": "", "c": 2}]
    assert table(("a", "b", "c"), rows).splitlines()[1:] == ["n/a\ttrue\t0.333333333", "x y z\tn/a\t2"]
    assert task_label("Which of two, is härter?") == "WhichOfTwoIsHRter"
    for participant in ("P 7", "", "P-7", "../x", "ä"):
        with pytest.raises(HapticdError, match="must be 1 to 32 ASCII letters and digits"):
            folder_of(Path("."), participant, 1)
    for session in (0, 100):
        with pytest.raises(HapticdError, match="must be between 1 and 99"):
            folder_of(Path("."), "P07", session)


@pytest.mark.slow
def test_the_bids_validator_passes_it(tmp_path: Path) -> None:
    """The data set has two participants with telemetry, and a session of an adaptive study that was ended early. The
    validator does find a fault: a column that the JSON file lacks."""
    runner = CliRunner()
    people = ("--participant", "simulated:A", "--participant", "simulated:B")
    ran = runner.invoke(
        cli, ["experiment", "run", "okamura1998_puncture", *people, "--offline", "--telemetry", "-o", str(tmp_path)]
    )
    assert ran.exit_code == 0, ran.output
    front = ScriptedFront(_level)
    front.commands = {"explore": [Command("note", "a\tnote"), Command("abort")]}
    assert started(tmp_path, NotedStage(), front, STAIRCASE).run() == "aborted"
    write_tables(SessionFolder.open(tmp_path / SESSION))
    assert list(tmp_path.rglob("*.npz"))
    found = issues_of(tmp_path)
    assert [issue for issue in found if issue["severity"] == "error"] == []
    recommended = {issue["subCode"] for issue in found if issue["code"] == "SIDECAR_KEY_RECOMMENDED"}
    assert recommended <= {
        *("CogAtlasID", "CogPOID", "InstitutionName", "InstitutionAddress", "InstitutionalDepartmentName")
    }
    (tmp_path / "participants.tsv").write_text("participant\nsub-simA\n")
    (tmp_path / "notes.txt").write_text("no file of BIDS\n")
    faults = {issue["code"] for issue in issues_of(tmp_path) if issue["severity"] == "error"}
    assert "NOT_INCLUDED" in faults
