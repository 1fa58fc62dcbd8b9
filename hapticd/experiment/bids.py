"""Tables of answers and events as BIDS 1.9 prescribes: beh.tsv and events.tsv, each with a JSON file on its columns.

Every table is rewritten from the log each time a session ends. Cells without a value are `n/a`. `.bidsignore` lists the
files of a session that BIDS does not know.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, cast

from hapticd._version import __version__
from hapticd.base.errors import HapticdError, collapse_whitespace
from hapticd.base.files import write_atomically
from hapticd.base.yaml_source import Json
from hapticd.experiment.measures import MOTION_MEASURES
from hapticd.experiment.session_folder import (
    LOG_FILE_NAME,
    PLAN_FILE_NAME,
    SESSION_FILE_NAME,
    STUDY_FILE_NAME,
    SessionFolder,
    participant_label,
)
from hapticd.experiment.session_log import Record

BIDS_VERSION: Final = "1.9.0"
"""Version of the Brain Imaging Data Structure that the tables follow."""
_BIDSIGNORE_PATTERNS: Final = (STUDY_FILE_NAME, PLAN_FILE_NAME, SESSION_FILE_NAME, LOG_FILE_NAME, "*.npz")
"""Files of a session that BIDS does not know, for .bidsignore."""
_README_TEXT: Final = """\
Sessions of `hapticd experiment`, a folder for each participant and session.

`beh/` has the behaviour: `*_beh.tsv` has one row per trial, `*_events.tsv` one row per event with its onset. The JSON
file next to each table describes its columns. The tables are made from `log.jsonl`, which holds each record with a
checksum.
`study.yaml` is the study as it was read. `plan.json` lists the trials in order. `session.json` has participant,
session, seed, versions and device. A `.npz` file is the telemetry of a trial. `hapticd experiment analyze` makes
statistics and a report.
"""
TASK_IN_FILE_NAME: Final = re.compile(r"_task-([^_]+)_beh\.tsv$")
"""Finds the label of the study (its task, in BIDS) in the file name of a table of answers."""
_FIXED_COLUMNS: Final = (
    "onset", "duration", "participant", "session", "phase", "block", "trial", "condition", "cell", "repetition",
    "attempt", "question", "response", "correct", "response_time", "procedure", "level",
)  # fmt: skip
"""Columns that every table of answers has, in this order."""

Row = dict[str, Json]
"""A row of a table, a trial or an event: its cells by column, None for a missing value."""

_COLUMN_DESCRIPTIONS: Final[dict[str, dict[str, Json]]] = {
    "onset": {"Description": "When the forces of the trial were switched on, on the session's clock", "Units": "s"},
    "duration": {"Description": "Time from the onset to the answer", "Units": "s"},
    "participant": {"Description": "Label of the participant"},
    "session": {"Description": "Number of the session"},
    "phase": {"Description": "Part of the session", "Levels": {
        "practice": "Practice of the task", "training": "Learning of the answers", "test": "Test"}},
    "block": {"Description": "Number of the block"},
    "trial": {"Description": "Index of the trial in the plan, from 0"},
    "condition": {"Description": "Name of the condition"},
    "cell": {"Description": "Name of the cell of the design"},
    "repetition": {"Description": "Which presentation of this cell it is, from 1"},
    "attempt": {"Description": "Number of the attempt that was answered, from 1"},
    "question": {"Description": "Name of the question"},
    "response": {"Description": "Name of the answer, number, text, order or measure; n/a: the time limit passed"},
    "correct": {"Description": "Whether the answer was the correct one", "Levels": {"0": "No", "1": "Yes"}},
    "response_time": {"Description": "From the last interval's onset to the answer", "Units": "s"},
    "procedure": {"Description": "Name of the adaptive procedure"},
    "level": {"Description": "Level that the procedure asked for"},
    "overtravel_m": {"Description": "How far the hand moved beyond the place of the rupture", "Units": "m"},
    "peak_force_n": {"Description": "Largest magnitude of the commanded force", "Units": "N"},
    "completion_s": {"Description": "From the first to the last sample with the forces on", "Units": "s"},
    "path_m": {"Description": "Length of the path of the handle", "Units": "m"},
}  # fmt: skip


def rows_of(folder: SessionFolder) -> list[Row]:
    """Return the answered trials of a session, one row per trial, in the order of the answers.

    Besides the fixed columns there are `stimulus_1`, ..., `FACTOR_1`, ... for each place or interval, and a column for
    each measure. Raises HapticdError if the session cannot be read.
    """
    planned = {each["index"]: each for each in cast("list[dict[str, Any]]", folder.plan["trials"])}
    started: dict[tuple[Json, Json], Record] = {}
    rows: list[Row] = []
    for record in folder.contents().records:
        if record["kind"] == "trial_started":
            started[record["trial"], record["attempt"]] = record
        elif record["kind"] == "answer":
            shown = cast("list[dict[str, Any]]", started[record["trial"], record["attempt"]]["stimuli"])
            rows.append(_row(folder, planned[record["trial"]], record, shown))
    found = {name for row in rows for name in row}
    of_stimuli = sorted(found - set(_FIXED_COLUMNS) - set(MOTION_MEASURES), key=_numbered)
    names = [*_FIXED_COLUMNS, *of_stimuli, *(name for name in MOTION_MEASURES if name in found)]
    return [{name: row.get(name) for name in names} for row in rows]


def _row(folder: SessionFolder, trial: Mapping[str, Any], answer: Record, stimuli: Sequence[Mapping[str, Any]]) -> Row:
    row: Row = {
        "onset": answer["onset_s"],
        "duration": answer["duration_s"],
        "participant": folder.participant,
        "session": folder.session,
        **{name: trial[name] for name in ("phase", "block", "condition", "cell", "repetition", "question")},
        **{name: answer[name] for name in ("trial", "attempt", "correct", "procedure", "level")},
        "response": answer["answer"],
        "response_time": answer["response_time_s"],
    }
    for number, stimulus in enumerate(stimuli, 1):
        row[f"stimulus_{number}"] = stimulus["name"]
        for factor, level in stimulus["levels"].items():
            row[f"{factor}_{number}"] = level
    return row | cast("dict[str, Json]", answer["measures"])


def _numbered(name: str) -> tuple[str, int]:
    stem, _, number = name.rpartition("_")
    return stem, int(number)


def event_rows_of(folder: SessionFolder) -> list[Row]:
    """Return the events of a session (trials, answers, breaks, pauses, notes), one row per event with its onset."""
    rows: list[Row] = []
    for record in folder.contents().records:
        if "at_s" in record:
            row: Row = {"onset": record["at_s"], "duration": 0.0, "trial_type": record["kind"]}
            row["trial"] = record.get("trial")
            row["value"] = record.get("answer", record.get("text", record.get("because")))
            rows.append(row)
    return rows


def write_tables(folder: SessionFolder) -> list[Path]:
    """Write the tables of a session and the files of its data set, and return the files.

    Raises HapticdError if a file cannot be written.
    """
    return [*write_session_tables(folder), *write_data_set(folder.root, str(folder.about["title"]))]


def write_session_tables(folder: SessionFolder, synced: bool = True) -> list[Path]:
    """Write the tables of a session, `*_events.json` last, and return the files.

    With `synced` the files are on disk (fsync) on return. Raises HapticdError if a file cannot be written.
    """
    label = participant_label(folder.participant)
    stem = f"sub-{label}_ses-{folder.session:02d}_task-{task_label(str(folder.about['title']))}"
    beh = folder.path / "beh"
    rows, events = rows_of(folder), event_rows_of(folder)
    columns = list(rows[0]) if rows else list(_FIXED_COLUMNS)
    task = _task(folder)
    files: dict[Path, str] = {
        beh / f"{stem}_beh.tsv": table(columns, rows),
        beh / f"{stem}_beh.json": _json({**task, **{name: _described(name) for name in columns}}),
        beh / f"{stem}_events.tsv": table(["onset", "duration", "trial_type", "trial", "value"], events),
        beh / f"{stem}_events.json": _json({**task, **_EVENT_COLUMN_DESCRIPTIONS}),
    }
    return _written(files, synced)


def write_data_set(root: Path, title: str) -> list[Path]:
    """Write the description of a data set and the list of its participants, and return the files.

    Raises HapticdError if a file cannot be written.
    """
    participants = sorted(each.name for each in root.glob("sub-*") if each.is_dir())
    files: dict[Path, str] = {
        root / ".bidsignore": "\n".join(_BIDSIGNORE_PATTERNS) + "\n",
        root / "README": _README_TEXT,
        root / "participants.tsv": "participant_id\n" + "".join(f"{name}\n" for name in participants),
        root / "dataset_description.json": _json({
            "Name": title,
            "BIDSVersion": BIDS_VERSION,
            "DatasetType": "raw",
            "GeneratedBy": [{"Name": "hapticd", "Version": __version__}],
        }),
    }  # fmt: skip
    return _written(files)


def _written(files: Mapping[Path, str], synced: bool = True) -> list[Path]:
    for path, text in files.items():
        try:
            path.parent.mkdir(exist_ok=True)
        except OSError as error:
            raise HapticdError(f"{path.parent}: cannot be created: {error.strerror}") from None
        write_atomically(str(path), text, overwrite=True, synced=synced)
    return list(files)


def _task(folder: SessionFolder) -> dict[str, Json]:
    """Return BIDS's description of a study (task): instructions, question, and the software that presented stimuli."""
    study = cast("dict[str, Any]", folder.plan["study"])
    question = study["questions"][study["trial"]["question"]]
    return {
        "TaskName": folder.about["title"],
        "TaskDescription": question["text"],
        "Instructions": study["instructions"],
        "StimulusPresentation": {"SoftwareName": "hapticd", "SoftwareVersion": folder.about["version"]},
    }


def check_one_study(root: Path, title: str) -> None:
    """Raise HapticdError if a data set has tables of a study with another title."""
    label = task_label(title)
    tables = root.glob("sub-*/ses-*/beh/*_beh.tsv")
    other = next(
        (found[1] for each in tables if (found := TASK_IN_FILE_NAME.search(each.name)) and found[1] != label), None
    )
    if other is not None:
        raise HapticdError(
            f"{root}: contains sessions of another study, {other}; give each study a separate folder with -o"
        )


def other_version(root: Path, source: bytes) -> Path | None:
    """Return the folder of a session in a data set whose study.yaml differs from `source`, or None."""
    studies = root.glob(f"sub-*/ses-*/{STUDY_FILE_NAME}")
    return next((each.parent for each in studies if each.is_file() and each.read_bytes() != source), None)


def table(columns: Sequence[str], rows: Sequence[Mapping[str, Json]]) -> str:
    """Return a table as TSV (tab-separated values), after a line of column names. A missing value is `n/a`."""
    lines = ["\t".join(columns)]
    lines += ["\t".join(_cell(row.get(name)) for name in columns) for row in rows]
    return "\n".join(lines) + "\n"


def _cell(value: Json) -> str:
    match value:
        case None | "":
            return "n/a"
        case bool():
            return "true" if value else "false"
        case float():
            return format(value, ".9g")
        case _:
            # A tab or a line break would begin another cell.
            return collapse_whitespace(str(value))


def task_label(title: str) -> str:
    """Return the label of a study in file names, made from its title: at most 40 letters and digits, as BIDS asks."""
    words = re.findall("[A-Za-z0-9]+", title)
    return "".join(word[0].upper() + word[1:] for word in words)[:40] or "Task"


def _described(name: str) -> dict[str, Json]:
    if name in _COLUMN_DESCRIPTIONS:
        return _COLUMN_DESCRIPTIONS[name]
    stem, _, number = name.rpartition("_")
    what = "Levels of the stimulus" if stem == "stimulus" else f"Level of {stem} of the stimulus"
    return {"Description": f"{what} at place or in interval {number}"}


def _json(value: Mapping[str, Json]) -> str:
    return json.dumps(value, ensure_ascii=False, indent=2) + "\n"


_EVENT_COLUMN_DESCRIPTIONS: Final[dict[str, Json]] = {
    "onset": {"Description": "Time on the session's clock", "Units": "s"},
    "duration": {"Description": "0: events have no duration", "Units": "s"},
    "trial_type": {"Description": "Kind of the record in log.jsonl"},
    "trial": {"Description": "Index of the trial in the plan, from 0"},
    "value": {"Description": "The answer, the note, or the reason of the event"},
}
