"""The content of the experimenter's page: state of the session, and saved answers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Final, Literal, TypeAlias, cast

from hapticd.base.yaml_source import Json
from hapticd.experiment.front import Watched
from hapticd.experiment.plan import PlannedTrial
from hapticd.experiment.session_log import Record

Doing: TypeAlias = Literal["begins", "reads", "armed", "withdraws", "felt", "rests", "paused", "over"]
MAX_CONSOLE_LINES: Final = 200
"""The page shows at most this many lines of the log, the newest ones."""


@dataclass(frozen=True, slots=True)
class Row:
    """An answer that was saved, as the experimenter's page lists it."""

    trial: int
    """Index of the trial in the plan, from 0."""
    condition: str
    cell: str
    stimuli: tuple[str, ...]
    answer: Json
    correct: bool | None
    response_s: float

    def to_dict(self) -> dict[str, Any]:
        """Return the answer as JSON data."""
        return asdict(self)


@dataclass(slots=True)
class Console:
    """The state of a session, as the experimenter's page shows it."""

    title: str
    participant: str
    session: int
    total: int
    at_most: bool
    """Whether the session may need fewer trials than `total`."""
    done: int = 0
    doing: Doing = "begins"
    screen: int = 0
    """Number of the screen that the participant sees."""
    goes_on: str | None = None
    """Label of the button to continue, or None if the button is disabled."""
    trial: Watched | None = None
    phase: str = ""
    asked: str = ""
    """Text of the question that the participant reads, in Markdown."""
    here: dict[str, bool] = field(default_factory=lambda: {"participant": False, "experimenter": False})
    auto: bool = False
    """Whether trials begin automatically."""
    lines: list[str] = field(default_factory=list)

    def to_dict(self) -> dict[str, Any]:
        """Return the state of the session as JSON data, for the experimenter's page."""
        return asdict(self)

    def say(self, line: str) -> None:
        """Append a line to the log on the experimenter's page."""
        self.lines = [*self.lines, line][-MAX_CONSOLE_LINES:]


def rows_of(records: Sequence[Record], trials: Sequence[PlannedTrial]) -> list[Row]:
    """Return the answers in the records of a session's log, as rows of the experimenter's page."""
    started: dict[object, Mapping[str, Json]] = {}
    rows = []
    for record in records:
        if record["kind"] == "trial_started":
            started[record["trial"]] = record
        elif record["kind"] == "answer":
            index, correct = cast(int, record["trial"]), record["correct"]
            stimuli = cast("list[dict[str, str]]", started[index]["stimuli"])
            rows.append(
                Row(
                    index,
                    trials[index].condition,
                    trials[index].cell,
                    tuple(each["name"] for each in stimuli),
                    record["answer"],
                    None if correct is None else bool(correct),
                    cast(float, record["response_time_s"]),
                )
            )
    return rows
