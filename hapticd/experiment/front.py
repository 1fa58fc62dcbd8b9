"""The interface of a front: it shows trials to participant and experimenter, and returns replies to the runner.

The participant's part receives only `Shown`. It contains surfaces and answers, but no name of a stimulus, a material, a
factor or a condition.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal, Protocol, TypeAlias

from hapticd.base.yaml_source import Json
from hapticd.experiment.stage import Stage

CLEARANCE_POLL_S: Final = 0.05
"""Time between two checks whether the handle is clear of every object."""
CommandKind: TypeAlias = Literal["pause", "repeat", "abort", "note"]
QuestionKind: TypeAlias = Literal["choice", "ranking", "slider", "number", "text", "measure"]


@dataclass(frozen=True, slots=True)
class Seen:
    """A surface as the participant sees it: a line segment through a point, and its normal."""

    point_m: tuple[float, float]
    normal: tuple[float, float]
    half_m: float
    """Half the length of the surface, m."""

    def from_surface(self, position_m: tuple[float, float]) -> tuple[float, float]:
        """Return how far a position is beyond the nearer end of the surface, and how far above the surface, in m.

        The distance beyond the end is at least 0. The height is negative behind the surface.
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
    """Position of the stimulus that the answer means: first, second, ..., or same; None for other questions."""


@dataclass(frozen=True, slots=True)
class Shown:
    """A trial as the participant may see it, without names of stimuli, factors or conditions."""

    number: int
    """Number of the trial in the session, from 1."""
    total: int
    """Number of trials in the session."""
    at_most: bool
    """Whether the session may end before `total` trials: by the criterion of a procedure, or by a stop rule."""
    phase: str
    stimuli: int
    """Number of stimuli."""
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

    `answer` is the name of an answer, positions in order, a number or a text; None if the motion itself is the answer,
    or the time limit passed.
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

    A method that returns a Command was interrupted by this command of the experimenter; else it returns None.
    """

    def begin(self, title: str, instructions: str, done: int, total: int, at_most: bool) -> Command | None:
        """Show title and instructions before the first trial of a run, and return when the participant begins.

        `done` of `total` trials are already done. With `at_most`, fewer than `total` may be needed.
        """

    def phase(self, phase: str, instructions: str | None) -> Command | None:
        """Show the instructions of practice, training or test, and return when the participant begins this phase."""

    def ready(self, shown: Shown, watched: Watched) -> Command | None:
        """Show a trial whose scene is loaded, and return when its forces may be switched on."""

    def withdraw(self, shown: Shown, interval: int, stage: Stage) -> Command | None:
        """Ask the participant to withdraw the handle from the objects of an interval, counted from 1.

        Returns when `stage.is_clear()`, which is polled every CLEARANCE_POLL_S.
        """

    def may_enable(self) -> Command | None:
        """Return a command that forbids the forces, or None. Called just before and just after they are switched on."""

    def explore(self, shown: Shown, interval: int, stage: Stage) -> Command | None:
        """Present an interval that is not the last, counted from 1, and return when the participant ends it."""

    def ask(self, shown: Shown, stage: Stage) -> Reply | Command:
        """Present the last interval, ask the question and return the reply. Calls `stage.check` while it waits."""

    def feedback(self, text: str, right: str | None) -> None:
        """Show the participant the feedback on a trial.

        `right` is the name of the correct answer if the feedback reveals it, else None.
        """

    def not_done(self, trial: int, why: str) -> None:
        """Report to participant and experimenter that a motor task was not done and begins again.

        `trial` counts from 1.
        """

    def answered(self, watched: Watched, answer: Json, correct: bool | None, response_s: float) -> None:
        """Report an answer that was saved on disk.

        `response_s` is the time from the onset of the last interval, in s.
        """

    def rest(self, text: str | None, least_s: float) -> Command | None:
        """Show a break that lasts at least `least_s` more seconds. Return when the participant continues."""

    def paused(self) -> Command | None:
        """Show that the session is paused, and return when the experimenter continues."""

    def tell(self, line: str) -> None:
        """Show one line to the experimenter."""
