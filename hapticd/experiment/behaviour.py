"""Answers from the tables of sessions (`*_beh.tsv`), and facts about the study from a session's study.yaml.

A row is a trial. A missing value is `n/a` (BIDS).
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from hapticd.base.errors import HapticdError, quoted
from hapticd.base.yaml_source import Json, load_path
from hapticd.config.schema import unit_of
from hapticd.experiment.bids import TASK_IN_FILE_NAME
from hapticd.experiment.measures import MOTION_MEASURES
from hapticd.experiment.session_folder import LOG_FILE_NAME, STUDY_FILE_NAME

MISSING_CELL: Final = "n/a"
"""Text of a cell without a value, as BIDS prescribes."""
REQUIRED_COLUMNS: Final = ("participant", "phase", "condition", "cell", "response", "correct")
"""Columns without which a table is rejected."""
MEASURE_COLUMNS: Final = (*MOTION_MEASURES, "response_time")
"""Columns with a numeric measure of a trial. The name ends with the unit; response_time is in s."""
_MAX_STUDY_FOLDER_LEVELS: Final = 3
"""Number of folders in which study.yaml is searched, from a table upwards: beh/, the session's, the participant's."""


@dataclass(frozen=True, slots=True)
class Row:
    """A row of a table of answers: a trial."""

    cells: Mapping[str, str]
    """The cells as text, by column, without missing cells."""
    where: str
    """File and line of the row."""

    def __getitem__(self, name: str) -> str:
        found = self.cells.get(name)
        if found is None:
            raise HapticdError(f"{self.where}: no value in the column {name}")
        return found

    def get(self, name: str) -> str | None:
        """Return the cell in the column `name` as text, or None if it is missing."""
        return self.cells.get(name)

    def number(self, name: str) -> float | None:
        """Return the cell in the column `name` as a number, or None if it is missing.

        Raises HapticdError if the cell is not a number.
        """
        text = self.cells.get(name)
        if text is None:
            return None
        try:
            return float(text)
        except ValueError:
            raise HapticdError(f"{self.where}: {name} must be a number or {MISSING_CELL}, is {quoted(text)}") from None

    @property
    def stimuli(self) -> tuple[str, ...]:
        """The names of the trial's stimuli, in the order of presentation."""
        found: list[str] = []
        while (name := self.cells.get(f"stimulus_{len(found) + 1}")) is not None:
            found.append(name)
        return tuple(found)

    @property
    def right(self) -> bool | None:
        """Whether the answer was correct; None if the study defines no correct answer."""
        text = self.cells.get("correct")
        if text not in (None, "0", "1"):
            raise HapticdError(f"{self.where}: correct must be 1, 0 or {MISSING_CELL}, is {quoted(text)}")
        return None if text is None else text == "1"


@dataclass(frozen=True, slots=True)
class Varied:
    """The quantity that an adaptive procedure varies, and how the answers depend on it.

    Within a condition and a cell, procedures with equal `Varied` are fitted by one psychometric function.
    """

    variable: str | None = None
    """Name of the quantity, which ends with its unit."""
    at: tuple[str, ...] = ()
    """Paths of the keys of the configuration that are set to the value of the quantity."""
    reference: float | None = None
    """Value of the quantity in the stimuli that the target is compared with."""
    level: str = "value"
    """Meaning of the level: "value", "added" (to the reference) or "factor" (multiplies the reference)."""
    logarithmic: bool = False
    rising: bool = True
    """Whether the probability of a correct answer grows with the level."""
    guess: float = 0.0
    """Probability of a correct answer by guessing."""

    @property
    def unit(self) -> str:
        """The unit of the level, for axes and tables."""
        if self.level == "factor":
            return "ratio"
        return (unit_of(self.variable) if self.variable else None) or "units of the variable"


@dataclass(frozen=True, slots=True)
class StudyFacts:
    """Facts about a study that the analysis of its sessions needs."""

    title: str
    trial_type: str | None = None
    chance: float | None = None
    published: str | None = None
    varied: Mapping[str, Varied] = field(default_factory=dict)
    """The varied quantity of each adaptive procedure, by the name of the procedure."""
    staircases: Mapping[str, Mapping[str, Json]] = field(default_factory=dict)
    """The parameters (`method`) of each procedure that is a staircase, by the name of the procedure."""
    crossed: bool = False
    """Whether cells are combinations of levels (trial.cross). If not, an adaptive procedure is a cell."""
    conditions: tuple[str, ...] = ()
    """Names of the conditions, in the order of the study."""
    items: tuple[str, ...] = ()
    """Levels of all factors, in the order of the study."""
    meanings: Mapping[str, str] = field(default_factory=dict)
    """The position that an answer means (first, second, ...), or same; by the name of the answer."""
    levels: Mapping[str, str] = field(default_factory=dict)
    """The level that an answer names in an identification, by the name of the answer."""


@dataclass(frozen=True, slots=True)
class Behaviour:
    """The answers of all sessions of one study."""

    facts: StudyFacts
    rows: tuple[Row, ...]
    files: tuple[Path, ...]
    columns: tuple[str, ...]


def read_behaviour(folders: Sequence[Path]) -> Behaviour:
    """Read the tables of answers in the folders and their subfolders.

    Raises HapticdError if there is no table, if one is invalid, or if the tables belong to several studies.
    """
    files = sorted({file.resolve(): file for folder in folders for file in _tables(folder)}.values())
    tasks = sorted({match[1] if (match := TASK_IN_FILE_NAME.search(file.name)) else file.name for file in files})
    if len(tasks) > 1:
        raise HapticdError(f"tables of {len(tasks)} studies ({', '.join(tasks)}); give the folders of one study only")
    rows = [row for file in files for row in _rows(file)]
    columns = tuple(dict.fromkeys(name for row in rows for name in row.cells))
    return Behaviour(_facts(files, tasks[0]), tuple(rows), tuple(files), columns)


def _tables(folder: Path) -> list[Path]:
    if folder.is_file():
        return [folder]
    if not folder.is_dir():
        raise HapticdError(f"{folder}: no such folder; give the folder of a session, a participant or a data set")
    found = sorted(folder.rglob("*_beh.tsv"))
    if not found and any(folder.rglob(LOG_FILE_NAME)):
        raise HapticdError(
            f"{folder}: its sessions were interrupted before their tables were written; "
            "run `hapticd experiment resume`, which writes them when it ends or stops"
        )
    if not found:
        raise HapticdError(
            f"{folder}: contains no *_beh.tsv; give the folder of a session, a participant or a data set"
        )
    return found


def _rows(file: Path) -> Iterator[Row]:
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise HapticdError(f"{file}: cannot be read: {error}") from None
    lines = csv.reader(io.StringIO(text), delimiter="\t", quoting=csv.QUOTE_NONE)
    head = next(lines, [])
    lacking = [name for name in REQUIRED_COLUMNS if name not in head]
    if lacking:
        raise HapticdError(f"{file}:1: not a table of answers: no column {', '.join(lacking)}")
    for number, cells in enumerate(lines, 2):
        if len(cells) != len(head):
            raise HapticdError(f"{file}:{number}: has {len(cells)} cells, must have {len(head)} as the header")
        present = {name: cell for name, cell in zip(head, cells, strict=True) if cell != MISSING_CELL}
        row = Row(present, f"{file}:{number}")
        for name in ("participant", "phase", "condition", "cell"):
            row[name]
        yield row


def _facts(files: Sequence[Path], task: str) -> StudyFacts:
    for file in files:
        for folder in list(file.resolve().parents)[:_MAX_STUDY_FOLDER_LEVELS]:
            if (folder / STUDY_FILE_NAME).is_file():
                data = load_path(folder / STUDY_FILE_NAME).data
                return facts_of(data if isinstance(data, dict) else {}, task)
    return facts_of({}, task)


def facts_of(study: Mapping[str, Json], task: str) -> StudyFacts:
    """Return the facts about a study from the content of its YAML, with defaults for missing keys.

    `task`, the label in the names of its tables, replaces a missing title.
    """
    trial, analysis, questions = (_mapping(study.get(key)) for key in ("trial", "analysis", "questions"))
    asked = _mapping(questions.get(str(trial.get("question")), next(iter(questions.values()), None)))
    answers = asked.get("answers")
    listed = [_mapping(each) for each in answers] if isinstance(answers, list) else []
    meanings = {str(each["name"]): str(each["means"]) for each in listed if "name" in each and "means" in each}
    named = {str(each["name"]): _text(each["level"]) for each in listed if "name" in each and "level" in each}
    methods = {name: _mapping(_mapping(each).get("method")) for name, each in _mapping(trial.get("procedures")).items()}
    items = []
    for factor in _mapping(study.get("factors")).values():
        levels = _mapping(factor).get("levels", _mapping(factor).get("variants"))
        items += [_text(each) for each in levels] if isinstance(levels, list | dict) else []
    chance, title, kind = analysis.get("chance"), study.get("title"), trial.get("type")
    published = analysis.get("published")
    return StudyFacts(
        title=title if isinstance(title, str) else task,
        trial_type=kind if isinstance(kind, str) else None,
        chance=float(chance) if isinstance(chance, int | float) else None,
        published=published if isinstance(published, str) else None,
        varied={name: _varied(_mapping(each), chance) for name, each in _mapping(trial.get("procedures")).items()},
        staircases={name: method for name, method in methods.items() if method.get("kind") == "staircase"},
        crossed=bool(trial.get("cross")),
        conditions=tuple(_mapping(study.get("conditions"))),
        items=tuple(items),
        meanings=meanings,
        levels=named,
    )


def _varied(procedure: Mapping[str, Json], chance: Json) -> Varied:
    variable, method = _mapping(procedure.get("variable")), _mapping(procedure.get("method"))
    name, at = variable.get("name"), variable.get("at")
    guesses = method.get("guesses")
    guess = guesses[0] if isinstance(guesses, list) and len(guesses) == 1 else method.get("guess", chance)
    reference = variable.get("reference")
    # The defaults of the axis are those of experiment.procedures.
    axis = method.get("axis", "logarithmic" if method.get("kind") == "quest_plus" else "linear")
    return Varied(
        variable=name if isinstance(name, str) else None,
        at=tuple(map(str, at)) if isinstance(at, list) else (str(at),),
        reference=float(reference) if isinstance(reference, int | float) else None,
        level=str(variable.get("level", "value")),
        logarithmic=axis == "logarithmic",
        rising=method.get("harder") != "higher" and method.get("rising") is not False,
        guess=float(guess) if isinstance(guess, int | float) else 0.0,
    )


def _mapping(value: object) -> dict[str, Json]:
    return value if isinstance(value, dict) else {}


def _text(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
