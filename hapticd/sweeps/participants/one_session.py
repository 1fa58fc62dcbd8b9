"""The whole session of a simulated participant, in memory: nothing is written, nothing has a time of day."""

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
"""Member of the first record that is of the machine, not of the session."""
SESSION_COLUMNS: Final = (
    Column("trials", "integer", "measured", "", "Trials of the plan."),
    Column("answered", "integer", "measured", "", "Trials with an answer."),
    Column("correct", "number", "measured", "", "Part of the test's answers that are right; absent: none can be."),
    Column("duration_s", "number", "measured", "s", "How long the session took the participant."),
    Column("log", "text", "measured", "", "The records of the session's log, as JSON."),
)


def row_of(study: Study, participant: str, session: int, seed: int) -> Row:
    """SESSION_COLUMNS of a session. The same study, participant, session and seed give the same bits. Raises HapticdError."""
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
    """The records of a row's log."""
    found: list[Record] = json.loads(str(row["log"]))
    return found


def stage_of(point: str) -> dict[str, Json]:
    """What session.json says of the stage of a participant that is known by this point."""
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
