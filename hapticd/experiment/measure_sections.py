"""Sections of an analysis on psychometric functions, staircases, ratings, rankings and measures of the motion."""

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
from hapticd.experiment.behaviour import MEASURE_COLUMNS, Row, StudyFacts, Varied
from hapticd.experiment.keys import POSITION_MEANINGS
from hapticd.experiment.procedures.procedure import ProcedureError
from hapticd.experiment.procedures.staircase import Staircase, StaircaseParameters
from hapticd.experiment.published_tables import PublishedResults
from hapticd.experiment.results import Cell, Dots, Fitted, PairedValues, ResultTable, Section

POOLED_LABEL: Final = "pooled"
"""Stands in the column `participant` for the answers of all participants together."""
_FIT_RESAMPLES: Final = 1000
"""Number of bootstrap resamples of each fit: fewer than the default, because a table has many fits."""
_FITTED_CURVE_POINTS: Final = 200
"""Number of points of a drawn psychometric function."""
_AXIS_UNITS: Final = {True: "1 per unit of ln level", False: "1 per unit of level"}
"""Unit of the slope of a psychometric function, by whether its axis is logarithmic."""


def psychometric(rows: Sequence[Row], facts: StudyFacts) -> Section:
    """Tabulate psychometric functions, fitted to the answers of each condition, cell and varied quantity.

    One function is fitted to the answers of all participants together, and one to those of each participant.
    """
    listed: list[tuple[Cell, ...]] = []
    pictures, notes = [], []
    for (condition, cell, varied), judged in _by_function(rows, facts).items():
        procedures = listing(sorted({_procedure(row) for row in judged}))
        people = sorted({row["participant"] for row in judged})
        groups = [(POOLED_LABEL, judged)]
        if len(people) > 1:
            groups += [(person, [row for row in judged if row["participant"] == person]) for person in people]
        for who, group in groups:
            name = f"psychometric function, {', '.join(filter(None, (condition, cell, procedures, who)))}"
            try:
                found = _most_likely_fit(group, varied)
            except FitError as error:
                notes.append(f"{name}: {error}")
                continue
            threshold, undetermined = None, found.undetermined(varied.unit)
            if undetermined is None:
                estimates, fitness = bootstrap(found, _FIT_RESAMPLES), goodness_of_fit(found, _FIT_RESAMPLES)
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
                    notes.append(f"{name}: the threshold's interval extends beyond the levels shown, {shown}")
                if found.as_steep_as_levels_show:
                    notes.append(f"{name}: the slope is the steepest that the spacing of the levels can resolve")
            else:
                notes.append(f"{name}: {undetermined}")
            if who == POOLED_LABEL:
                of = ", ".join(filter(None, (condition, cell, procedures)))
                pictures.append(_picture(of, found, threshold, varied.unit))
    if not listed:
        return Section((), tuple(pictures), tuple(notes))
    head = (
        *("condition", *(("cell",) if facts.crossed else ()), "procedures", "participant", "function", "trials"),
        *("figure", "unit", "value", "low 95 %", "high 95 %", "p of the fit"),
    )
    note = (
        "The threshold is the level halfway between guess and 1 - lapse. If the level is a difference from a "
        "reference, threshold over reference is the Weber fraction. Intervals and p of the deviance come from a "
        "parametric bootstrap; a lapse that is 0 in every resample has no interval. The function is the one with the "
        "greatest likelihood."
    )
    return Section(
        (ResultTable("psychometric", "Psychometric functions", head, tuple(listed), note),),
        tuple(pictures),
        tuple(notes),
    )


def _by_function(rows: Sequence[Row], facts: StudyFacts) -> dict[tuple[str, str, Varied], list[Row]]:
    """Group rows by condition, cell and varied quantity. Rows without a level, or without `correct`, are left out.

    In a study without crossed factors (trial.cross) the name of the cell is empty.
    """
    found: dict[tuple[str, str, Varied], list[Row]] = defaultdict(list)
    for row in rows:
        if row.right is not None and row.number("level") is not None:
            cell = row["cell"] if facts.crossed else ""
            found[row["condition"], cell, facts.varied.get(_procedure(row), Varied())].append(row)
    return dict(found)


def _procedure(row: Row) -> str:
    """Return the name of a row's adaptive procedure, without condition and cell, which may follow in a run's name."""
    return (row.get("procedure") or "").partition(".")[0]


def staircases(rows: Sequence[Row], facts: StudyFacts) -> Section:
    """Tabulate the mean of the reversals of each run of a staircase. It estimates the threshold (Levitt, 1971)."""
    runs: dict[tuple[str, ...], list[Row]] = defaultdict(list)
    for row in rows:
        if _procedure(row) in facts.staircases:
            runs[row["participant"], row["session"], row["condition"], row["procedure"]].append(row)
    table: list[tuple[Cell, ...]] = []
    notes = []
    for (participant, session, condition, procedure), own in runs.items():
        name = _procedure(own[0])
        try:
            staircase = _replayed_staircase(StaircaseParameters.model_validate(facts.staircases[name]), own)
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
        "The first `discard` reversals are left out. On a logarithmic axis it is the geometric mean. A staircase with "
        "too few reversals has no mean."
    )
    return Section((ResultTable("staircases", "Staircases", head, tuple(table), note),), (), tuple(notes))


def _replayed_staircase(parameters: StaircaseParameters, rows: Sequence[Row]) -> Staircase:
    """Make a staircase, give it the answers of its rows in their order, and return it.

    Raises ProcedureError if a row's level is not the next level of the staircase.
    """
    staircase = Staircase(parameters)
    for row in rows:
        shown, due = row.number("level"), staircase.level()
        # A table of answers has nine digits of a level.
        if due is None or shown is None or not math.isclose(shown, due, rel_tol=1e-7, abs_tol=1e-12):
            raise ProcedureError(f"{row.where}: the staircase of the study would not show this level next")
        staircase.answer(due, row.right is True)
    return staircase


def ratings(rows: Sequence[Row]) -> Section:
    """Tabulate ratings: median and quartiles over participants, each of whom counts with the mean of the answers."""
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


def rankings(rows: Sequence[Row]) -> Section:
    """Tabulate rankings, such as second>first>third: mean ranks of the stimuli of each cell, and Kendall's W."""
    listed: list[tuple[Cell, ...]] = []
    notes = []
    for condition, own in by_condition(rows).items():
        sets: dict[str, list[list[str]]] = defaultdict(list)
        for row in own:
            words = row["response"].split(">")
            sets[row["cell"]].append([row.stimuli[POSITION_MEANINGS.index(word)] for word in words])
        for cell, ranked in sets.items():
            try:
                ranks, concordance = mean_ranks(ranked)
            except FitError as error:
                notes.append(f"ranks, {condition}, {cell}: {error}")
                continue
            by_rank = sorted(ranks.items(), key=lambda each: each[1])
            listed += [(condition, cell, item, len(ranked), rank, concordance) for item, rank in by_rank]
    head = ("condition", "cell", "item", "rankings", "mean rank", "Kendall's W")
    note = "Rank 1 is the first of a ranking. W is 1 if all rankings of a cell agree, 0 if they have nothing in common."
    return Section((ResultTable("rankings", "Ranks", head, tuple(listed), note),), (), tuple(notes))


def motions(rows: Sequence[Row], facts: StudyFacts, published: PublishedResults) -> Section:
    """Tabulate measures of the motion over participants, and compare the conditions in pairs."""
    summary: list[tuple[Cell, ...]] = []
    compared: list[tuple[Cell, ...]] = []
    effects: list[tuple[Cell, ...]] = []
    pictures = []
    not_compared: dict[str, list[str]] = defaultdict(list)
    for measure in MEASURE_COLUMNS:
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
                counts, places = (trials, found.participants), (found.median, found.low, found.high)
                summary.append((measure, _unit(measure), condition, *counts, *places))
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
            not_compared[f"only in trials of {next(iter(means))}: a comparison needs two conditions"].append(measure)
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
    compares_published = published.difference is not None and any(row[0] == published.difference[0] for row in compared)
    return _motion_section(summary, compared, effects, compares_published, pictures, notes)


def _motion_section(
    summary: list[tuple[Cell, ...]],
    compared: list[tuple[Cell, ...]],
    effects: list[tuple[Cell, ...]],
    compares_published: bool,
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
            *(("published difference", "published SD") if compares_published else ()),
        )
        if not compares_published:
            compared = [row[:-2] for row in compared]
        note = "Differences of the participants' means, with Student's interval."
        tables.append(ResultTable("comparisons", "Conditions compared", head, tuple(compared), note))
        ends = "low 95 %", "high 95 %"
        head = ("measure", "comparison", "participants", "effect size d_z", *ends, "t", "p (t)", "p (Wilcoxon)")
        note = "d_z (no unit) is the mean difference over its standard deviation, with the interval of noncentral t."
        tables.append(ResultTable("effects", "Size of the effects, and tests", head, tuple(effects), note))
    return Section(tuple(tables), tuple(pictures), tuple(notes), compares_published)


def _unit(measure: str) -> str:
    return unit_of(measure) or "s"


def _figures(
    found: PsychometricFit, estimates: Mapping[str, Estimate], varied: Varied
) -> list[tuple[str, str, Estimate]]:
    """Return the figures of a fit, each with name and unit: threshold, Weber fraction, slope and lapse."""
    threshold, reference = estimates["pse"], varied.reference
    figures = [("threshold", varied.unit, threshold)]
    if varied.level == "added" and reference:
        figures.append(("weber_fraction", "ratio", threshold.mapped(lambda level: level / abs(reference))))
    slope_unit = _AXIS_UNITS[found.logarithmic]
    return [*figures, ("slope", slope_unit, estimates["slope"]), ("lapse", "probability", estimates["lapse"])]


def _ends(found: Estimate) -> tuple[float | None, float | None]:
    """Return the ends of an estimate's interval, or (None, None) if the interval has no width."""
    return (None, None) if found.low == found.high else (found.low, found.high)


def _most_likely_fit(rows: Sequence[Row], varied: Varied) -> PsychometricFit:
    """Fit every shape of psychometric function, and return the fit with the greatest likelihood."""
    # A level to which a staircase returns can differ from the earlier one in the last bits.
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
    levels = np.asarray(space(found.levels.min(), found.levels.max(), _FITTED_CURVE_POINTS))
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
