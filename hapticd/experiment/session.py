"""Begin or resume a session: write and read the plan of its trials, and make its adaptive procedures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, cast

from hapticd._version import __version__
from hapticd.base import clock
from hapticd.base.errors import HapticdError, known_names, quoted
from hapticd.base.yaml_source import Json
from hapticd.experiment.keys import Study
from hapticd.experiment.plan import Plan, PlannedTrial
from hapticd.experiment.procedures.constant_stimuli import ConstantStimuli
from hapticd.experiment.procedures.procedure import Procedure
from hapticd.experiment.procedures.quest_plus import QuestPlus
from hapticd.experiment.procedures.staircase import Staircase
from hapticd.experiment.session_folder import SessionFolder
from hapticd.experiment.session_log import SessionLog
from hapticd.experiment.stimuli import Stimulus

_PROCEDURE_KINDS: Final[dict[str, type[Procedure[Any]]]] = {
    "staircase": Staircase,
    "quest_plus": QuestPlus,
    "constant_stimuli": ConstantStimuli,
}


def begin(root: Path, source: bytes, plan: Plan, stage: Mapping[str, Json]) -> tuple[SessionFolder, SessionLog]:
    """Make the folder and the log of a new session, and return both.

    `source` is the content of the study's YAML file, `stage` the description from `Stage.describe`. Raises HapticdError
    if the session already exists or cannot be written.
    """
    return SessionFolder.create(root, source, plan_document(plan), about_of(plan, stage, clock.read()))


def about_of(plan: Plan, stage: Mapping[str, Json], moment: clock.Moment) -> dict[str, Json]:
    """Return the content of session.json for a session that begins at `moment` on this stage."""
    return {
        "participant": plan.participant,
        "session": plan.session,
        "seed": plan.seed,
        "title": plan.study.title,
        "version": __version__,
        "stage": dict(stage),
        "clock": {"monotonic_ns": moment.monotonic_ns, "realtime_ns": moment.realtime_ns},
    }


def plan_document(plan: Plan) -> dict[str, Json]:
    """Return a plan as plain data, with the complete study, including the content of its base file."""
    return {
        "study": plan.study.to_dict(),
        "participant": plan.participant,
        "session": plan.session,
        "seed": plan.seed,
        "trials": [_trial_document(trial) for trial in plan.trials],
    }


def _trial_document(trial: PlannedTrial) -> dict[str, Json]:
    return {
        "index": trial.index,
        "phase": trial.phase,
        "block": trial.block,
        "condition": trial.condition,
        "cell": trial.cell,
        "repetition": trial.repetition,
        "stimuli": [
            {"name": each.name, "levels": dict(each.levels), "changes": dict(each.changes)} for each in trial.stimuli
        ],
        "question": trial.question,
        "correct": trial.correct,
        "procedure": trial.procedure,
    }


def plan_of(folder: SessionFolder) -> Plan:
    """Return the plan in the file plan.json of a session. Another version of hapticd might plan different trials.

    Raises HapticdError if the file is invalid.
    """
    document = cast("dict[str, Any]", folder.plan)
    try:
        trials = tuple(
            PlannedTrial(**{**each, "stimuli": tuple(Stimulus(**stimulus) for stimulus in each["stimuli"])})
            for each in document["trials"]
        )
        study = Study.model_validate(document["study"])
        return Plan(study, document["participant"], document["session"], document["seed"], trials)
    except (KeyError, TypeError) as error:
        raise HapticdError(f"{folder.path}/plan.json: not a plan of this version of hapticd ({error})") from None


def procedure_of(study: Study, name: str, state: Json) -> Procedure[Any]:
    """Return the adaptive procedure of the run `name`: a new one if `state` is null, else one with this stored state.

    Raises HapticdError if study or state is invalid.
    """
    method = dict(study.adaptive(name).method)
    kind = str(method.get("kind", ""))
    if kind not in _PROCEDURE_KINDS:
        known = known_names(kind, _PROCEDURE_KINDS)
        raise HapticdError(f"trial.procedures.{name}.method.kind: unknown procedure {quoted(kind)}; {known}")
    made = _PROCEDURE_KINDS[kind]
    return made(made.PARAMETERS.model_validate(method)) if state is None else made.restored(state)
