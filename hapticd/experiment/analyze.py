"""The complete analysis of the sessions of one study.

Only answered trials of the test phase are used. If it has none, its trials with a measure of the motion are used. The
summary says how many trials are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from hapticd.base.errors import HapticdError
from hapticd.base.yaml_source import Json
from hapticd.experiment import answer_sections, measure_sections
from hapticd.experiment.behaviour import MEASURE_COLUMNS, Behaviour, Row, read_behaviour
from hapticd.experiment.published_tables import PublishedResults, published_results
from hapticd.experiment.results import ResultTable, Section

RANK_WORDS: Final = ("first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth", "ninth", "tenth")
"""Names of positions in the order of presentation; a ranking is an answer such as second>first>third."""


@dataclass(frozen=True, slots=True)
class Analysis:
    """The analysis of a study. `files` are the tables of answers that it used."""

    title: str
    summary: str
    sections: tuple[Section, ...]
    files: tuple[Path, ...]
    published: str | None
    """Name of the published results that the sessions are compared with, or None."""

    @property
    def tables(self) -> tuple[ResultTable, ...]:
        """The tables of all sections, in order."""
        return tuple(table for section in self.sections for table in section.tables)

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on results that could not be computed, with the reason."""
        return tuple(note for section in self.sections for note in section.notes)

    def to_dict(self) -> dict[str, Json]:
        """Return the analysis as JSON data, its tables by name."""
        tables: dict[str, Json] = {table.name: table.to_dict() for table in self.tables}
        return {
            "title": self.title,
            "summary": self.summary,
            "published": self.published,
            "tables": tables,
            "notes": list(self.notes),
            "files": [str(file) for file in self.files],
        }


def require() -> None:
    """Raise HapticdError if scipy, which the analysis needs, is not installed."""
    try:
        import scipy  # noqa: F401
    except ImportError:
        raise HapticdError("the analysis of experiments needs scipy: pip install 'hapticd[experiment]'") from None


def analyze(folders: Sequence[Path]) -> Analysis:
    """Analyze every session below the folders.

    Raises HapticdError if the tables cannot be read (see `behaviour.read_behaviour`), or no trial can be used.
    """
    require()
    return analysis_of(read_behaviour(folders))


def analysis_of(behaviour: Behaviour) -> Analysis:
    """Analyze the rows of sessions. Raises HapticdError if no trial can be used."""
    facts = behaviour.facts
    tested = [row for row in behaviour.rows if row["phase"] == "test"]
    answered = [row for row in tested if row.get("response") is not None]
    used = answered or [row for row in tested if any(row.get(name) is not None for name in MEASURE_COLUMNS)]
    if not used:
        raise HapticdError(
            f"nothing to analyze: none of {len(behaviour.rows)} trials is an answered trial of the test phase"
        )
    published = published_results(facts.published) if facts.published else PublishedResults()
    places = {name: place for place, name in enumerate(facts.conditions)}
    used.sort(key=lambda row: places.get(row["condition"], len(places)))
    sections = _sections(tested, used, behaviour, published)
    people = len({row["participant"] for row in used})
    left = len(tested) - len(used)
    counts = (_count(people, "participant"), _count(len(behaviour.files), "session"), _count(len(used), "trial"))
    summary = (
        f"{', '.join(counts)} of the test; {len(behaviour.rows) - len(tested)} of practice or training and {left} "
        "without an answer are left out"
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
        found.append(measure_sections.rankings([row for row in fixed if _is_ranking(row)], RANK_WORDS))
    if facts.trial_type == "rating":
        found.append(measure_sections.ratings(answers))
    found.append(measure_sections.motions(used, facts, published))
    fixed_judged = [row for row in judged if row.get("level") is None]
    if fixed_judged:
        found.append(answer_sections.cells(fixed_judged, facts))
    return found


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'s' * (number != 1)}"


def _is_ranking(row: Row) -> bool:
    words = row["response"].split(">")
    right = len(words) == len(row.stimuli) and set(words) == set(RANK_WORDS[: len(words)])
    if not right:
        raise HapticdError(f"{row.where}: response {row['response']!r} is not a ranking of {len(row.stimuli)} stimuli")
    return True
