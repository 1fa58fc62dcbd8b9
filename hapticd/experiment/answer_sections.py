"""Sections of an analysis on which answers were given, and which were correct: cells, conditions, pairs, and others."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import Final

import numpy as np

from hapticd.analysis.statistics import FitError, Floats
from hapticd.experiment.analysis.bradley_terry import Scale, bradley_terry
from hapticd.experiment.analysis.confusion import confusion, information
from hapticd.experiment.analysis.order_matrices import order_matrix, rank_correlation
from hapticd.experiment.analysis.participants import quartiles
from hapticd.experiment.analysis.proportions import Proportion, proportion
from hapticd.experiment.behaviour import Row, StudyFacts
from hapticd.experiment.published_tables import PublishedResults
from hapticd.experiment.results import Cell, Dots, Matrices, ResultTable, Section

_WILSON_COLUMNS: Final = ("low 95 %, %", "high 95 %, %")
"""Columns of the ends of Wilson's 95 % interval, in percent."""


def by_condition(rows: Iterable[Row]) -> dict[str, list[Row]]:
    """Group the rows of a table of answers by condition. Conditions and rows keep their order."""
    found: dict[str, list[Row]] = defaultdict(list)
    for row in rows:
        found[row["condition"]].append(row)
    return dict(found)


def cells(rows: Sequence[Row], facts: StudyFacts) -> Section:
    """Tabulate trials, correct answers and Wilson's interval of each cell, a set of stimuli of the study."""
    groups: dict[tuple[str, str], list[bool]] = defaultdict(list)
    for row in rows:
        if row.right is not None:
            groups[row["condition"], row["cell"]].append(row.right)
    listed: list[tuple[Cell, ...]] = []
    for (condition, cell), right in sorted(groups.items()):
        found = proportion(sum(right), len(right), facts.chance)
        listed.append((condition, cell, *_percent_cells(found), found.p_value))
    head = ("condition", "cell", "trials", "correct", "correct, %", *_WILSON_COLUMNS, "p of chance")
    return Section((ResultTable("cells", "Answers in each cell", head, tuple(listed), _chance_note(facts)),))


def conditions(rows: Sequence[Row], facts: StudyFacts, published: PublishedResults) -> Section:
    """Tabulate percent correct by condition, next to published figures.

    Median and quartiles are over participants. The percentage of all trials counts each trial once.
    """
    listed: list[tuple[Cell, ...]] = []
    labels, ours, theirs = [], [], []
    for condition, own in by_condition(rows).items():
        right: dict[str, list[bool]] = defaultdict(list)
        for row in own:
            if row.right is not None:
                right[row["participant"]].append(row.right)
        if not right:
            continue
        found = quartiles([100.0 * sum(each) / len(each) for each in right.values()])
        pooled = [each for answers in right.values() for each in answers]
        test = proportion(sum(pooled), len(pooled), facts.chance)
        trials, _, *percent = _percent_cells(test)
        in_paper = published.quartiles.get(condition)
        own_quartiles = found.median, found.low, found.high
        paper_cells = (in_paper or (None,) * 3) if published.quartiles else ()
        listed.append((condition, found.participants, *own_quartiles, *paper_cells, trials, *percent, test.p_value))
        labels.append(condition)
        ours.append(own_quartiles)
        theirs.append(in_paper or (np.nan,) * 3)
    if not listed:
        return Section(())
    paper = ("published median, %", "published Q1, %", "published Q3, %") if published.quartiles else ()
    head = (
        *("condition", "participants", "median, %", "Q1, %", "Q3, %"),
        *paper,
        *("trials", "all trials, %", *_WILSON_COLUMNS, "p of chance"),
    )
    table = ResultTable("conditions", "Correct answers over participants", head, tuple(listed), _chance_note(facts))
    series = [("this study", *np.array(ours).T)]
    if published.quartiles:
        series.append(("published", *np.array(theirs).T))
    picture = Dots(
        "Correct answers: median and quartiles over participants",
        tuple(labels),
        tuple(series),
        "correct answers, %",
        None if facts.chance is None else 100 * facts.chance,
    )
    return Section((table,), (picture,), compares_published=any(row[0] in published.quartiles for row in listed))


def pairs(rows: Sequence[Row], facts: StudyFacts, published: PublishedResults) -> Section:
    """Tabulate percent correct of each pair of stimuli, and the rank correlation with published percentages.

    The tables have the form of Tables 2 and 3 of Okamura et al. (1998): triangles with a row and a column per stimulus.
    """
    tables, pictures = [], []
    ranks: list[tuple[Cell, ...]] = []
    for condition, own in by_condition(rows).items():
        judged = [row for row in own if row.right is not None and len(row.stimuli) == 2]
        if not judged:
            continue
        paper = published.matrices.get(condition)
        names = {name for row in judged for name in row.stimuli}
        known = paper.items if paper is not None and names <= set(paper.items) else facts.items
        items = _ordered(names, known)
        found = order_matrix(
            [(row.stimuli[0], row.stimuli[1]) for row in judged], [bool(row.right) for row in judged], items
        )
        tables.append(
            _matrix_table(f"pairs_{condition}", f"Correct answers of each pair, {condition}, %", items, found.percent)
        )
        panels = [(f"this study, {len(judged)} trials", found.percent)]
        if paper is not None and names <= set(paper.items):
            kept = [paper.items.index(name) for name in items]
            theirs = paper.percent[np.ix_(kept, kept)]
            title = f"The same as published, {condition}, %"
            tables.append(_matrix_table(f"published_pairs_{condition}", title, items, theirs))
            panels.append(("published", theirs))
            correlation, count = rank_correlation(found.percent, theirs)
            ranks.append((condition, count, correlation))
        pictures.append(
            Matrices(f"Correct answers of each pair, {condition}", items, items, tuple(panels), "%", "item", "item")
        )
    if ranks:
        note = "Spearman's coefficient over all pairs in both matrices, including the diagonal; 1 is the same order."
        head = ("condition", "pairs", "rank correlation")
        title = "Order of the pairs compared with the publication"
        tables.append(ResultTable("rank_correlation", title, head, tuple(ranks), note))
    return Section(tuple(tables), tuple(pictures), compares_published=bool(ranks))


def scales(rows: Sequence[Row], facts: StudyFacts) -> Section:
    """Tabulate the Bradley-Terry scale of the paired comparisons of each condition."""
    listed: list[tuple[Cell, ...]] = []
    found: dict[str, Scale] = {}
    notes = []
    for condition, own in by_condition(rows).items():
        judged = [row for row in own if len(row.stimuli) == 2 and facts.meanings.get(row["response"]) is not None]
        items = _ordered({name for row in judged for name in row.stimuli}, facts.items)
        if len(items) < 2:
            continue
        wins, ties = np.zeros((len(items), len(items))), np.zeros((len(items), len(items)))
        for row in judged:
            one, other = (items.index(name) for name in row.stimuli)
            meaning = facts.meanings[row["response"]]
            if meaning == "same":
                ties[one, other] += 1
            elif meaning in ("first", "second"):
                wins[(one, other) if meaning == "first" else (other, one)] += 1
        try:
            found[condition] = scale = bradley_terry(wins, ties, items)
        except FitError as error:
            notes.append(f"Bradley-Terry scale, {condition}: {error}")
            continue
        listed += [
            (condition, item, each.value, each.low, each.high)
            for item, each in zip(scale.items, scale.strengths, strict=True)
        ]
        if scale.tie is not None:
            listed.append((condition, "ties (v)", scale.tie.value, scale.tie.low, scale.tie.high))
    if not listed:
        return Section((), (), tuple(notes))
    note = (
        "Logarithm of the strength, mean 0, without unit: a difference of 1 is odds of 2.72. "
        "Pairs of equal items do not count."
    )
    head = ("condition", "item", "log strength", "low 95 %", "high 95 %")
    title = "Scale of paired comparisons (Bradley and Terry, ties after Davidson)"
    table = ResultTable("bradley_terry", title, head, tuple(listed), note)
    return Section((table,), (_scale_picture(found),), tuple(notes))


def confusions(rows: Sequence[Row], facts: StudyFacts) -> Section:
    """Tabulate confusion matrices and information transfer of the identifications of each condition."""
    tables, pictures = [], []
    listed: list[tuple[Cell, ...]] = []
    for condition, own in by_condition(rows).items():
        judged = [row for row in own if len(row.stimuli) == 1]
        if not judged:
            continue
        shown = [row.stimuli[0] for row in judged]
        answered = [facts.levels.get(row["response"], row["response"]) for row in judged]
        found = confusion(shown, answered, _ordered({*shown, *answered}, facts.items))
        head = ("shown", *found.answers)
        body: tuple[tuple[Cell, ...], ...] = tuple(
            (name, *map(int, counts)) for name, counts in zip(found.stimuli, found.counts, strict=True)
        )
        title = f"Answers to each stimulus, {condition}, trials"
        tables.append(ResultTable(f"confusion_{condition}", title, head, body))
        panel = ((f"{len(judged)} trials", found.percent),)
        pictures.append(
            Matrices(
                f"Answers to each stimulus, {condition}", found.stimuli, found.answers, panel, "%", "shown", "answered"
            )
        )
        bits = information(found.counts)
        transfer = bits.transfer, bits.corrected, bits.stimuli, 100 * bits.relative, 2.0**bits.corrected
        listed.append((condition, len(judged), *transfer))
    if not listed:
        return Section(())
    head = (
        *("condition", "trials", "transfer, bits", "without bias, bits", "stimuli, bits"),
        *("of the stimuli, %", "distinguishable categories"),
    )
    note = "The bias of few trials is corrected as by Panzeri and Treves (1996)."
    tables.append(ResultTable("information", "Information transfer", head, tuple(listed), note))
    return Section(tuple(tables), tuple(pictures))


def _ordered(names: Iterable[str], known: Sequence[str]) -> tuple[str, ...]:
    """Sort names in the order of `known`. Other names follow: first numbers by value, then texts."""
    present = set(names)
    listed = [name for name in dict.fromkeys(known) if name in present]
    return (*listed, *sorted(present.difference(listed), key=_sortable))


def _sortable(name: str) -> tuple[float, str]:
    try:
        return float(name), name
    except ValueError:
        return float("inf"), name


def _percent_cells(found: Proportion) -> tuple[Cell, ...]:
    return found.trials, found.successes, 100 * found.value, 100 * found.low, 100 * found.high


def _chance_note(facts: StudyFacts) -> str:
    if facts.chance is None:
        return "Intervals are Wilson's. The study names no chance level."
    return f"Intervals are Wilson's; p is that of the exact binomial test against chance, {100 * facts.chance:.3g} %."


def _matrix_table(name: str, title: str, items: Sequence[str], percent: Floats) -> ResultTable:
    rows: tuple[tuple[Cell, ...], ...] = tuple(
        (item, *(float(cell) for cell in cells)) for item, cells in zip(items, percent, strict=True)
    )
    return ResultTable(name, title, ("", *items), rows)


def _scale_picture(found: Mapping[str, Scale]) -> Dots:
    items = tuple(dict.fromkeys(item for scale in found.values() for item in scale.items))
    series = []
    for condition, scale in found.items():
        ends = {
            item: (each.value, each.low, each.high) for item, each in zip(scale.items, scale.strengths, strict=True)
        }
        columns = np.array([ends.get(item, (np.nan,) * 3) for item in items]).T
        series.append((condition, columns[0], columns[1], columns[2]))
    return Dots("Scale of paired comparisons", items, tuple(series), "log strength, without unit")
