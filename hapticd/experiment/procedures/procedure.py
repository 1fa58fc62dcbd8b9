"""What every adaptive procedure is: it gives levels, takes answers, can be stored and restored, and estimates a
threshold.

A procedure keeps its parameters and its answers, and nothing else: `state` is plain data of both, and `restored` gives
the answers anew. So the level that follows a restart is the one that would have followed without it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Final, Generic, Protocol, Self, TypeAlias, TypeVar

from pydantic import Field

from hapticd.base.errors import HapticdError
from hapticd.base.yaml_source import Json

Level: TypeAlias = Annotated[float, Field(ge=-1e9, le=1e9)]
Proportion: TypeAlias = Annotated[float, Field(ge=0, le=1)]
LEVEL_TOLERANCE: Final = 1e-9
"""Relative: a level that went through a file, a scene or a unit is the same within it."""


class ProcedureError(HapticdError):
    """An answer or a state that a procedure cannot take; one line."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """A threshold and the ends of its 95 % interval, in the unit of the level."""

    threshold: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Answer:
    """The level that was shown, and whether the answer was a positive one."""

    level: float
    positive: bool


class Procedure(Protocol):
    """Staircase, QuestPlus and ConstantStimuli."""

    def level(self) -> float | None:
        """The next level; None when the procedure has ended."""

    def answer(self, level: float, positive: bool) -> None:
        """Takes whether the answer to a level was positive (correct). Raises ProcedureError for another level than was
        due, and at the end."""

    def state(self) -> Json:
        """Parameters and answers as plain data."""

    @classmethod
    def restored(cls, state: Json) -> Self:
        """Raises ProcedureError (or InvalidError) for what `state` did not give."""

    def estimate(self) -> Estimate:
        """Raises ProcedureError without answers."""


def answers_of(state: Json) -> tuple[Json, list[Answer]]:
    """Parameters as plain data, and the answers. Raises ProcedureError."""
    if not isinstance(state, dict) or set(state) != {"parameters", "answers"} or not isinstance(state["answers"], list):
        raise ProcedureError("state of a procedure: must be a mapping of parameters and answers")
    answers = []
    for index, each in enumerate(state["answers"]):
        match each:
            case [float() | int() as level, bool() as positive] if not isinstance(level, bool):
                answers.append(Answer(float(level), positive))
            case _:
                raise ProcedureError(f"state of a procedure: answers[{index}] must be a level and true or false")
    return state["parameters"], answers


def check_level(given: float, expected: float | None) -> float:
    """The level that was due. Raises ProcedureError for another one, and where none was due."""
    if expected is None:
        raise ProcedureError("the procedure has ended: it takes no more answers")
    if abs(given - expected) > LEVEL_TOLERANCE * max(abs(expected), abs(given)):
        raise ProcedureError(f"the answer is to level {given:g}, but {expected:g} was due")
    return expected


class Parameters(Protocol):
    """What the parameters of every procedure have."""

    def to_dict(self) -> dict[str, Json]: ...


P = TypeVar("P", bound=Parameters)


class Kept(ABC, Generic[P]):
    """A procedure as it is kept: its parameters and its answers are all of its state."""

    PARAMETERS: ClassVar[type[Any]]
    """The model of its parameters."""

    def __init__(self, parameters: P) -> None:
        self.parameters = parameters
        self.answers: list[Answer] = []

    @abstractmethod
    def level(self) -> float | None:
        """The next level; None when the procedure has ended."""

    def answer(self, level: float, positive: bool) -> None:
        """Raises ProcedureError for another level than was due, and at the end."""
        self._take(self._due(level), positive)

    def state(self) -> Json:
        """Parameters and answers."""
        return {
            "parameters": self.parameters.to_dict(),
            "answers": [[each.level, each.positive] for each in self.answers],
        }

    @classmethod
    def restored(cls, state: Json) -> Self:
        """Raises ProcedureError or InvalidError."""
        parameters, answers = answers_of(state)
        made = cls(cls.PARAMETERS.model_validate(parameters))
        for each in answers:
            made._take(made._due(each.level), each.positive)
        return made

    def _due(self, given: float) -> float:
        """The level that an answer is to. Raises ProcedureError for one that was not due."""
        return check_level(given, self.level())

    @abstractmethod
    def _take(self, shown: float, positive: bool) -> None:
        """Keeps an answer, and goes on from it."""
