"""Check a study: stimuli that the device cannot display, duration of a session, trials of each cell, and power.

Each stimulus is checked like a configuration by `hapticd check`, without forces.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Final

from hapticd.analysis.check import check as check_config
from hapticd.base.errors import HapticdError, Problem
from hapticd.base.wording import listed
from hapticd.config.configuration import Config
from hapticd.experiment.cells import Cell, cells_of, levels_key
from hapticd.experiment.keys import ChoiceQuestion, ProportionEffect, RankingQuestion, Study
from hapticd.experiment.plan import Plan, plan
from hapticd.experiment.power import Power, power_of_difference, power_of_proportion
from hapticd.experiment.procedures.staircase import Staircase, StaircaseParameters
from hapticd.experiment.stimuli import Stimulus, config_with, level_text, levels_text, place_of, stimulus_of, value_of

_MAX_NAMED_STIMULI: Final = 6
"""A problem names at most this many of its stimuli: its line must stay readable."""


@dataclass(frozen=True, slots=True)
class CellCount:
    """Number of trials of the test in one cell; for an adaptive procedure the largest possible number."""

    condition: str
    cell: str
    trials: int


@dataclass(frozen=True, slots=True)
class StudyReport:
    """The result of a check of a study: problems with stimuli, duration, trials of each cell, and power."""

    title: str
    device: str
    practice_trials: int
    training_trials: int
    test_trials: int
    at_most: bool
    """Whether fewer trials may be needed: a procedure can end by a criterion, and wrong answers can end the test."""
    cells: tuple[CellCount, ...]
    breaks: int
    minutes: float
    """Duration of a session in minutes: `expected_s` for each trial, plus the shortest duration of each break."""
    expected_s: float
    """Expected duration of a trial in s, from the study."""
    correct: str | None
    """Which answer is correct, in words, or None if the study defines no correct answer."""
    chance: float | None
    """Probability of a correct answer by guessing, or None if the answers are not tested against chance."""
    power: Power | None
    undisplayable: tuple[Problem, ...]
    """Problems of the device with stimuli, each once, with the names of these stimuli."""
    to_look_at: tuple[Problem, ...]
    """Warnings of names that reveal levels or conditions to participants, and of staircases that cannot reach their
    hardest level."""

    @property
    def faults(self) -> int:
        """Number of problems of the device with the study's stimuli."""
        return len(self.undisplayable)

    def to_dict(self) -> dict[str, object]:
        """Return the report as JSON data."""
        return {**asdict(self), "can_be_shown": self.faults == 0}


def check_study(study: Study, rig: Config) -> StudyReport:
    """Check a study with the device and servo of `rig`. Stimuli that cannot be displayed are in the result.

    Raises HapticdError if the computation of the power needs scipy, which is not installed, or if the effect is a
    proportion and the study has no analysis.chance.
    """
    sample, cells = plan(study, "", 1, study.order.seed), cells_of(study)
    phases = [trial.phase for trial in sample.trials]
    breaks = breaks_of(sample)
    device, undisplayable = display_problems(study, cells, rig)
    correct = correct_words(study) if any(trial.correct is not None for trial in sample.trials) else None
    seconds = len(phases) * study.trial.expected_s + breaks * study.breaks.least_s
    return StudyReport(
        title=study.title,
        device=device,
        practice_trials=phases.count("practice"),
        training_trials=phases.count("training"),
        test_trials=phases.count("test"),
        at_most=study.may_end_early,
        cells=tuple(_counts(cells)),
        breaks=breaks,
        minutes=seconds / 60,
        expected_s=study.trial.expected_s,
        correct=correct,
        chance=study.analysis.chance,
        power=_power(study, len(cells), phases.count("test")),
        undisplayable=undisplayable,
        to_look_at=(*_revealing_names(study), *_short_staircases(study)),
    )


def breaks_of(plan: Plan) -> int:
    """Count the breaks of a plan's test: one every `every_trials` trials, and with `between_blocks` between blocks."""
    breaks = plan.study.breaks
    test = [trial for trial in plan.trials if trial.phase == "test"]
    return sum(
        (breaks.every_trials is not None and number % breaks.every_trials == 0)
        or (breaks.between_blocks and trial.block != before.block)
        for number, (before, trial) in enumerate(pairwise(test), 1)
    )


def correct_words(study: Study) -> str:
    """Return in words which answer is correct, for a study that defines correct answers."""
    question = study.asked
    if any(each.correct is not None for each in study.trial.list or ()):
        return "as trial.list defines"
    asks = question.asks if isinstance(question, ChoiceQuestion | RankingQuestion) else None
    if isinstance(question, RankingQuestion) and asks is not None:
        return f"the order that begins with the {asks.which} {asks.factor}"
    if study.trial.type == "identification":
        return "the answer whose level is that of the stimulus"
    if asks is None or study.trial.procedures is not None:
        return "the answer that names the target"
    return f"the answer that names the stimulus with the {asks.which} {asks.factor}, in the order of its levels"


def _counts(cells: Sequence[Cell]) -> Iterator[CellCount]:
    counts: dict[tuple[str, str], int] = {}
    for cell in cells:
        key = cell.condition, cell.procedure or cell.name
        counts[key] = counts.get(key, 0) + cell.count
    for (condition, name), trials in counts.items():
        yield CellCount(condition, name, trials)


def _power(study: Study, cells: int, trials: int) -> Power | None:
    effect = study.analysis.effect
    if effect is None:
        return None
    if isinstance(effect, ProportionEffect):
        chance = study.analysis.chance
        if chance is None:
            raise HapticdError("analysis.effect: an effect of kind proportion needs analysis.chance, which is missing")
        return power_of_proportion(effect, chance, max(1, trials // len(study.conditions)))
    groups = len(study.conditions) if len(study.conditions) > 1 else cells
    return power_of_difference(effect, max(1, trials // groups))


def display_problems(study: Study, cells: Sequence[Cell], rig: Config) -> tuple[str, tuple[Problem, ...]]:
    """Return the device of `rig`, and its problems with stimuli, each once, with the names of these stimuli."""
    found: dict[tuple[str, str], list[str]] = {}
    device = ""
    for name, stimulus in _stimuli(study, cells):
        report = check_config(config_with(study, (stimulus,), rig))
        device = report.device
        for problem in (*report.refused, *report.undisplayable, *report.warnings, *report.stability.problems()):
            names = found.setdefault((problem.where, problem.problem), [])
            if name not in names:
                names.append(name)
    return device, tuple(Problem(where, f"{text} ({_names(names)})") for (where, text), names in found.items())


def _names(names: Sequence[str]) -> str:
    more = f" and {len(names) - _MAX_NAMED_STIMULI} more" if len(names) > _MAX_NAMED_STIMULI else ""
    return ", ".join(names[:_MAX_NAMED_STIMULI]) + more if more else listed(names)


def _stimuli(study: Study, cells: Sequence[Cell]) -> Iterator[tuple[str, Stimulus]]:
    """Yield each stimulus of a study once, with its name, as if presented at the first place.

    Of a procedure these are its reference, and its target at both ends of the range of levels.
    """
    seen: set[str] = set()
    known: set[Hashable] = set()
    place = place_of(study, 0)
    for cell in cells:
        variants = list(cell.levels)
        variable = None
        if cell.procedure is not None:
            adaptive = study.adaptive(cell.procedure)
            variable = adaptive.variable
            ends = [value_of(variable, level) for level in adaptive.ends]
            variants = [cell.levels[1], *({**cell.levels[0], variable.name: end} for end in ends)]
        for levels in variants:
            # A long trial.list repeats few levels, whose names are formatted once.
            same = cell.condition, levels_key(levels)
            if same in known:
                continue
            known.add(same)
            key = f"{cell.condition}: {levels_text(levels)}"
            if key not in seen:
                seen.add(key)
                name = levels_text(levels) if len(study.conditions) == 1 else key
                yield name, stimulus_of(study, cell.condition, levels, place, variable)


def _short_staircases(study: Study) -> Iterator[Problem]:
    """Yield a warning for each staircase that does not reach its hardest level even if every answer is correct."""
    for name, adaptive in (study.trial.procedures or {}).items():
        method = adaptive.method
        if not isinstance(method, StaircaseParameters):
            continue
        hardest = method.least if method.harder == "lower" else method.most
        staircase = Staircase(method)
        reached = method.start
        while (level := staircase.level()) is not None:
            reached = level
            staircase.answer(level, True)
        if not math.isclose(reached, hardest, abs_tol=1e-9 * (method.most - method.least)):
            yield Problem(
                f"trial.procedures.{name}.method.steps",
                f"if every answer is correct, {method.trials} trials reach only {reached:g}, not the hardest level "
                f"{hardest:g}; use more trials, larger steps, or a nearer limit",
            )


def _revealing_names(study: Study) -> Iterator[Problem]:
    """Yield a warning for each label or name of an answer, or id of an object, that names a level or a condition."""
    hidden = {level_text(level).casefold() for factor in study.factors.values() for level in factor.names}
    hidden |= {name.casefold() for name in study.conditions}
    question = study.asked
    if isinstance(question, ChoiceQuestion):
        for index, answer in enumerate(question.answers):
            for key, text in (("name", answer.name), ("label", answer.label)):
                if text.casefold() in hidden:
                    where = f"questions.{study.trial.question}.answers[{index}].{key}"
                    yield Problem(where, f"the participant sees {text}, which is the name of a level or a condition")
    scene = study.base.get("scene")
    objects = scene.get("objects") if isinstance(scene, Mapping) else None
    for id in objects if isinstance(objects, Mapping) else ():
        if id.casefold() in hidden:
            yield Problem(
                f"base.scene.objects.{id}", "the id is the name of a level or a condition, which the page may reveal"
            )
