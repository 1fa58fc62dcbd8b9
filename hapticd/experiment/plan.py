"""The plan of a session: which trials a participant gets, in which order, with which stimuli.

Trials of a cell (`cells.Cell`) have the same stimuli, and differ only in the order of presentation.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from hapticd.experiment.cells import Cell, Levels, cells_of, correct_answer, levels_key, stimulus_name
from hapticd.experiment.keys import Study, Variable, Warmup
from hapticd.experiment.order import (
    blocks_of,
    generator_of,
    interleaved,
    latin_order,
    shuffled,
    sides,
    target_positions,
    track_positions,
)
from hapticd.experiment.stimuli import Stimulus, place_of, stimulus_of, value_of

Phase: TypeAlias = Literal["practice", "training", "test"]


@dataclass(frozen=True, slots=True)
class PlannedTrial:
    """A trial in the plan of a session."""

    index: int
    """Number of the trial in the session, from 0."""
    phase: Phase
    block: int
    """Number of the block in the session, from 1."""
    condition: str
    cell: str
    repetition: int
    """Number of the trial in its cell and phase, or in the run of its adaptive procedure, from 1."""
    stimuli: tuple[Stimulus, ...]
    """The stimuli in order of presentation: places from left to right, or intervals. The target of an adaptive
    procedure has no level yet; `stimuli.at_level` sets it before the trial."""
    question: str
    """Name of the question in the study."""
    correct: str | None
    """Name of the correct answer, or None if the study defines none."""
    procedure: str | None
    """Name of the run of the adaptive procedure that chooses the level, or None. If the procedure has ended before, the
    trial is skipped."""


@dataclass(frozen=True, slots=True)
class Plan:
    """The plan of a session: all trials of one participant, in order."""

    study: Study
    participant: str
    session: int
    seed: int
    trials: tuple[PlannedTrial, ...]


@dataclass(slots=True)
class _UnplacedTrial:
    """A trial that has no index and no block yet. `order` holds indices of the stimuli of its cell."""

    cell: Cell
    repetition: int
    order: tuple[int, ...]
    correct: str | None


def plan(study: Study, participant: str, session: int, seed: int) -> Plan:
    """Plan the trials of a session. Equal arguments give the same plan.

    Raises InvalidError for invalid stimuli, which a study from `load_study` does not have.
    """
    generator = generator_of(seed, participant, session)
    cells = cells_of(study)
    maker = _TrialMaker(study)
    trials: list[PlannedTrial] = []
    block = 0
    phases: tuple[tuple[Phase, Warmup | None], ...] = (("practice", study.practice), ("training", study.training))
    for phase, warmup in phases:
        if warmup is not None:
            block += 1
            trials += maker.trials(phase, block, _warmup(study, cells, warmup, generator), len(trials))
    for items in _test(study, cells, participant, session, seed, generator):
        block += 1
        trials += maker.trials("test", block, items, len(trials))
    return Plan(study, participant, session, seed, tuple(trials))


def _test(
    study: Study, cells: Sequence[Cell], participant: str, session: int, seed: int, generator: np.random.Generator
) -> Iterator[list[_UnplacedTrial]]:
    """Yield the trials of the test phase, block by block."""
    if study.trial.procedures is not None:
        yield from _adaptive_test(study, cells, participant, session, seed, generator)
        return
    orders = _orders(study, cells, generator)
    items: list[_UnplacedTrial] = []
    for cell, of_cell in zip(cells, orders, strict=True):
        correct = {order: correct_answer(study, cell, order) for order in set(of_cell)}
        items += [_UnplacedTrial(cell, turn + 1, order, correct[order]) for turn, order in enumerate(of_cell)]
    keys: list[Hashable]
    match study.order.by:
        case "repetition":
            keys = [item.repetition for item in items]
        case "cell":
            keys = [(item.cell.condition, item.cell.name) for item in items]
        case _:
            keys = [item.cell.condition for item in items]
    square: list[int] = []
    if study.order.kind == "latin_square":
        square = latin_order(len(dict.fromkeys(keys)), seed, participant, session)
    for block in blocks_of(keys, study.order.kind, generator, square):
        yield [items[index] for index in block]


def _adaptive_test(
    study: Study, cells: Sequence[Cell], participant: str, session: int, seed: int, generator: np.random.Generator
) -> Iterator[list[_UnplacedTrial]]:
    """Yield the test trials of adaptive procedures, block by block.

    Within a block, runs of procedures are interleaved, except with the order `listed`.
    """
    by_procedure = study.order.by == "procedure"
    keys = [cell.procedure if by_procedure else cell.condition for cell in cells]
    kind = study.order.kind
    if kind in ("random", "listed"):
        groups = [list(range(len(cells)))]
    else:
        square = latin_order(len(dict.fromkeys(keys)), seed, participant, session) if kind == "latin_square" else []
        groups = blocks_of(keys, kind, generator, square)
    tracks = [iter(_track(study, cell, generator)) for cell in cells]
    for group in groups:
        counts = [cells[index].count for index in group]
        if kind == "listed":
            sequence = [number for number, count in enumerate(counts) for _ in range(count)]
        else:
            sequence = interleaved(counts, generator)
        yield [next(tracks[group[number]]) for number in sequence]


def _track(study: Study, cell: Cell, generator: np.random.Generator) -> Iterator[_UnplacedTrial]:
    count = len(cell.levels)
    orders = [_with_target_at(position, count) for position in range(count)]
    correct = [correct_answer(study, cell, order) for order in orders]
    for turn, position in enumerate(track_positions(cell.count, count, generator)):
        yield _UnplacedTrial(cell, turn + 1, orders[position], correct[position])


def _with_target_at(position: int, count: int) -> tuple[int, ...]:
    others = iter(range(1, count))
    return tuple(0 if each == position else next(others) for each in range(count))


def _orders(study: Study, cells: Sequence[Cell], generator: np.random.Generator) -> list[list[tuple[int, ...]]]:
    """Return the order of the stimuli in each trial of each cell, balanced over trials."""
    own = [tuple(range(len(cell.levels))) for cell in cells]
    if study.trial.list is not None:
        return [[order] * cell.count for order, cell in zip(own, cells, strict=True)]
    match study.trial.type:
        case "paired_comparison":
            return _pair_orders(cells, generator)
        case "forced_choice":
            count = study.stimuli_per_trial
            positions = target_positions([cell.count for cell in cells], count, generator)
            return [[_with_target_at(position, count) for position in of_cell] for of_cell in positions]
        case "ranking":
            return [_ranking_orders(cell, generator) for cell in cells]
        case _:
            return [[order] * cell.count for order, cell in zip(own, cells, strict=True)]


def _pair_orders(cells: Sequence[Cell], generator: np.random.Generator) -> list[list[tuple[int, ...]]]:
    """Return the order of the two stimuli, (0, 1) or (1, 0), in each trial of each cell, balanced in each condition."""
    found: list[list[tuple[int, ...]]] = [[] for _ in cells]
    numbers: dict[tuple[str, tuple[tuple[str, object], ...]], int] = {}
    pairs: dict[str, list[tuple[int, tuple[int, int]]]] = {}
    for index, cell in enumerate(cells):
        one, other = (
            numbers.setdefault((cell.condition, tuple(levels.items())), len(numbers)) for levels in cell.levels
        )
        pairs.setdefault(cell.condition, []).extend([(index, (one, other))] * cell.count)
    for of_condition in pairs.values():
        turned = sides([pair for _, pair in of_condition], generator)
        for (index, _), backwards in zip(of_condition, turned, strict=True):
            found[index].append((1, 0) if backwards else (0, 1))
    return found


def _ranking_orders(cell: Cell, generator: np.random.Generator) -> list[tuple[int, ...]]:
    """Return the order of the stimuli in each ranking of a cell, as rows of cyclic Latin squares in random order.

    Each stimulus is at each position equally often, give or take one trial.
    """
    count = len(cell.levels)
    found: list[tuple[int, ...]] = []
    while len(found) < cell.count:
        order = shuffled(range(count), generator)
        shifts = shuffled(range(count), generator)
        found += [tuple(order[shift:] + order[:shift]) for shift in shifts]
    return found[: cell.count]


def _warmup(
    study: Study, cells: Sequence[Cell], warmup: Warmup, generator: np.random.Generator
) -> list[_UnplacedTrial]:
    """Return practice or training trials, from each cell equally many, give or take one.

    The order of the trials, and of the stimuli in a trial, is random. Listed stimuli keep their order.
    """
    chosen: list[int] = []
    while len(chosen) < warmup.trials:
        chosen += shuffled(range(len(cells)), generator)
    found: list[_UnplacedTrial] = []
    seen: dict[int, int] = {}
    for index in chosen[: warmup.trials]:
        cell = cells[index]
        order = tuple(range(len(cell.levels)))
        if not cell.listed:
            order = tuple(shuffled(order, generator))
        seen[index] = seen.get(index, 0) + 1
        found.append(_UnplacedTrial(cell, seen[index], order, correct_answer(study, cell, order)))
    return found


class _TrialMaker:
    """Makes planned trials from trials without an index. Equal stimuli at the same place share one object."""

    def __init__(self, study: Study) -> None:
        self._study = study
        self._places = [place_of(study, position) for position in range(study.stimuli_per_trial)]
        self._known: dict[object, Stimulus] = {}

    def trials(self, phase: Phase, block: int, items: Sequence[_UnplacedTrial], first: int) -> list[PlannedTrial]:
        """Return the planned trials of a block in order. `first` is the index of the first one."""
        question = self._study.trial.question
        return [
            PlannedTrial(
                index=first + number,
                phase=phase,
                block=block,
                condition=item.cell.condition,
                cell=item.cell.name,
                repetition=item.repetition,
                stimuli=self._stimuli(phase, item),
                question=question,
                correct=item.correct,
                procedure=item.cell.procedure if phase == "test" else None,
            )
            for number, item in enumerate(items)
        ]

    def _stimuli(self, phase: Phase, item: _UnplacedTrial) -> tuple[Stimulus, ...]:
        cell = item.cell
        variable: Variable | None = None
        target: float | None = None
        if cell.procedure is not None:
            adaptive = self._study.adaptive(cell.procedure)
            variable = adaptive.variable
            if phase != "test":
                assert adaptive.practice_level is not None
                target = value_of(variable, adaptive.practice_level)
        found = []
        for position, index in enumerate(item.order):
            levels = cell.levels[index]
            if variable is not None and index == 0 and target is not None:
                levels = {**levels, variable.name: target}
            found.append(self._stimulus(cell, index, levels, self._places[position], variable))
        return tuple(found)

    def _stimulus(
        self, cell: Cell, index: int, levels: Levels, place: str | None, variable: Variable | None
    ) -> Stimulus:
        # In a procedure a stimulus is named by its role, target or reference.
        role = None if cell.procedure is None else index == 0
        key = cell.condition, role, place, levels_key(levels), id(variable)
        known = self._known.get(key)
        if known is None:
            name = stimulus_name(self._study, cell, index)
            known = stimulus_of(self._study, cell.condition, levels, place, variable, name)
            self._known[key] = known
        return known
