"""Behaviour as tidy tables by the rules of BIDS 1.9: beh.tsv and events.tsv with their sidecars, made from the log.

The log is the truth: the tables are written whole, each time a session ends, and may be made again at any time. Cells
without a value are `n/a`. Files of a session that are not of BIDS are named in `.bidsignore`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, cast

from hapticd._version import __version__
from hapticd.base.errors import HapticdError, on_one_line
from hapticd.base.files import write_whole
from hapticd.base.yaml_source import Json
from hapticd.experiment.measures import MEASURES
from hapticd.experiment.session_folder import STUDY, SessionFolder, participant_label
from hapticd.experiment.session_log import Record

BIDS_VERSION: Final = "1.9.0"
_IGNORED: Final = ("study.yaml", "plan.json", "session.json", "log.jsonl", "*.npz")
_README: Final = """\
Sessions of `hapticd experiment`, a folder for each participant and session.

`beh/` has the behaviour: one row a trial in `*_beh.tsv`, and in `*_events.tsv` what happened, by its onset. The JSON
file beside each table describes its columns. The tables are made of `log.jsonl`, which holds each record with a
checksum.
`study.yaml` is the study as it was read, `plan.json` every trial in its order, `session.json` participant, session,
seed, versions and device. A `.npz` file is the telemetry of a trial. `hapticd experiment analyze` makes statistics and
a report.
"""
TASK_IN_FILE_NAME: Final = re.compile(r"_task-([^_]+)_beh\.tsv$")
"""The study's label in the name of a table of answers."""
_FIXED: Final = (
    "onset", "duration", "participant", "session", "phase", "block", "trial", "condition", "cell", "repetition",
    "attempt", "question", "response", "correct", "response_time", "procedure", "level",
)  # fmt: skip

Row = dict[str, Json]

_COLUMNS: Final[dict[str, dict[str, Json]]] = {
    "onset": {"Description": "Onset of the trial: its forces came on, on the session's clock", "Units": "s"},
    "duration": {"Description": "From the onset to the answer", "Units": "s"},
    "participant": {"Description": "Label of the participant"},
    "session": {"Description": "Number of the session"},
    "phase": {"Description": "Part of the session", "Levels": {
        "practice": "To get used to it", "training": "To learn the answers", "test": "What counts"}},
    "block": {"Description": "Number of the block"},
    "trial": {"Description": "Index of the trial in the plan, from 0"},
    "condition": {"Description": "Name of the condition"},
    "cell": {"Description": "Name of the cell of the design"},
    "repetition": {"Description": "How often this cell came before, plus one"},
    "attempt": {"Description": "Number of the attempt that was answered, from 1"},
    "question": {"Description": "Name of the question"},
    "response": {"Description": "Name of the answer, number, text, order or measure; n/a: time was up"},
    "correct": {"Description": "Whether the answer was the correct one", "Levels": {"0": "No", "1": "Yes"}},
    "response_time": {"Description": "From the last interval's onset to the answer", "Units": "s"},
    "procedure": {"Description": "Name of the adaptive procedure"},
    "level": {"Description": "Level that the procedure asked for"},
    "overtravel_m": {"Description": "How far past the place of its rupture the hand went", "Units": "m"},
    "peak_force_n": {"Description": "Largest magnitude of the commanded force", "Units": "N"},
    "completion_s": {"Description": "From the first to the last sample with the forces on", "Units": "s"},
    "path_m": {"Description": "Length of the way that the handle went", "Units": "m"},
}  # fmt: skip


def rows_of(folder: SessionFolder) -> list[Row]:
    """The answered trials of a session, tidy: one row a trial, in the order of their answers. Raises HapticdError.

    Beside the fixed columns there are `stimulus_1`, ..., `FACTOR_1`, ... for each place or interval, and a column a
    measure. None stands for what a trial does not have.
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
    names = _in_order({name for row in rows for name in row})
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


def _in_order(names: set[str]) -> list[str]:
    """The fixed columns, then those of the stimuli, then the measures."""
    others = sorted(names - set(_FIXED) - set(MEASURES), key=_numbered)
    return [*_FIXED, *others, *(name for name in MEASURES if name in names)]


def _numbered(name: str) -> tuple[str, int]:
    stem, _, number = name.rpartition("_")
    return stem, int(number)


def event_rows_of(folder: SessionFolder) -> list[Row]:
    """What happened in a session, by its onset: trials, answers, breaks, pauses and notes."""
    rows: list[Row] = []
    for record in folder.contents().records:
        if "at_s" in record:
            row: Row = {"onset": record["at_s"], "duration": 0.0, "trial_type": record["kind"]}
            row["trial"] = record.get("trial")
            row["value"] = record.get("answer", record.get("text", record.get("because")))
            rows.append(row)
    return rows


def write_tables(folder: SessionFolder) -> list[Path]:
    """Writes the tables of a session and what the data set needs; the files. Raises HapticdError."""
    return [*write_session_tables(folder), *write_data_set(folder.root, str(folder.about["title"]))]


def write_session_tables(folder: SessionFolder, synced: bool = True) -> list[Path]:
    """Writes the tables of a session, `*_events.json` last; the files. `synced`: they are on disk then. Raises
    HapticdError."""
    label = participant_label(folder.participant)
    stem = f"sub-{label}_ses-{folder.session:02d}_task-{task_label(str(folder.about['title']))}"
    beh = folder.path / "beh"
    rows, events = rows_of(folder), event_rows_of(folder)
    columns = list(rows[0]) if rows else list(_FIXED)
    task = _task(folder)
    files: dict[Path, str] = {
        beh / f"{stem}_beh.tsv": table(columns, rows),
        beh / f"{stem}_beh.json": _json({**task, **{name: _described(name) for name in columns}}),
        beh / f"{stem}_events.tsv": table(["onset", "duration", "trial_type", "trial", "value"], events),
        beh / f"{stem}_events.json": _json({**task, **_EVENT_COLUMNS}),
    }
    return _written(files, synced)


def write_data_set(root: Path, title: str) -> list[Path]:
    """Writes what a data set says of itself and of all its participants; the files. Raises HapticdError."""
    files: dict[Path, str] = {
        root / ".bidsignore": "\n".join(_IGNORED) + "\n",
        root / "README": _README,
        root / "participants.tsv": "participant_id\n" + "".join(f"{name}\n" for name in _participants(root)),
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
            raise HapticdError(f"{path.parent}: cannot be made: {error.strerror}") from None
        write_whole(str(path), text, overwrite=True, synced=synced)
    return list(files)


def _task(folder: SessionFolder) -> dict[str, Json]:
    """What BIDS asks of a task: what the participant was told and asked, and what presented the stimuli."""
    study = cast("dict[str, Any]", folder.plan["study"])
    question = study["questions"][study["trial"]["question"]]
    return {
        "TaskName": folder.about["title"],
        "TaskDescription": question["text"],
        "Instructions": study["instructions"],
        "StimulusPresentation": {
            "SoftwareName": "hapticd",
            "SoftwareVersion": folder.about["version"],
        },
    }


def check_one_study(root: Path, title: str) -> None:
    """Raises HapticdError where a data set has tables of a study with another title."""
    label = task_label(title)
    tables = root.glob("sub-*/ses-*/beh/*_beh.tsv")
    other = next(
        (found[1] for each in tables if (found := TASK_IN_FILE_NAME.search(each.name)) and found[1] != label), None
    )
    if other is not None:
        raise HapticdError(
            f"{root}: has sessions of another study, {other}; give each study a folder of its own with -o"
        )


def other_version(root: Path, source: bytes) -> Path | None:
    """A session of the data set whose study is written otherwise than `source`; None: all are the same."""
    studies = root.glob(f"sub-*/ses-*/{STUDY}")
    return next((each.parent for each in studies if each.is_file() and each.read_bytes() != source), None)


def table(columns: Sequence[str], rows: Sequence[Mapping[str, Json]]) -> str:
    """A TSV with a line of names, and `n/a` where there is nothing."""
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
            # A tab or the end of a line would be another cell.
            return on_one_line(str(value))


def task_label(title: str) -> str:
    """A title as BIDS allows it in names of files: letters and digits."""
    words = re.findall("[A-Za-z0-9]+", title)
    return "".join(word[0].upper() + word[1:] for word in words)[:40] or "Task"


def _participants(root: Path) -> list[str]:
    return sorted(each.name for each in root.glob("sub-*") if each.is_dir())


def _described(name: str) -> dict[str, Json]:
    if name in _COLUMNS:
        return _COLUMNS[name]
    stem, _, number = name.rpartition("_")
    what = "Levels of the stimulus" if stem == "stimulus" else f"Level of {stem} of the stimulus"
    return {"Description": f"{what} at place or in interval {number}"}


def _json(value: Mapping[str, Json]) -> str:
    return json.dumps(value, ensure_ascii=False, indent=2) + "\n"


_EVENT_COLUMNS: Final[dict[str, Json]] = {
    "onset": {"Description": "On the session's clock", "Units": "s"},
    "duration": {"Description": "0: events have no duration", "Units": "s"},
    "trial_type": {"Description": "Kind of the record in log.jsonl"},
    "trial": {"Description": "Index of the trial in the plan, from 0"},
    "value": {"Description": "The answer, the note, or why it happened"},
}
