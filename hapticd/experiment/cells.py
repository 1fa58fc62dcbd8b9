"""The cells of a study: which sets of stimuli it presents, how often, and what answer is correct."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, combinations_with_replacement, product

from hapticd.experiment.keys import (
    POSITIONS,
    ChoiceQuestion,
    ListedTrial,
    RankingQuestion,
    Study,
)
from hapticd.experiment.plain_values import Scalar
from hapticd.experiment.stimuli import REFERENCE, TARGET, level_text, levels_text

Levels = Mapping[str, Scalar]


@dataclass(frozen=True, slots=True)
class Cell:
    """Trials that differ only in the order of presentation."""

    condition: str
    name: str
    levels: tuple[Levels, ...]
    """Of each stimulus; the target of a forced choice is the first, and the order of listed ones is that of their
    presentation."""
    count: int
    """Trials of it in the test; of a procedure the most."""
    procedure: str | None = None
    correct: str | None = None
    """Of a listed trial what its file says."""
    entry: int | None = None
    """Its place in trial.list; None: the cell was made of factors or of a procedure."""

    @property
    def listed(self) -> bool:
        """Whether its stimuli are in the order of their presentation."""
        return self.entry is not None


def cells_of(study: Study) -> list[Cell]:
    """All cells of the test, condition by condition, in the order of the file."""
    return [cell for condition in study.conditions for cell in _cells(study, condition)]


def combined(study: Study) -> list[Levels]:
    """The stimuli of `cross`: every combination of the levels of its factors; one without any factor else."""
    names = study.trial.cross or ()
    return [dict(zip(names, levels, strict=True)) for levels in product(*(study.factors[name].names for name in names))]


def _cells(study: Study, condition: str) -> Iterator[Cell]:
    trial, repetitions = study.trial, study.repetitions
    if trial.list is not None:
        yield from _listed(study, condition, trial.list)
        return
    stimuli = combined(study)
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
            reference = _in_order(study, trial.reference or {})
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
    """Stimuli of the same levels are one object: a long list has few of them, and each is named once."""
    known: dict[object, tuple[Levels, str]] = {}
    for entry, listed in enumerate(trials):
        if listed.condition not in (None, condition):
            continue
        given, names = [], []
        for written in listed.stimuli:
            key = typed(written)
            found = known.get(key)
            if found is None:
                levels = _in_order(study, written)
                found = known[key] = levels, levels_text(levels)
            given.append(found[0])
            names.append(found[1])
        count = study.repetitions * listed.repetitions
        yield Cell(condition, "/".join(names), tuple(given), count, correct=listed.correct, entry=entry)


def typed(levels: Levels) -> Hashable:
    """Levels as a key of a mapping. True is 1 for Python, and no level that is displayed alike."""
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


def _in_order(study: Study, levels: Levels) -> Levels:
    """Levels in the order of the study's factors, so that the same ones have one name."""
    return {name: levels[name] for name in study.factors if name in levels}


def _name(stimuli: Sequence[Levels]) -> str:
    return "/".join(map(levels_text, stimuli))


def stimulus_name(study: Study, cell: Cell, index: int) -> str:
    """The name of a cell's stimulus: target and reference in a procedure, else its levels."""
    if cell.procedure is not None:
        return TARGET if index == 0 else REFERENCE
    return levels_text(cell.levels[index])


def correct_answer(study: Study, cell: Cell, order: Sequence[int]) -> str | None:
    """The name of the correct answer when the cell's stimuli are presented in this order (indices of its levels).

    A paired comparison's by what the question asks for, a forced choice's that which means the target's position
    unless the question asks, an identification's that which names the level, a ranking's the positions in order.
    None where the study does not say, of ties without an answer that means `same`, and of a listed forced choice for
    which neither trial nor question says it: its target is not known.
    """
    if cell.correct is not None:
        return cell.correct
    question = study.asked
    if isinstance(question, RankingQuestion):
        if question.asks is None:
            return None
        ranks = _ranks(study, cell, order, question.asks.factor)
        positions = sorted(range(len(order)), key=ranks.__getitem__, reverse=question.asks.which == "highest")
        return None if len(set(ranks)) < len(ranks) else ">".join(POSITIONS[position] for position in positions)
    if not isinstance(question, ChoiceQuestion):
        return None
    if study.trial.type == "identification":
        names = set(map(level_text, cell.levels[0].values()))
        return next(
            (each.name for each in question.answers if each.level is not None and level_text(each.level) in names), None
        )
    asks = question.asks
    if asks is None:
        target_is_known = study.trial.type == "forced_choice" and not cell.listed and _odd(cell)
        return _meaning(question, order.index(0)) if target_is_known else None
    if cell.procedure is not None:
        # The variable is not known before the trial; the target is what is asked for.
        return _meaning(question, order.index(0))
    ranks = _ranks(study, cell, order, asks.factor)
    best = max(ranks) if asks.which == "highest" else min(ranks)
    if ranks.count(best) > 1:
        return next((each.name for each in question.answers if each.means == "same"), None)
    return _meaning(question, ranks.index(best))


def _odd(cell: Cell) -> bool:
    """Whether the target differs from the others."""
    return cell.procedure is not None or cell.levels[0] != cell.levels[1]


def _meaning(question: ChoiceQuestion, position: int) -> str | None:
    return next((each.name for each in question.answers if each.means == POSITIONS[position]), None)


def _ranks(study: Study, cell: Cell, order: Sequence[int], factor: str) -> list[float]:
    """Of each stimulus in the order of presentation the rank of its level: of numbers the value, since a reference need
    not be one of the factor's levels."""
    levels = [cell.levels[index][factor] for index in order]
    if all(isinstance(level, int | float) and not isinstance(level, bool) for level in levels):
        return [float(level) for level in levels]
    texts = [level_text(name) for name in study.factors[factor].names]
    return [float(texts.index(level_text(level))) for level in levels]
