"""Many simulated participants: the same sessions as one after the other, with any workers, and resumable."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from click.testing import CliRunner, Result

from hapticd.base.errors import HapticdError
from hapticd.cli import cli, main
from hapticd.experiment.session_folder import numbered
from hapticd.experiment.session_log import read_log
from hapticd.experiment.study import study_of
from hapticd.sweeps.participants import bulk
from hapticd.sweeps.participants.bulk import Participants
from hapticd.sweeps.participants.one_session import records_of, session_values
from tests.experiment.sessions import STUDY

LABELS = numbered("simA", 3)


def study_file(tmp_path: Path) -> str:
    file = tmp_path / "study.yaml"
    file.write_text(yaml.safe_dump(STUDY))
    return str(file)


def ran(*words: str) -> Result:
    return CliRunner().invoke(cli, ["experiment", "run", *words])


def without_clock(log: Path) -> list[Any]:
    first, *others = read_log(log).records
    assert first.pop("clock")
    return [first, *others]


@pytest.mark.slow
def test_participants_in_bulk_equal_single_ones(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = study_file(tmp_path)
    many, alone = tmp_path / "many", tmp_path / "alone"
    result = ran(file, "--offline", "--participant", "simulated:A", "--count", "2", "--threads", "-o", str(many))
    assert result.exit_code == 0, result.output
    assert "2 participants: 2 computed" in result.output and "2 sessions written, 0 already existed" in result.output
    for label in LABELS[:2]:
        name = label.removeprefix("sim")
        assert ran(file, "--offline", "--participant", f"simulated:{name}", "-o", str(alone)).exit_code == 0
        here, there = (root / f"sub-{label}" / "ses-01" for root in (many, alone))
        assert without_clock(here / "log.jsonl") == without_clock(there / "log.jsonl")
        for path in ("study.yaml", "plan.json", *(each.relative_to(there) for each in (there / "beh").iterdir())):
            assert (here / path).read_bytes() == (there / path).read_bytes(), path
    for path in ("README", ".bidsignore", "participants.tsv", "dataset_description.json"):
        assert (many / path).read_bytes() == (alone / path).read_bytes(), path
    rows = many / "sourcedata" / "simulated"
    assert main(["sweep", "show", str(rows)]) == 1
    message = "holds sessions of simulated participants; use: hapticd experiment analyze"
    assert capsys.readouterr().err == f"hapticd: {rows}: {message}\n"


@pytest.mark.slow
def test_rows_are_the_same_bits_from_threads_and_from_processes_and_more_are_only_added(tmp_path: Path) -> None:
    file = study_file(tmp_path)
    digests = []
    for name, options in (("threads", ["--threads"]), ("processes", ["--workers", "2"])):
        words = ["--offline", "--participant", "simulated:A", "--count", "3", *options, "-o", str(tmp_path / name)]
        result = ran(file, *words)
        assert result.exit_code == 0, result.output
        digests.append(result.stdout.rpartition("sha256 ")[2])
    assert digests[0] == digests[1]
    words = ["--offline", "--participant", "simulated:A", "--count", "5", "--threads", "-o", str(tmp_path / "threads")]
    result = ran(file, *words)
    assert "5 participants: 2 computed" in result.stdout and "3 already existed" in result.stdout
    assert "2 sessions written, 3 already existed" in result.stdout
    people = (tmp_path / "threads" / "participants.tsv").read_text().split()
    assert people == ["participant_id", *(f"sub-{label}" for label in numbered("simA", 5))]
    assert CliRunner().invoke(cli, ["experiment", "analyze", str(tmp_path / "threads")]).exit_code == 0


@pytest.mark.long
def test_an_incomplete_session_folder_is_written_again_from_the_row(tmp_path: Path) -> None:
    file, root = study_file(tmp_path), tmp_path / "data"
    words = ["--offline", "--participant", "simulated:A", "--count", "2", "--threads", "-o", str(root)]
    assert ran(file, *words).exit_code == 0
    session = root / f"sub-{LABELS[0]}" / "ses-01"
    (events,) = (session / "beh").glob("*_events.json")
    expected = events.read_bytes()
    events.unlink()
    other = root / f"sub-{LABELS[1]}" / "ses-01" / "log.jsonl"
    other.unlink()
    result = ran(file, *words)
    assert result.exit_code == 0 and "0 computed" in result.stdout and "2 sessions written" in result.stdout
    assert events.read_bytes() == expected and other.exists()


@pytest.mark.long
def test_a_session_folder_that_may_not_be_on_disk_is_written_again(tmp_path: Path) -> None:
    """After a power failure files may be empty, and the list of folders on disk lacks them."""
    file, root = study_file(tmp_path), tmp_path / "data"
    words = ["--offline", "--participant", "simulated:A", "--count", "2", "--threads", "-o", str(root)]
    assert ran(file, *words).exit_code == 0
    known = root / "sourcedata" / "simulated" / "written.txt"
    first, _ = Participants(study_of(STUDY), 1, 1, LABELS[:2]).points.values()
    known.write_text(f"{first}\n")
    log = root / f"sub-{LABELS[1]}" / "ses-01" / "log.jsonl"
    expected = without_clock(log)
    log.write_bytes(b"")
    result = ran(file, *words)
    assert result.exit_code == 0 and "1 session written, 1 already existed" in result.stdout
    assert without_clock(log) == expected and len(known.read_text().split()) == 2


@pytest.mark.long
def test_a_session_of_another_study_is_refused_before_anything_is_computed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, root = study_file(tmp_path), tmp_path / "data"
    assert ran(file, "--offline", "--participant", "simulated:A000002", "-o", str(root)).exit_code == 0
    words = ["--offline", "--participant", "simulated:A", "--count", "3", "--threads", "-o", str(root)]
    assert main(["experiment", "run", file, *words]) == 1
    error = capsys.readouterr().err
    assert len(error.splitlines()) == 1
    assert f"sub-{LABELS[1]}/ses-01: belongs to another study, seed or version" in error
    assert not (root / "sourcedata").exists()


@pytest.mark.parametrize(
    ("change", "same"),
    [({}, True), ({"seed": 2}, False), ({"session": 2}, False), ({"study": {"title": "Other"}}, False)],
)
def test_the_identity_of_a_participant_has_all_that_the_session_depends_on(change: dict[str, Any], same: bool) -> None:
    given: dict[str, Any] = {"session": 1, "seed": 1, "study": {}, **change}
    first = Participants(study_of(STUDY), 1, 1, LABELS)
    other = Participants(study_of({**STUDY, **given.pop("study")}), labels=LABELS, **given)
    assert len(set(first.ids.tolist())) == len(LABELS)
    assert (first.ids.tolist() == other.ids.tolist()) is same
    assert bool(set(first.ids.tolist()) & set(other.ids.tolist())) is same
    assert Participants(study_of(STUDY), 1, 1, LABELS[1:]).ids.tolist() == first.ids.tolist()[1:]


@pytest.mark.long
def test_a_row_counts_the_answers_in_its_log() -> None:
    row = session_values(study_of(STUDY), LABELS[0], 1, 1)
    records = records_of(row)
    answers = [each for each in records if each["kind"] == "answer"]
    assert row["answered"] == len(answers) > 0 and records[0]["kind"] == "session_started"
    assert "clock" not in records[0] and records[-1]["at_s"] == row["duration_s"]
    # A stimulus that is compared with itself has no correct answer.
    right = [each["correct"] for each in answers if each["correct"] is not None]
    assert row["correct"] == np.mean(np.array(right, float))
    assert row == session_values(study_of(STUDY), LABELS[0], 1, 1) != session_values(study_of(STUDY), LABELS[1], 1, 1)


def test_a_participant_that_cannot_be_simulated_is_a_row_with_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(study: object, label: str, session: int, seed: int) -> Any:
        if label == LABELS[1]:
            raise HapticdError("no hand\nfor this")
        return {"trials": 1, "answered": 1, "correct": None, "duration_s": 1.0, "log": "[]"}

    monkeypatch.setattr(bulk, "session_values", fails)
    rows = Participants(study_of(STUDY), 1, 1, LABELS).piece(np.arange(3)).rows()
    assert [row["error"] for row in rows] == [None, "no hand for this", None]
    assert rows[1]["log"] is None and all(list(row) == list(rows[0]) for row in rows)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--participant", "simulated:A", "--count", "3"], "need --offline and simulated participants"),
        (["--participant", "simulated:A", "--workers", "2"], "need --offline and simulated participants"),
        (["--participant", "P01", "--offline", "--count", "3"], "--offline needs a simulated participant"),
        (
            ["--participant", "simulated:A", "--offline", "--count", "3", "--telemetry"],
            "--telemetry cannot be combined",
        ),
        (
            ["--participant", "simulated:A", "--participant", "simulated:B", "--offline", "--count", "3"],
            "--count needs a single",
        ),
        (
            ["--participant", "simulated:A", "--offline", "--threads", "--scheduler", "tcp://127.0.0.1:1"],
            "--scheduler cannot be combined with --workers or --threads",
        ),
        (
            ["--participant", f"simulated:{'A' * 29}", "--offline", "--count", "3"],
            "must be 1 to 32 ASCII letters and digits",
        ),
    ],
)
def test_incompatible_options_are_refused(words: list[str], message: str, tmp_path: Path) -> None:
    result = ran(study_file(tmp_path), *words, "-o", str(tmp_path / "data"))
    assert result.exit_code != 0 and message in f"{result.output}{result.exception}"
    assert not (tmp_path / "data").exists()


@pytest.mark.long
def test_several_named_participants_are_computed_in_parallel(tmp_path: Path) -> None:
    people = ["--participant", "simulated:A", "--participant", "simulated:B"]
    result = ran(study_file(tmp_path), "--offline", *people, "--threads", "-o", str(tmp_path / "data"))
    assert result.exit_code == 0 and "2 sessions written" in result.stdout
    about = json.loads((tmp_path / "data" / "sub-simB" / "ses-01" / "session.json").read_text())
    assert about["participant"] == "simB" and about["stage"]["simulated"] is True
