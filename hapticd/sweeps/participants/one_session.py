"""Runs the complete session of a simulated participant in memory, without files and without the time of day."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Final

from hapticd.base.errors import HapticdError
from hapticd.base.yaml_source import Json
from hapticd.experiment.keys import Study
from hapticd.experiment.offline_stage import OfflineStage
from hapticd.experiment.participants.simulated import SimulatedFront, task_of
from hapticd.experiment.plan import Plan, plan
from hapticd.experiment.runner import Session
from hapticd.experiment.session import procedure_of
from hapticd.experiment.session_folder import SessionFolder
from hapticd.experiment.session_log import LogInMemory, Record
from hapticd.experiment.stimuli import at_level
from hapticd.sweeps.columns import Column, Row

CLOCK_KEY: Final = "clock"
"""Key of the time of day in the first record of a log; rows omit this key."""
SESSION_COLUMNS: Final = (
    Column("trials", "integer", "measured", "", "Number of trials of the plan."),
    Column("answered", "integer", "measured", "", "Number of trials with an answer."),
    Column(
        "correct", "number", "measured", "", "Fraction of correct answers in the test; null if it has no right answers."
    ),
    Column("duration_s", "number", "measured", "s", "Duration of the session for the participant."),
    Column("log", "text", "measured", "", "The records of the session's log, as JSON."),
)
"""The measured columns in the row of a session."""


def session_values(study: Study, participant: str, session: int, seed: int) -> Row:
    """Run the session of a simulated participant and return the values of SESSION_COLUMNS. Raises HapticdError.

    Study, participant, session and seed determine these values bit for bit.
    """
    made = plan(study, participant, session, seed)
    records, duration_s = _run(made)
    answers = [each for each in records if each["kind"] == "answer"]
    right = [each["correct"] for each in answers if each["phase"] == "test" and isinstance(each["correct"], int)]
    return {
        "trials": len(made.trials),
        "answered": len(answers),
        "correct": sum(map(int, right)) / len(right) if right else None,
        "duration_s": duration_s,
        "log": json.dumps(records, ensure_ascii=False, separators=(",", ":"), allow_nan=False),
    }


def records_of(row: Row) -> list[Record]:
    """Return the records in the column `log` of a row."""
    found: list[Record] = json.loads(str(row["log"]))
    return found


def stage_of(point: str) -> dict[str, Json]:
    """Return the member `stage` (how trials are rendered) of session.json for the participant with identity `point`."""
    return {**OfflineStage().describe(), "simulated": True, "telemetry": False, "point": point}


def _run(made: Plan) -> tuple[list[Record], float]:
    stage, log = OfflineStage(), LogInMemory()
    session = Session(
        SessionFolder(Path(), b"", {}, {}),
        log,
        made,
        stage,
        SimulatedFront(made.seed, f"{made.participant}/{made.session}", task_of(made)),
        procedures=partial(procedure_of, made.study),
        at_level=partial(at_level, made.study),
        keep_telemetry=False,
        monotonic_s=stage.now_s,
    )
    if session.run() != "ended":
        raise HapticdError("the session was aborted")
    first, *others = log.appended
    return [{key: value for key, value in first.items() if key != CLOCK_KEY}, *others], stage.now_s()
