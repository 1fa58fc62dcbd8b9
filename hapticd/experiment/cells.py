"""The cells of a study: which sets of stimuli it presents, how often, and which answer is correct."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, combinations_with_replacement, product

from hapticd.experiment.keys import POSITION_MEANINGS, ChoiceQuestion, ListedTrial, RankingQuestion, Study
from hapticd.experiment.plain_values import Scalar
from hapticd.experiment.stimuli import REFERENCE_NAME, TARGET_NAME, level_text, levels_text

Levels = Mapping[str, Scalar]
"""The levels of a stimulus, by factor."""


@dataclass(frozen=True, slots=True)
class Cell:
    """A cell of a study: trials that have the same stimuli and differ only in the order of presentation."""

    condition: str
    name: str
    levels: tuple[Levels, ...]
    """The levels of each stimulus. In a forced choice the target comes first, unless the cell is listed: then the
    stimuli are in the order of presentation."""
    count: int
    """Number of trials in the test; for an adaptive procedure the largest possible number."""
    procedure: str | None = None
    """Name of the run of the adaptive procedure that chooses the level, or None."""
    correct: str | None = None
    """Name of the correct answer of a listed trial, if trial.list has it."""
    entry: int | None = None
    """Index in trial.list, or None if the cell comes from factors or a procedure."""

    @property
    def listed(self) -> bool:
        """Whether the cell comes from trial.list. Its stimuli are in the order of presentation."""
        return self.entry is not None


def cells_of(study: Study) -> list[Cell]:
    """Return all cells of a study's test, condition by condition, in the order of the study's file."""
    return [cell for condition in study.conditions for cell in _cells(study, condition)]


def crossed_stimuli(study: Study) -> list[Levels]:
    """Return the stimuli of `trial.cross`: every combination of the levels of its factors.

    A study without `cross` has one stimulus, without levels.
    """
    names = study.trial.cross or ()
    return [dict(zip(names, levels, strict=True)) for levels in product(*(study.factors[name].names for name in names))]


def _cells(study: Study, condition: str) -> Iterator[Cell]:
    trial, repetitions = study.trial, study.repetitions
    if trial.list is not None:
        yield from _listed(study, condition, trial.list)
        return
    stimuli = crossed_stimuli(study)
    if trial.procedures is not None:
        for levels in stimuli:
            yield from _adaptive(study, condition, levels)
        return
    match trial.type:
        case "paired_comparison":
            pairs = combinations_with_replacement(stimuli, 2) if trial.with_itself else combinations(stimuli, 2)
            for one, other in pairs:
                orders = 2 if trial.both_orders and one is not other else 1
                yield Cell(condition, _name((one, other)), (one, other), repetitions * orders)
        case "forced_choice":
            reference = _in_factor_order(study, trial.reference or {})
            others = (reference,) * (study.stimuli_per_trial - 1)
            for levels in stimuli:
                yield Cell(condition, levels_text(levels), (levels, *others), repetitions)
        case "ranking":
            for ranked in combinations(stimuli, study.stimuli_per_trial):
                yield Cell(condition, _name(ranked), ranked, repetitions)
        case _:
            for levels in stimuli:
                yield Cell(condition, levels_text(levels), (levels,), repetitions)


def _listed(study: Study, condition: str, trials: Sequence[ListedTrial]) -> Iterator[Cell]:
    """Yield the cells of the trials that a study lists in trial.list.

    Equal stimuli share one object, to save memory and time in a long list.
    """
    known: dict[object, tuple[Levels, str]] = {}
    for entry, listed in enumerate(trials):
        if listed.condition not in (None, condition):
            continue
        given, names = [], []
        for written in listed.stimuli:
            key = levels_key(written)
            found = known.get(key)
            if found is None:
                levels = _in_factor_order(study, written)
                found = known[key] = levels, levels_text(levels)
            given.append(found[0])
            names.append(found[1])
        count = study.repetitions * listed.repetitions
        yield Cell(condition, "/".join(names), tuple(given), count, correct=listed.correct, entry=entry)


def levels_key(levels: Levels) -> Hashable:
    """Return a stimulus's levels as a key for mappings. It contains the type of each level, as True == 1 in Python."""
    return tuple([(name, type(level), level) for name, level in levels.items()])


def _adaptive(study: Study, condition: str, levels: Levels) -> Iterator[Cell]:
    for name, adaptive in (study.trial.procedures or {}).items():
        variable = adaptive.variable
        parts = [name]
        if len(study.conditions) > 1:
            parts.append(condition)
        if levels:
            parts.append(levels_text(levels))
        reference: Levels = {**levels, variable.name: variable.reference}
        others = (reference,) * (study.stimuli_per_trial - 1)
        cell = levels_text(levels) if levels else name
        yield Cell(condition, cell, (levels, *others), adaptive.trials, procedure=".".join(parts))


def _in_factor_order(study: Study, levels: Levels) -> Levels:
    """Sort a stimulus's levels in the order of the study's factors. Equal stimuli then have equal names."""
    return {name: levels[name] for name in study.factors if name in levels}


def _name(stimuli: Sequence[Levels]) -> str:
    return "/".join(map(levels_text, stimuli))


def stimulus_name(study: Study, cell: Cell, index: int) -> str:
    """Return the name of a cell's stimulus: for a procedure "target" or "reference", else the stimulus's levels."""
    if cell.procedure is not None:
        return TARGET_NAME if index == 0 else REFERENCE_NAME
    return levels_text(cell.levels[index])


def correct_answer(study: Study, cell: Cell, order: Sequence[int]) -> str | None:
    """Return the name of the correct answer if the stimuli of a cell are presented in this order, or None.

    `order` holds indices of `cell.levels`. If the question asks for the highest or lowest level, the answer that means
    the position of that stimulus is correct, in a ranking all positions in order of level. Otherwise the answer that
    means the target of a forced choice is correct. In an identification it is the answer that names the level.

    Returns None if the study defines no correct answer. Stimuli with equal levels need an answer that means `same`, and
    a listed forced choice needs `correct` or a question that asks.
    """
    if cell.correct is not None:
        return cell.correct
    question = study.asked
    if isinstance(question, RankingQuestion):
        if question.asks is None:
            return None
        ranks = _ranks(study, cell, order, question.asks.factor)
        positions = sorted(range(len(order)), key=ranks.__getitem__, reverse=question.asks.which == "highest")
        return None if len(set(ranks)) < len(ranks) else ">".join(POSITION_MEANINGS[position] for position in positions)
    if not isinstance(question, ChoiceQuestion):
        return None
    if study.trial.type == "identification":
        names = set(map(level_text, cell.levels[0].values()))
        return next(
            (each.name for each in question.answers if each.level is not None and level_text(each.level) in names), None
        )
    asks = question.asks
    if asks is None:
        target_differs = cell.procedure is not None or cell.levels[0] != cell.levels[1]
        target_is_known = study.trial.type == "forced_choice" and not cell.listed and target_differs
        return _meaning(question, order.index(0)) if target_is_known else None
    if cell.procedure is not None:
        # The level of the target is chosen before each trial. The question asks for the target.
        return _meaning(question, order.index(0))
    ranks = _ranks(study, cell, order, asks.factor)
    best = max(ranks) if asks.which == "highest" else min(ranks)
    if ranks.count(best) > 1:
        return next((each.name for each in question.answers if each.means == "same"), None)
    return _meaning(question, ranks.index(best))


def _meaning(question: ChoiceQuestion, position: int) -> str | None:
    return next((each.name for each in question.answers if each.means == POSITION_MEANINGS[position]), None)


def _ranks(study: Study, cell: Cell, order: Sequence[int], factor: str) -> list[float]:
    """Return a number for each stimulus, in the order of presentation, by which its level of `factor` is compared.

    A numeric level is this number itself, as a reference need not be a level of the factor. For other levels it is the
    index in the factor's order.
    """
    levels = [cell.levels[index][factor] for index in order]
    if all(isinstance(level, int | float) and not isinstance(level, bool) for level in levels):
        return [float(level) for level in levels]
    texts = [level_text(name) for name in study.factors[factor].names]
    return [float(texts.index(level_text(level))) for level in levels]
