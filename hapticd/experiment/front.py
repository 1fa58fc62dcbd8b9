"""The interface of a front (user interface), which shows trials to participant and experimenter and returns replies.

What the participant sees comes from `Shown`, which has surfaces and answers, but no name of a stimulus, a material, a
factor or a condition.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal, Protocol, TypeAlias

from hapticd.base.yaml_source import Json
from hapticd.experiment.stage import Stage

CLEARANCE_POLL_S: Final = 0.05
"""Time between two checks whether the handle is out of every object (`Stage.is_clear`)."""
STAGE_CHECK_INTERVAL_S: Final = 0.5
"""Time between two checks that the forces are still on (`Stage.check`), while a front waits for the participant."""
CommandKind: TypeAlias = Literal["pause", "repeat", "abort", "note"]
COMMAND_KINDS: Final[tuple[CommandKind, ...]] = ("pause", "repeat", "abort", "note")
QuestionKind: TypeAlias = Literal["choice", "ranking", "slider", "number", "text", "measure"]


@dataclass(frozen=True, slots=True)
class Seen:
    """A surface as the participant sees it: a line segment around its middle `point_m`, and its unit normal."""

    point_m: tuple[float, float]
    normal: tuple[float, float]
    half_m: float
    """Half the length of the surface, m."""

    def from_surface(self, position_m: tuple[float, float]) -> tuple[float, float]:
        """Return the distance of a position beyond the nearer end of the surface, and its height above it, both in m.

        The distance is 0 between the ends. The height is negative behind the surface.
        """
        (x, y), (p_x, p_y), (n_x, n_y) = position_m, self.point_m, self.normal
        along = (x - p_x) * n_y - (y - p_y) * n_x
        return max(0.0, abs(along) - self.half_m), (x - p_x) * n_x + (y - p_y) * n_y


@dataclass(frozen=True, slots=True)
class Choice:
    """One of the answers to a question."""

    name: str
    label: str
    key: str | None
    means: str | None
    """Position of the stimulus that the answer names (first, second, ...), or same. None for other questions."""


@dataclass(frozen=True, slots=True)
class Shown:
    """A trial as the participant may see it, without names of stimuli, factors or conditions."""

    number: int
    """Number of the trial in the session, from 1."""
    total: int
    """Number of trials in the session."""
    at_most: bool
    """Whether fewer trials may be needed: a procedure can end by a criterion, and wrong answers can end the test."""
    phase: str
    stimuli: int
    in_places: bool
    """Whether the stimuli are side by side; if not, they follow one another in intervals."""
    surfaces: tuple[Seen, ...]
    """The surface of each stimulus, in the order of presentation."""
    text: str
    kind: QuestionKind
    answers: tuple[Choice, ...] = ()
    low: float | None = None
    high: float | None = None
    step: float | None = None
    """Difference between two neighbouring values of a slider."""
    ends: tuple[str | None, str | None] = (None, None)
    """Labels of the left and the right end of a slider."""
    most_characters: int | None = None
    time_limit_s: float | None = None

    def surfaces_of(self, interval: int) -> Sequence[Seen]:
        """Return all surfaces if they are side by side, else the surface of an interval, counted from 1."""
        return self.surfaces if self.in_places else self.surfaces[interval - 1 : interval]


@dataclass(frozen=True, slots=True)
class Watched:
    """A trial as the experimenter sees it."""

    index: int
    attempt: int
    condition: str
    cell: str
    stimuli: tuple[str, ...]
    correct: str | None
    level: float | None
    answered: int
    """Number of answers in the session until now."""
    right: int
    """Number of correct answers in the session until now."""


@dataclass(frozen=True, slots=True)
class Reply:
    """A reply of the participant.

    `answer` is the name of an answer, a ranking such as second>first, a number or a text. It is None if the motion
    itself is the answer, or if the time limit passed.
    """

    answer: str | float | None
    timed_out: bool = False


@dataclass(frozen=True, slots=True)
class Command:
    """A command of the experimenter; `text` is the text of a note."""

    kind: CommandKind
    text: str = ""


class Front(Protocol):
    """The user interface of participant and experimenter.

    A method that is interrupted by a command returns the Command. Otherwise it returns None, or a Reply (`ask`).
    """

    def begin(self, title: str, instructions: str, done: int, total: int, at_most: bool) -> Command | None:
        """Show title and instructions before the first trial of a run, and return when the session may begin.

        `done` of `total` trials are already done. With `at_most`, fewer than `total` may be needed.
        """

    def phase(self, phase: str, instructions: str | None) -> Command | None:
        """Show the instructions of a phase (practice, training or test), and return when the phase may begin."""

    def ready(self, shown: Shown, watched: Watched) -> Command | None:
        """Show a trial whose scene is loaded, and return when its forces may be switched on."""

    def withdraw(self, shown: Shown, interval: int, stage: Stage) -> Command | None:
        """Ask the participant to withdraw the handle from the objects of an interval, counted from 1.

        Returns when `stage.is_clear()` is true.
        """

    def may_enable(self) -> Command | None:
        """Return a command that forbids the forces, or None. Called just before and just after `stage.enable`."""

    def explore(self, shown: Shown, interval: int, stage: Stage) -> Command | None:
        """Present an interval that is not the last, counted from 1, and return when the participant ends it."""

    def ask(self, shown: Shown, stage: Stage) -> Reply | Command:
        """Present the last interval, ask the question and return the reply. Calls `stage.check` while it waits."""

    def feedback(self, text: str, right: str | None) -> None:
        """Show the participant the feedback on a trial.

        `right` is the name of the correct answer if the feedback reveals it, else None.
        """

    def not_done(self, trial: int, why: str) -> None:
        """Show participant and experimenter why a motor task was not done. Trial `trial`, from 1, begins again."""

    def answered(self, watched: Watched, answer: Json, correct: bool | None, response_s: float) -> None:
        """Show the experimenter an answer that is saved on disk.

        `response_s` is the time in s from the onset of the last interval to the answer.
        """

    def rest(self, text: str | None, least_s: float) -> Command | None:
        """Show a break, and return when the session is continued, at least `least_s` seconds later."""

    def paused(self) -> Command | None:
        """Show that the session is paused, and return when the experimenter continues."""

    def show_line(self, line: str) -> None:
        """Show one line to the experimenter."""
