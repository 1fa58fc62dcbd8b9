"""Conflicts between the keys of a study, each with the path of the key at which it can be corrected."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Final, TypeAlias

from hapticd.base.errors import Path, known_names, quoted
from hapticd.experiment.cells import Cell, cells_of, correct_answer, crossed_stimuli
from hapticd.experiment.key_paths import path_of
from hapticd.experiment.keys import (
    MAX_TRIALS,
    NAMED_KEYS,
    POSITION_MEANINGS,
    ChoiceQuestion,
    ListedTrial,
    MeasureQuestion,
    Question,
    RankingQuestion,
    Study,
    TrialType,
)
from hapticd.experiment.plain_values import Scalar
from hapticd.experiment.published import published_faults
from hapticd.experiment.stimuli import PLACE_PLACEHOLDER, level_text

Fault: TypeAlias = tuple[Path, str]
"""The path of a key of the study, and a text on what is wrong with the key."""

_QUESTION_KINDS: Final[dict[TrialType, tuple[str, ...]]] = {
    "paired_comparison": ("choice",),
    "forced_choice": ("choice",),
    "identification": ("choice",),
    "ranking": ("ranking",),
    "rating": ("slider", "number", "choice", "text"),
    "motor": ("measure",),
}
"""Kinds of questions that each type of trial allows."""
_COMPARING_TRIAL_TYPES: Final = ("paired_comparison", "forced_choice", "ranking")
"""Types of trials in which stimuli are compared with each other."""
_STUDY_SECTIONS: Final = ("scene", "materials")
"""Sections of a configuration that a study may change."""


def faults_between(study: Study) -> list[Fault]:
    """Return all conflicts between the keys of a study. `display_faults` finds invalid configurations of stimuli."""
    parts: tuple[Callable[[Study], Iterator[Fault]], ...] = (
        _base, _factors, _questions, _trial, _presentation, _references, _procedures, _order, _session_faults,
    )  # fmt: skip
    found = [fault for part in parts for fault in part(study)]
    # The cells can only be made if every factor and level exists that the study names.
    return found or list(_cells(study))


def _base(study: Study) -> Iterator[Fault]:
    yield from _sections(study.base, ("base",))
    for name, condition in study.conditions.items():
        yield from _sections(condition.changes, ("conditions", name, "changes"))
    for name, factor in study.factors.items():
        for variant, patch in (factor.variants or {}).items():
            yield from _sections(patch, ("factors", name, "variants", variant))


def _sections(patch: Mapping[str, object], path: Path) -> Iterator[Fault]:
    for key in patch:
        if key in ("servo", "device", "flight"):
            yield (*path, key), "belongs to the daemon's configuration; a study may only have scene and materials"
        elif key not in _STUDY_SECTIONS:
            yield (*path, key), f"unknown key; {known_names(key, _STUDY_SECTIONS)}"


def _factors(study: Study) -> Iterator[Fault]:
    in_places = study.trial.presentation == "places" and study.stimuli_per_trial > 1
    for name, factor in study.factors.items():
        where: Path = ("factors", name)
        texts = Counter(map(level_text, factor.names))
        for index, level in enumerate(factor.levels or ()):
            if texts[level_text(level)] > 1:
                yield (*where, "levels", index), f"duplicate level {level_text(level)}"
                break
        yield from _paths(study, factor.at or (), (*where, "at"), in_places)
        for variant, patch in (factor.variants or {}).items():
            if in_places and PLACE_PLACEHOLDER not in str(patch):
                yield (
                    (*where, "variants", variant),
                    f"needs {PLACE_PLACEHOLDER}: stimuli side by side would all change the same keys",
                )
    used = _used_factors(study)
    # An unknown name in cross is probably a misspelt factor, which _trial reports.
    for name in study.factors if used <= set(study.factors) else ():
        if name not in used:
            yield (
                ("factors", name),
                "no trial varies this factor; name it in trial.cross or in the stimuli of trial.list",
            )


def _paths(study: Study, paths: Sequence[str], where: Path, in_places: bool) -> Iterator[Fault]:
    for text in paths:
        try:
            path = path_of(text)
        except ValueError as error:
            yield where, f"{quoted(text)} {error}"
            continue
        if path[0] not in _STUDY_SECTIONS or len(path) < 2:
            yield where, f"{quoted(text)} must begin with scene. or materials."
        elif PLACE_PLACEHOLDER in text and not study.places:
            yield (
                where,
                f"{quoted(text)} has {PLACE_PLACEHOLDER}, but the study has no places; add e.g. places: [left, right]",
            )
        elif in_places and PLACE_PLACEHOLDER not in text.partition("[")[0]:
            yield where, f"{quoted(text)} needs {PLACE_PLACEHOLDER}: stimuli side by side would all set the same key"


def _used_factors(study: Study) -> set[str]:
    trial = study.trial
    listed = {name for each in trial.list or () for stimulus in each.stimuli for name in stimulus}
    return {*(trial.cross or ()), *listed}


def _questions(study: Study) -> Iterator[Fault]:
    for name, question in study.questions.items():
        if isinstance(question, ChoiceQuestion):
            yield from _answers(question, ("questions", name, "answers"))
        if isinstance(question, ChoiceQuestion | RankingQuestion) and question.asks is not None:
            yield from _asked_factor_faults(study, question.asks.factor, ("questions", name, "asks", "factor"))
    if study.trial.question not in study.questions:
        known = known_names(study.trial.question, study.questions)
        yield ("trial", "question"), f"unknown question {quoted(study.trial.question)}; {known}"
        return
    for name in study.questions:
        if name != study.trial.question:
            yield ("questions", name), f"no trial asks this question; trial.question is {study.trial.question}"


def _answers(question: ChoiceQuestion, where: Path) -> Iterator[Fault]:
    names: dict[str, int] = {}
    keys: dict[str, str] = {}
    meanings: dict[str, str] = {}
    for index, answer in enumerate(question.answers):
        if answer.name in names:
            yield (*where, index, "name"), f"duplicate name {quoted(answer.name)}; each answer needs its own name"
        names[answer.name] = index
        if answer.key is not None:
            if answer.key in keys:
                yield (
                    (*where, index, "key"),
                    f"{quoted(answer.key)} is already the key of {keys[answer.key]}; each answer needs its own key",
                )
            elif answer.key == "escape":
                yield (*where, index, "key"), "escape stops the forces and cannot be the key of an answer"
            elif len(answer.key) > 1 and answer.key not in NAMED_KEYS:
                known = f"one character, or {' or '.join(NAMED_KEYS)}"
                yield (*where, index, "key"), f"unknown keyboard key {quoted(answer.key)}; must be {known}"
            keys[answer.key] = answer.name
        if answer.means is not None:
            if answer.means in meanings:
                yield (*where, index, "means"), f"the answer {meanings[answer.means]} already means {answer.means}"
            meanings[answer.means] = answer.name
    for number, answer in enumerate(question.answers, 1):
        if answer.key is None and str(number) in keys:
            yield (
                (*where, number - 1, "name"),
                f"has no key, and its default, {number}, is the key of {keys[str(number)]}; give it a key",
            )


def _asked_factor_faults(study: Study, factor: str, where: Path) -> Iterator[Fault]:
    trial = study.trial
    if trial.type not in _COMPARING_TRIAL_TYPES:
        yield where, f"a trial of type {trial.type} compares no stimuli; remove asks"
        return
    variables = [each.variable.name for each in (trial.procedures or {}).values()]
    known = [*study.factors, *variables]
    if factor not in known:
        yield where, f"unknown factor {quoted(factor)}; {known_names(factor, known)}"
    elif factor in study.factors and trial.procedures is not None:
        yield where, f"the stimuli of a procedure differ in its variable; must be {' or '.join(variables)}"


def _trial(study: Study) -> Iterator[Fault]:
    trial = study.trial
    given = [name for name in ("cross", "list") if getattr(trial, name) is not None]
    if len(given) == 2:
        yield ("trial", "list"), "needs at most one of cross and list, has both"
    if trial.list is not None and trial.procedures is not None:
        yield ("trial", "procedures"), "needs at most one of list and procedures, has both"
    if not given and trial.procedures is None and trial.type in (*_COMPARING_TRIAL_TYPES, "identification"):
        yield ("trial", "type"), f"{trial.type} needs cross, list or procedures, which define its stimuli"
    if trial.procedures is not None and trial.type != "forced_choice":
        yield ("trial", "type"), f"procedures need type forced_choice, is {trial.type}"
    for key in ("with_itself", "both_orders"):
        if getattr(trial, key) and (trial.type != "paired_comparison" or trial.list is not None):
            yield ("trial", key), "is only valid for a paired_comparison with cross"
    if trial.alternatives is not None and trial.type not in ("forced_choice", "ranking"):
        yield ("trial", "alternatives"), f"is only valid for forced_choice and ranking, not for {trial.type}"
    for index, name in enumerate(trial.cross or ()):
        if name not in study.factors:
            yield ("trial", "cross", index), f"unknown factor {quoted(name)}; {known_names(name, study.factors)}"
        elif name in (trial.cross or ())[:index]:
            yield ("trial", "cross", index), f"duplicate factor {name}"
    known = _known(study)
    for index, listed in enumerate(trial.list or ()):
        yield from _listed(study, listed, known, ("trial", "list", index))
    if len(set(trial.measures)) < len(trial.measures):
        yield ("trial", "measures"), "has a duplicate measure"
    question = study.questions.get(trial.question)
    if question is not None:
        yield from _kind(study, question)


def _kind(study: Study, question: Question) -> Iterator[Fault]:
    trial, where = study.trial, ("questions", study.trial.question)
    if question.kind not in _QUESTION_KINDS[trial.type]:
        kinds = " or ".join(_QUESTION_KINDS[trial.type])
        yield (*where, "kind"), f"a trial of type {trial.type} needs a question of kind {kinds}, is {question.kind}"
        return
    if isinstance(question, MeasureQuestion) and question.measure in trial.measures:
        yield ("trial", "measures"), f"{question.measure} is already the measure of the question"
    if not isinstance(question, ChoiceQuestion):
        return
    meanings = [answer.means for answer in question.answers]
    positions = POSITION_MEANINGS[: study.stimuli_per_trial]
    if trial.type in ("paired_comparison", "forced_choice"):
        for position in positions:
            if position not in meanings:
                yield (*where, "answers"), f"no answer with means: {position}; each stimulus of a trial needs one"
        for index, means in enumerate(meanings):
            if means is not None and means != "same" and means not in positions:
                text = f"a trial has {study.stimuli_per_trial} stimuli; must be {' or '.join((*positions, 'same'))}"
                yield (*where, "answers", index, "means"), text
    if trial.with_itself and question.asks is not None and "same" not in meanings:
        yield ("trial", "with_itself"), "equal stimuli have no correct answer; give an answer with means: same"
    if trial.type == "identification":
        yield from _identification_faults(study, question)


def _identification_faults(study: Study, question: ChoiceQuestion) -> Iterator[Fault]:
    where: Path = ("questions", study.trial.question, "answers")
    factors = [name for name in _used_factors(study) if name in study.factors]
    named = {level_text(answer.level) for answer in question.answers if answer.level is not None}
    for index, answer in enumerate(question.answers):
        if answer.level is None:
            yield (*where, index), f"needs level: the level of {' or '.join(factors)} that the answer names"
    if not factors or any(answer.level is None for answer in question.answers):
        return
    by_factor = {name: [level_text(level) for level in study.factors[name].names] for name in factors}
    factor = max(by_factor, key=lambda name: len(named & set(by_factor[name])))
    known = by_factor[factor]
    for index, answer in enumerate(question.answers):
        text = level_text(answer.level or "")
        if answer.level is not None and text not in known:
            yield (*where, index, "level"), f"{factor} has no level {text}; {known_names(text, known)}"
    for text in known:
        if text not in named:
            yield where, f"no answer names the level {text} of {factor}; its trials have no correct answer"


_Known: TypeAlias = Mapping[str, Mapping[str, None]]
"""The levels of each factor as texts, in the order of the study."""


def _known(study: Study) -> _Known:
    return {name: dict.fromkeys(map(level_text, factor.names)) for name, factor in study.factors.items()}


def _listed(study: Study, listed: ListedTrial, known: _Known, where: Path) -> Iterator[Fault]:
    if len(listed.stimuli) != study.stimuli_per_trial:
        text = f"a trial of type {study.trial.type} has {study.stimuli_per_trial} stimuli"
        yield (*where, "stimuli"), f"{text}, this trial has {len(listed.stimuli)}"
    if listed.condition is not None and listed.condition not in study.conditions:
        meant = known_names(listed.condition, study.conditions)
        yield (*where, "condition"), f"unknown condition {quoted(listed.condition)}; {meant}"
    for index, levels in enumerate(listed.stimuli):
        yield from _levels(study, levels, known, (*where, "stimuli", index))
        for name in study.factors:
            if name not in levels:
                yield (*where, "stimuli", index), f"has no level of the factor {name}"
    question = study.questions.get(study.trial.question)
    if listed.correct is not None and isinstance(question, ChoiceQuestion):
        names = [answer.name for answer in question.answers]
        if listed.correct not in names:
            text = f"unknown answer {quoted(listed.correct)}; {known_names(listed.correct, names)}"
            yield (*where, "correct"), text


def _levels(
    study: Study, levels: Mapping[str, Scalar], known: _Known, where: Path, any_number: bool = False
) -> Iterator[Fault]:
    """Yield the faults of a stimulus's levels. With `any_number`, every number is a level of a numeric factor."""
    for name, level in levels.items():
        factor = study.factors.get(name)
        if factor is None:
            yield (*where, name), f"unknown factor {quoted(name)}; {known_names(name, study.factors)}"
            continue
        text = level_text(level)
        allowed = any_number and factor.levels is not None and _number(level) and all(map(_number, factor.levels))
        if text not in known[name] and not allowed:
            yield (*where, name), f"the factor {name} has no level {quoted(text)}; {known_names(text, known[name])}"


def _number(level: Scalar) -> bool:
    return isinstance(level, int | float) and not isinstance(level, bool)


def _presentation(study: Study) -> Iterator[Fault]:
    count = study.stimuli_per_trial
    if study.trial.presentation == "places":
        if len(study.places) != count:
            text = f"a trial has {count} stimuli side by side, and the study has {len(study.places)} places"
            yield ("places",) if study.places else ("trial", "presentation"), f"{text}; e.g. places: [left, right]"
    elif study.places:
        yield ("places",), "stimuli are presented one after the other; remove it, or use presentation: places"
    levels = {level_text(level) for factor in study.factors.values() for level in factor.names}
    for index, place in enumerate(study.places):
        if place in study.places[:index]:
            yield ("places", index), f"duplicate place {quoted(place)}"
        elif place in levels or place in study.conditions:
            yield (
                ("places", index),
                f"{quoted(place)} is also a level or a condition; the participant would see its name",
            )


def _references(study: Study) -> Iterator[Fault]:
    trial = study.trial
    crossed = trial.cross or ()
    if trial.reference is None:
        if trial.type == "forced_choice" and crossed and trial.procedures is None:
            yield ("trial",), "a forced_choice with cross needs reference, the levels of the other stimuli"
        return
    if trial.type != "forced_choice" or trial.procedures is not None or trial.list is not None:
        yield ("trial", "reference"), "is only valid for a forced_choice with cross"
        return
    yield from _levels(study, trial.reference, _known(study), ("trial", "reference"), any_number=True)
    for name in crossed:
        if name in study.factors and name not in trial.reference:
            yield ("trial", "reference"), f"has no level of the factor {name}"
    for name in trial.reference:
        if name in study.factors and name not in crossed:
            yield ("trial", "reference", name), f"the factor {name} is not in trial.cross"


def _procedures(study: Study) -> Iterator[Fault]:
    for name, adaptive in (study.trial.procedures or {}).items():
        where: Path = ("trial", "procedures", name)
        variable = adaptive.variable
        if variable.name in study.factors:
            yield (
                (*where, "variable", "name"),
                f"{quoted(variable.name)} is also a factor; give the variable another name",
            )
        in_places = study.trial.presentation == "places"
        yield from _paths(study, variable.at, (*where, "variable", "at"), in_places)
        if variable.level == "factor" and variable.reference == 0:
            yield (*where, "variable", "reference"), "must not be 0, since the level multiplies it"
        if (study.practice or study.training) and adaptive.practice_level is None:
            yield where, "needs practice_level, the level of practice and training trials"


def _order(study: Study) -> Iterator[Fault]:
    order = study.order
    if order.by is not None and order.kind in ("random", "listed"):
        yield ("order", "by"), f"is only valid for blocked and latin_square; {order.kind} has no blocks"
    if order.by == "procedure" and study.trial.procedures is None:
        yield ("order", "by"), "is procedure, but trial has no procedures"
    if order.by in ("repetition", "cell") and study.trial.procedures is not None:
        yield ("order", "by"), f"must be condition or procedure for a study with procedures, is {order.by}"
    if order.kind == "latin_square" and order.by in (None, "condition") and len(study.conditions) < 2:
        yield ("order", "kind"), "a Latin square needs two blocks or more, and the study has one condition"


def _session_faults(study: Study) -> Iterator[Fault]:
    question = study.questions.get(study.trial.question)
    if question is None:
        return
    judged = _judged(study, question)
    if study.feedback == "correctness" and not judged:
        yield ("feedback",), "no answer is defined as correct; give the question asks, or use feedback: none"
    if study.feedback == "measure" and not (isinstance(question, MeasureQuestion) or study.trial.measures):
        yield ("feedback",), "nothing is measured; use a question of kind measure, or trial.measures"
    measures = (
        (*study.trial.measures, question.measure) if isinstance(question, MeasureQuestion) else study.trial.measures
    )
    if "overtravel_m" in measures and not _has_membrane(study):
        yield ("trial",), "overtravel_m is measured from the rupture of a membrane, and the scene has none"
    if study.stop.wrong_in_a_row is not None and not judged:
        yield ("stop", "wrong_in_a_row"), "no answer is defined as correct; give the question asks, or remove it"
    breaks = study.breaks
    if breaks.least_s > 0 and breaks.every_trials is None and not breaks.between_blocks:
        yield ("breaks", "least_s"), "the study has no breaks; give every_trials or between_blocks"
    analysis = study.analysis
    if analysis.chance is not None and not judged:
        yield ("analysis", "chance"), "no answer is defined as correct; remove it"
    if analysis.effect is not None:
        if analysis.effect.kind == "proportion" and not judged:
            yield (
                ("analysis", "effect", "kind"),
                "no answer is defined as correct; use difference, or remove the effect",
            )
        if analysis.effect.kind == "difference" and not isinstance(question, MeasureQuestion):
            yield ("analysis", "effect", "kind"), "a difference needs a question of kind measure; use proportion"
    if analysis.published is not None:
        for text in published_faults(analysis.published):
            yield ("analysis", "published"), text


def _has_membrane(study: Study) -> bool:
    """Return whether the base scene of a study, a condition or a variant has a membrane."""
    changes = [condition.changes for condition in study.conditions.values()]
    variants = [variant for factor in study.factors.values() for variant in (factor.variants or {}).values()]
    return any("'membrane'" in str(each.get("scene")) for each in (study.base, *changes, *variants))


def _judged(study: Study, question: Question) -> bool:
    """Return whether a study defines which answers are correct."""
    if isinstance(question, ChoiceQuestion | RankingQuestion) and question.asks is not None:
        return True
    listed = any(each.correct is not None for each in study.trial.list or ())
    return listed or study.trial.type in ("forced_choice", "identification")


def _cells(study: Study) -> Iterator[Fault]:
    trial = study.trial
    if trial.type == "paired_comparison" and trial.cross and len(crossed_stimuli(study)) < 2 and not trial.with_itself:
        yield ("trial", "cross"), "defines one stimulus, and a pair needs two; give more levels, or with_itself"
    if trial.type == "ranking" and trial.cross and len(crossed_stimuli(study)) < study.stimuli_per_trial:
        made, count = len(crossed_stimuli(study)), study.stimuli_per_trial
        yield (
            ("trial", "cross"),
            f"defines {made} stimuli, and a ranking needs {count}; give more levels or fewer alternatives",
        )
    cells = cells_of(study)
    if not cells:
        return
    empty = set(study.conditions) - {cell.condition for cell in cells}
    for name in study.conditions:
        if name in empty:
            yield ("conditions", name), "has no trials; trial.list needs an entry for this condition"
    yield from _without_correct(study, cells)
    shown = {(name, level_text(level)) for cell in cells for each in cell.levels for name, level in each.items()}
    for name, factor in study.factors.items():
        for index, level in enumerate(factor.names):
            if (name, level_text(level)) not in shown:
                key: Path = ("levels", index) if factor.levels is not None else ("variants", str(level))
                yield ("factors", name, *key), f"no trial shows the level {level_text(level)}; list it, or remove it"
    count = sum(cell.count for cell in cells)
    if count > MAX_TRIALS:
        yield ("repetitions",), f"the study has {count:,} trials, must be at most {MAX_TRIALS:,}"


def _without_correct(study: Study, cells: Sequence[Cell]) -> Iterator[Fault]:
    """Yield a fault for each trial of a forced choice that has no correct answer."""
    question = study.asked
    if study.trial.type != "forced_choice" or not isinstance(question, ChoiceQuestion):
        return
    if study.trial.list is not None:
        remedy = "give the trial correct"
    elif question.asks is None:
        remedy = "the target equals the reference, use other levels"
    else:
        remedy = "several stimuli have the level that is asked for, use other levels or an answer with means: same"
    reported: set[Path] = set()
    for cell in cells:
        if correct_answer(study, cell, range(len(cell.levels))) is None:
            where: Path = ("trial", "reference") if cell.entry is None else ("trial", "list", cell.entry)
            if where not in reported:
                reported.add(where)
                yield where, f"{cell.name}: no answer is correct; {remedy}"
