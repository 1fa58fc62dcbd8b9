"""The complete analysis of the sessions of one study.

Only answered trials of the test phase are used. If there are none, test trials with a measure of the motion are used.
The summary says how many trials are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hapticd.analysis.statistics import require_scipy
from hapticd.base import wording
from hapticd.base.errors import HapticdError
from hapticd.base.yaml_source import Json
from hapticd.experiment import answer_sections, measure_sections
from hapticd.experiment.behaviour import MEASURE_COLUMNS, Behaviour, Row, read_behaviour
from hapticd.experiment.keys import POSITION_MEANINGS
from hapticd.experiment.published_tables import PublishedResults, published_results
from hapticd.experiment.results import ResultTable, Section


@dataclass(frozen=True, slots=True)
class Analysis:
    """The analysis of the sessions of one study. `files` are the tables of answers that were analyzed."""

    title: str
    summary: str
    sections: tuple[Section, ...]
    files: tuple[Path, ...]
    published: str | None
    """Name of the published results that are shown next to the results of the sessions, or None."""

    @property
    def tables(self) -> tuple[ResultTable, ...]:
        """The tables of all sections, in order."""
        return tuple(table for section in self.sections for table in section.tables)

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes of all sections on results that could not be computed, with the reason, or are of limited validity."""
        return tuple(note for section in self.sections for note in section.notes)

    def to_dict(self) -> dict[str, Json]:
        """Return the analysis as JSON data, with its tables by name."""
        return {
            "title": self.title,
            "summary": self.summary,
            "published": self.published,
            "tables": {table.name: table.to_dict() for table in self.tables},
            "notes": list(self.notes),
            "files": [str(file) for file in self.files],
        }


def analyze(folders: Sequence[Path]) -> Analysis:
    """Analyze every session in the folders and their subfolders.

    Raises HapticdError if the tables of answers cannot be read, belong to several studies, or have no trial to analyze.
    """
    require_scipy("the analysis of experiments", "experiment")
    return analysis_of(read_behaviour(folders))


def analysis_of(behaviour: Behaviour) -> Analysis:
    """Analyze the answers of sessions. Raises HapticdError if there is no trial to analyze."""
    facts = behaviour.facts
    tested = [row for row in behaviour.rows if row["phase"] == "test"]
    answered = [row for row in tested if row.get("response") is not None]
    used = answered or [row for row in tested if any(row.get(name) is not None for name in MEASURE_COLUMNS)]
    if not used:
        raise HapticdError(
            f"nothing to analyze: none of the {len(behaviour.rows):,} trials belongs to the test and has an answer"
        )
    published = published_results(facts.published) if facts.published else PublishedResults()
    places = {name: place for place, name in enumerate(facts.conditions)}
    used.sort(key=lambda row: places.get(row["condition"], len(places)))
    sections = _sections(tested, used, behaviour, published)
    people = len({row["participant"] for row in used})
    left = len(tested) - len(used)
    summary = (
        f"{wording.count(people, 'participant')}, {wording.count(len(behaviour.files), 'session')}, "
        f"{wording.count(len(used), 'trial')} of the test; {len(behaviour.rows) - len(tested):,} of practice or "
        f"training and {left:,} without an answer are left out"
    )
    compared = any(section.compares_published for section in sections)
    if facts.published and not compared:
        note = f"published results {facts.published}: these sessions have no results yet to compare with them"
        sections.insert(0, Section((), notes=(note,)))
    return Analysis(
        facts.title,
        summary,
        tuple(section for section in sections if section.tables or section.pictures or section.notes),
        behaviour.files,
        facts.published if compared else None,
    )


def _sections(
    tested: Sequence[Row], used: Sequence[Row], behaviour: Behaviour, published: PublishedResults
) -> list[Section]:
    facts, found = behaviour.facts, []
    judged = [row for row in used if row.right is not None]
    if judged:
        found.append(answer_sections.conditions(judged, facts, published))
    adaptive = [row for row in judged if row.get("level") is not None]
    if adaptive:
        found.append(measure_sections.psychometric(adaptive, facts))
        found.append(measure_sections.staircases(tested, facts))
    answers = [row for row in used if row.get("response") is not None]
    fixed = [row for row in answers if row.get("level") is None]
    if facts.trial_type == "paired_comparison":
        found.append(answer_sections.pairs(fixed, facts, published))
        found.append(answer_sections.scales(fixed, facts))
    if facts.trial_type == "identification":
        found.append(answer_sections.confusions(fixed, facts))
    if facts.trial_type == "ranking":
        found.append(measure_sections.rankings([row for row in fixed if _is_ranking(row)]))
    if facts.trial_type == "rating":
        found.append(measure_sections.ratings(answers))
    found.append(measure_sections.motions(used, facts, published))
    fixed_judged = [row for row in judged if row.get("level") is None]
    if fixed_judged:
        found.append(answer_sections.cells(fixed_judged, facts))
    return found


def _is_ranking(row: Row) -> bool:
    words = row["response"].split(">")
    right = len(words) == len(row.stimuli) and set(words) == set(POSITION_MEANINGS[: len(words)])
    if not right:
        raise HapticdError(f"{row.where}: response {row['response']!r} is not a ranking of {len(row.stimuli)} stimuli")
    return True
