"""Who answers and who watches: what the runner shows, and what it is told.

`Shown` is all that the participant's side gets. It holds places and answers, and no name of a stimulus, a material, a
factor or a condition.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal, Protocol, TypeAlias

from hapticd.base.yaml_source import Json
from hapticd.experiment.stage import Stage

CLEAR_S: Final = 0.05
"""Between two looks whether the handle is out of everything."""
CommandKind: TypeAlias = Literal["pause", "repeat", "abort", "note"]
QuestionKind: TypeAlias = Literal["choice", "ranking", "slider", "number", "text", "measure"]


@dataclass(frozen=True, slots=True)
class Seen:
    """A surface as the participant sees it: where it is and which way it faces."""

    point_m: tuple[float, float]
    normal: tuple[float, float]
    half_m: float
    """How far it goes either way from its point."""

    def from_surface(self, position_m: tuple[float, float]) -> tuple[float, float]:
        """How far a position is beyond the surface's end, and how far above the surface, in m. Behind it is
        negative."""
        (x, y), (p_x, p_y), (n_x, n_y) = position_m, self.point_m, self.normal
        along = (x - p_x) * n_y - (y - p_y) * n_x
        return max(0.0, abs(along) - self.half_m), (x - p_x) * n_x + (y - p_y) * n_y


@dataclass(frozen=True, slots=True)
class Choice:
    """One of the answers that are offered."""

    name: str
    label: str
    key: str | None
    means: str | None
    """The position that it names: first, second, ..., or same."""


@dataclass(frozen=True, slots=True)
class Shown:
    """A trial as the participant gets it."""

    number: int
    """Counted from 1 over the session."""
    total: int
    at_most: bool
    """Whether the session may end before so many: a procedure has found what it looks for."""
    phase: str
    stimuli: int
    """How many stimuli there are, side by side or one after the other."""
    in_places: bool
    """Whether they are side by side."""
    surfaces: tuple[Seen, ...]
    """Where each of them is, in the order of presentation."""
    text: str
    kind: QuestionKind
    answers: tuple[Choice, ...] = ()
    low: float | None = None
    high: float | None = None
    step: float | None = None
    """Between two values of a slider."""
    ends: tuple[str | None, str | None] = (None, None)
    """What stands at the left and the right end of a slider."""
    most_characters: int | None = None
    time_limit_s: float | None = None

    def surfaces_of(self, interval: int) -> Sequence[Seen]:
        """All of them side by side; else that of an interval, counted from 1."""
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
    right: int
    """Correct answers so far."""


@dataclass(frozen=True, slots=True)
class Reply:
    """What the participant answered: the answer's name, positions in order, a number or a text; None: the motion
    itself is the answer, or time was up."""

    answer: str | float | None
    timed_out: bool = False


@dataclass(frozen=True, slots=True)
class Command:
    """What the experimenter wants."""

    kind: CommandKind
    text: str = ""


class Front(Protocol):
    """The participant and the experimenter."""

    def begin(self, title: str, instructions: str, done: int, total: int, at_most: bool) -> Command | None:
        """Before the first trial of a run: title, instructions, and how much is done already. `at_most`: fewer trials
        than `total` may be needed."""

    def phase(self, phase: str, instructions: str | None) -> Command | None:
        """Before the first trial of a phase."""

    def ready(self, shown: Shown, watched: Watched) -> Command | None:
        """The trial is armed; returns when the experimenter lets the forces on."""

    def withdraw(self, shown: Shown, interval: int, stage: Stage) -> Command | None:
        """The handle is inside something, or behind a membrane, of the scene of an interval, counted from 1; returns
        once `stage.is_clear`, which it asks every CLEAR_S."""

    def may_enable(self) -> Command | None:
        """Asked just before the forces are switched on, and just after: what speaks against it, or None."""

    def explore(self, shown: Shown, interval: int, stage: Stage) -> Command | None:
        """An interval that is not the last, counted from 1; returns when the participant goes on to the next."""

    def ask(self, shown: Shown, stage: Stage) -> Reply | Command:
        """The last interval and the question. Calls `stage.check` while it waits."""

    def feedback(self, told: str, right: str | None) -> None:
        """What the participant is told after a trial. `right`: the name of the correct answer, where `told` gives it
        away."""

    def not_done(self, trial: int, why: str) -> None:
        """A motor task was not done, and begins again. `trial` counts from 1; participant and experimenter are told."""

    def answered(self, watched: Watched, answer: Json, correct: bool | None, response_s: float) -> None:
        """An answer is on disk. `response_s`: from the beginning of the last interval to the answer."""

    def rest(self, text: str | None, least_s: float) -> Command | None:
        """A break, which lasts `least_s` more at least; returns when the participant goes on."""

    def paused(self) -> Command | None:
        """The experimenter paused; returns when it goes on."""

    def tell(self, line: str) -> None:
        """One line for the experimenter."""
