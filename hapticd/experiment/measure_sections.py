"""Sections of an analysis that are about numbers: psychometric functions, ratings, rankings, measures of the motion."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Final

import numpy as np

from hapticd.analysis.statistics import Estimate, FitError
from hapticd.base.errors import HapticdError
from hapticd.base.wording import listed as listing
from hapticd.config.schema import unit_of
from hapticd.experiment.analysis.motor import paired
from hapticd.experiment.analysis.participants import mean_of_each, mean_ranks, quartiles
from hapticd.experiment.analysis.proportions import proportion
from hapticd.experiment.analysis.psychometric import PsychometricFit, bootstrap, fit, goodness_of_fit
from hapticd.experiment.analysis.psychometric_shapes import PSYCHOMETRIC_SHAPES
from hapticd.experiment.answer_sections import by_condition
from hapticd.experiment.behaviour import MEASURES, Row, StudyFacts, Varied
from hapticd.experiment.procedures.procedure import ProcedureError
from hapticd.experiment.procedures.staircase import Staircase, StaircaseParameters
from hapticd.experiment.published_tables import PublishedResults
from hapticd.experiment.results import Cell, Dots, Fitted, PairedValues, ResultTable, Section

POOLED: Final = "pooled"
"""In the place of a participant: the answers of all together."""
RESAMPLES: Final = 1000
_CURVE: Final = 200
_AXIS_UNITS: Final = {True: "1 per unit of ln level", False: "1 per unit of level"}


def psychometric(rows: Sequence[Row], facts: StudyFacts) -> Section:
    """A psychometric function of correct answers for each condition, cell and `Varied`: of all participants, and of
    each of them."""
    listed: list[tuple[Cell, ...]] = []
    pictures, notes = [], []
    for (condition, cell, varied), judged in _by_function(rows, facts).items():
        procedures = listing(sorted({_procedure(row) for row in judged}))
        people = sorted({row["participant"] for row in judged})
        groups = [(POOLED, judged)]
        if len(people) > 1:
            groups += [(person, [row for row in judged if row["participant"] == person]) for person in people]
        for who, group in groups:
            name = f"psychometric function, {', '.join(filter(None, (condition, cell, procedures, who)))}"
            try:
                found = _best(group, varied)
            except FitError as error:
                notes.append(f"{name}: {error}")
                continue
            threshold, undetermined = None, found.undetermined(varied.unit)
            if undetermined is None:
                estimates, fitness = bootstrap(found, RESAMPLES), goodness_of_fit(found, RESAMPLES)
                ends = estimates["pse"]
                threshold = ends.value, ends.low, ends.high
                listed += [
                    (
                        *(condition, *((cell,) if facts.crossed else ()), procedures, who, found.shape, len(group)),
                        *(figure, unit, each.value, *_ends(each), fitness),
                    )
                    for figure, unit, each in _figures(found, estimates, varied)
                ]
                lowest, highest = found.levels.min(), found.levels.max()
                if ends.low < lowest or ends.high > highest:
                    shown = f"{lowest:g} to {highest:g} {varied.unit}"
                    notes.append(f"{name}: the threshold's interval goes beyond the levels that were shown, {shown}")
                if found.as_steep_as_levels_show:
                    notes.append(f"{name}: the slope is the steepest that the distances of the levels can show")
            else:
                notes.append(f"{name}: {undetermined}")
            if who == POOLED:
                of = ", ".join(filter(None, (condition, cell, procedures)))
                pictures.append(_picture(of, found, threshold, varied.unit))
    if not listed:
        return Section((), tuple(pictures), tuple(notes))
    head = (
        "condition",
        *(("cell",) if facts.crossed else ()),
        "procedures",
        "participant",
        "function",
        "trials",
        "figure",
        "unit",
        "value",
        "low 95 %",
        "high 95 %",
        "p of the fit",
    )
    note = (
        "The threshold is the level at half of the way from guess to 1 less lapse; where the level is a difference "
        "from a reference, threshold over reference is the Weber fraction. Intervals and p of the deviance are of a "
        "parametric bootstrap; a lapse that is 0 in all of it has none. The function is the one of greatest likelihood."
    )
    return Section(
        (ResultTable("psychometric", "Psychometric functions", head, tuple(listed), note),),
        tuple(pictures),
        tuple(notes),
    )


def _by_function(rows: Sequence[Row], facts: StudyFacts) -> dict[tuple[str, str, Varied], list[Row]]:
    """The judged rows that have a level, by condition, cell and what varies. Only crossed factors make cells."""
    found: dict[tuple[str, str, Varied], list[Row]] = defaultdict(list)
    for row in rows:
        if row.right is not None and row.number("level") is not None:
            cell = row["cell"] if facts.crossed else ""
            found[row["condition"], cell, facts.varied.get(_procedure(row), Varied())].append(row)
    return dict(found)


def _procedure(row: Row) -> str:
    """The name in the study; a row's has condition and levels behind it."""
    return (row.get("procedure") or "").partition(".")[0]


def staircases(rows: Sequence[Row], facts: StudyFacts) -> Section:
    """The mean of the reversals of each staircase of each session, as Levitt (1971) estimates a threshold."""
    runs: dict[tuple[str, ...], list[Row]] = defaultdict(list)
    for row in rows:
        if _procedure(row) in facts.staircases:
            runs[row["participant"], row["session"], row["condition"], row["procedure"]].append(row)
    table: list[tuple[Cell, ...]] = []
    notes = []
    for (participant, session, condition, procedure), own in runs.items():
        name = _procedure(own[0])
        try:
            staircase = _repeated(StaircaseParameters.model_validate(facts.staircases[name]), own)
        except HapticdError as error:
            notes.append(f"mean of reversals, {participant}, session {session}, {procedure}: {error}")
            continue
        unit = facts.varied[name].unit
        counts = len(staircase.answers), len(staircase.reversals)
        table.append((condition, procedure, participant, session, *counts, staircase.reversal_mean(), unit))
    if not table:
        return Section((), (), tuple(notes))
    head = ("condition", "procedure", "participant", "session", "trials", "reversals", "mean of reversals", "unit")
    note = (
        "Without the first reversals, as many as `discard` says; on a logarithmic axis the geometric mean. A staircase "
        "with too few reversals has none."
    )
    return Section((ResultTable("staircases", "Staircases", head, tuple(table), note),), (), tuple(notes))


def _repeated(parameters: StaircaseParameters, rows: Sequence[Row]) -> Staircase:
    """The staircase after the answers of its rows, in their order. Raises ProcedureError where a level was not due."""
    staircase = Staircase(parameters)
    for row in rows:
        shown, due = row.number("level"), staircase.level()
        # A table has nine digits of a level.
        if due is None or shown is None or not math.isclose(shown, due, rel_tol=1e-7, abs_tol=1e-12):
            raise ProcedureError(f"{row.where}: the staircase of the study would not show this level")
        staircase.answer(due, row.right is True)
    return staircase


def ratings(rows: Sequence[Row]) -> Section:
    """Numeric answers: median and quartiles over participants of each one's mean."""
    listed: list[tuple[Cell, ...]] = []
    pictures = []
    for condition, own in by_condition(rows).items():
        values: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
        for row in own:
            number = row.number("response")
            assert number is not None
            values[row["cell"]][row["participant"]].append(number)
        found = {cell: quartiles(list(mean_of_each(each).values())) for cell, each in values.items()}
        listed += [
            (condition, cell, sum(map(len, values[cell].values())), each.participants, each.median, each.low, each.high)
            for cell, each in found.items()
        ]
        columns = np.array([(each.median, each.low, each.high) for each in found.values()]).T
        series = (("median and quartiles", columns[0], columns[1], columns[2]),)
        pictures.append(Dots(f"Ratings, {condition}", tuple(found), series, "rating, points of the scale"))
    head = ("condition", "cell", "trials", "participants", "median", "Q1", "Q3")
    note = "In points of the scale. Each participant counts once, with the mean of the answers."
    return Section((ResultTable("ratings", "Ratings over participants", head, tuple(listed), note),), tuple(pictures))


def rankings(rows: Sequence[Row], positions: Sequence[str]) -> Section:
    """Answers such as second>first>third: mean ranks of the stimuli of each cell, and how far its rankings agree."""
    listed: list[tuple[Cell, ...]] = []
    notes = []
    for condition, own in by_condition(rows).items():
        sets: dict[str, list[list[str]]] = defaultdict(list)
        for row in own:
            sets[row["cell"]].append([row.stimuli[positions.index(word)] for word in row["response"].split(">")])
        for cell, ranked in sets.items():
            try:
                ranks, concordance = mean_ranks(ranked)
            except FitError as error:
                notes.append(f"ranks, {condition}, {cell}: {error}")
                continue
            by_rank = sorted(ranks.items(), key=lambda each: each[1])
            listed += [(condition, cell, item, len(ranked), rank, concordance) for item, rank in by_rank]
    head = ("condition", "cell", "item", "rankings", "mean rank", "Kendall's W")
    note = (
        "Rank 1 is the first of a ranking. W is 1 where all rankings of a cell are the same, 0 where they have nothing "
        "in common."
    )
    return Section((ResultTable("rankings", "Ranks", head, tuple(listed), note),), (), tuple(notes))


def motions(rows: Sequence[Row], facts: StudyFacts, published: PublishedResults) -> Section:
    """Measures of the motion: over participants, and each two conditions compared."""
    summary: list[tuple[Cell, ...]] = []
    compared: list[tuple[Cell, ...]] = []
    effects: list[tuple[Cell, ...]] = []
    pictures = []
    not_compared: dict[str, list[str]] = defaultdict(list)
    for measure in MEASURES:
        means: dict[str, dict[str, float]] = {}
        for condition, own in by_condition(rows).items():
            values: dict[str, list[float]] = defaultdict(list)
            for row in own:
                number = row.number(measure)
                if number is not None:
                    values[row["participant"]].append(number)
            if values:
                means[condition] = mean_of_each(values)
                found = quartiles(list(means[condition].values()))
                trials = sum(map(len, values.values()))
                summary.append(
                    (
                        measure,
                        _unit(measure),
                        condition,
                        trials,
                        found.participants,
                        found.median,
                        found.low,
                        found.high,
                    )
                )
        for one, other in combinations(means, 2):
            both = sorted(set(means[one]) & set(means[other]))
            try:
                each = paired([means[one][who] for who in both], [means[other][who] for who in both])
            except FitError as error:
                not_compared[f"{one} less {other}: {error}"].append(measure)
                continue
            difference, effect = each.difference, each.effect_size
            paper = published.difference if published.difference and published.difference[0] == measure else None
            compared.append(
                (
                    *(measure, _unit(measure), f"{one} less {other}", each.participants),
                    *(difference.value, difference.low, difference.high, each.standard_deviation),
                    *((paper[1], paper[2]) if paper else (None, None)),
                )
            )
            effects.append(
                (
                    *(measure, f"{one} less {other}", each.participants),
                    *(effect.value, effect.low, effect.high, each.t, each.p_value, each.wilcoxon_p),
                )
            )
        if len(means) == 1 and len(facts.conditions) > 1:
            not_compared[f"only trials of {next(iter(means))}: a comparison needs two conditions"].append(measure)
        if len(means) > 1:
            people = sorted(set.intersection(*(set(each) for each in means.values())))
            if people:
                values_of = np.array([[each[who] for each in means.values()] for who in people])
                pictures.append(
                    PairedValues(
                        f"{measure} of each participant", tuple(means), values_of, f"{measure}, {_unit(measure)}"
                    )
                )
    notes = [f"{listing(measures)}, {why}" for why, measures in not_compared.items()]
    beside_published = published.difference is not None and any(row[0] == published.difference[0] for row in compared)
    return _motion_section(summary, compared, effects, beside_published, pictures, notes)


def _motion_section(
    summary: list[tuple[Cell, ...]],
    compared: list[tuple[Cell, ...]],
    effects: list[tuple[Cell, ...]],
    beside_published: bool,
    pictures: list[PairedValues],
    notes: list[str],
) -> Section:
    tables = []
    if summary:
        head: tuple[str, ...] = ("measure", "unit", "condition", "trials", "participants", "median", "Q1", "Q3")
        tables.append(ResultTable("measures", "Measures of motion and time over participants", head, tuple(summary)))
    if compared:
        head = (
            *("measure", "unit", "comparison", "participants", "difference", "low 95 %", "high 95 %", "SD"),
            *(("published difference", "published SD") if beside_published else ()),
        )
        if not beside_published:
            compared = [row[:-2] for row in compared]
        note = "Differences of the participants' means, with Student's interval."
        tables.append(ResultTable("comparisons", "Conditions compared", head, tuple(compared), note))
        head = (
            *("measure", "comparison", "participants", "effect size d_z", "low 95 %", "high 95 %"),
            *("t", "p (t)", "p (Wilcoxon)"),
        )
        note = "d_z, without unit, is the mean difference over its standard deviation, with noncentral t's interval."
        tables.append(ResultTable("effects", "Size of the effects, and tests", head, tuple(effects), note))
    return Section(tuple(tables), tuple(pictures), tuple(notes), beside_published)


def _unit(measure: str) -> str:
    return unit_of(measure) or "s"


def _figures(
    found: PsychometricFit, estimates: Mapping[str, Estimate], varied: Varied
) -> list[tuple[str, str, Estimate]]:
    """Names, units and values."""
    threshold, reference = estimates["pse"], varied.reference
    figures = [("threshold", varied.unit, threshold)]
    if varied.level == "added" and reference:
        figures.append(("weber_fraction", "ratio", threshold.mapped(lambda level: level / abs(reference))))
    slope_unit = _AXIS_UNITS[found.logarithmic]
    return [*figures, ("slope", slope_unit, estimates["slope"]), ("lapse", "probability", estimates["lapse"])]


def _ends(found: Estimate) -> tuple[float | None, float | None]:
    """Of the interval; a figure that is held by its bound in every resample has none."""
    return (None, None) if found.low == found.high else (found.low, found.high)


def _best(rows: Sequence[Row], varied: Varied) -> PsychometricFit:
    """The shape of greatest likelihood."""
    # Levels that a staircase came back to differ in their last bits.
    levels = np.array([float(f"{row.number('level'):.9g}") for row in rows])
    right = np.array([row.right for row in rows], dtype=float)
    places, at = np.unique(levels, return_inverse=True)
    on_log = varied.logarithmic and bool((places > 0).all())
    shapes = [shape for shape in PSYCHOMETRIC_SHAPES if shape != "weibull" or on_log]
    counts, trials = np.bincount(at, right), np.bincount(at)
    fits = [
        fit(places, counts, trials, shape, guess=varied.guess, logarithmic=on_log, rising=varied.rising)
        for shape in shapes
    ]
    return min(fits, key=lambda each: each.deviance)


def _picture(of: str, found: PsychometricFit, threshold: tuple[float, float, float] | None, unit: str) -> Fitted:
    shown = [proportion(int(right), int(count)) for right, count in zip(found.positive, found.trials, strict=True)]
    space = np.geomspace if found.logarithmic else np.linspace
    levels = np.asarray(space(found.levels.min(), found.levels.max(), _CURVE))
    return Fitted(
        f"Psychometric function, {of}, {found.shape}",
        found.levels,
        np.array([100 * each.value for each in shown]),
        np.array([100 * each.low for each in shown]),
        np.array([100 * each.high for each in shown]),
        levels,
        100 * found.probability(levels),
        threshold,
        f"level, {unit}",
        found.logarithmic,
    )
