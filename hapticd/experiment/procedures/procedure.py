"""The interface of adaptive procedures, which return levels, receive answers and estimate a threshold.

The state of a procedure is its parameters and its answers. `state` returns both as plain data. `restored` replays the
answers: the next level is then the same as without the restart.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Final, Generic, Self, TypeAlias, TypeVar

from pydantic import Field

from hapticd.base.errors import HapticdError
from hapticd.base.model import CheckedTogether
from hapticd.base.yaml_source import Json

Level: TypeAlias = Annotated[float, Field(ge=-1e9, le=1e9)]
Proportion: TypeAlias = Annotated[float, Field(ge=0, le=1)]
LEVEL_TOLERANCE: Final = 1e-9
"""Two levels count as equal within this relative tolerance: one may have been written to a file or converted."""


class ProcedureError(HapticdError):
    """An answer or a stored state is not valid for a procedure."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """An estimated threshold and the ends of its 95 % interval, in the unit of the level."""

    threshold: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Answer:
    """The level of a trial, and whether the answer was positive."""

    level: float
    positive: bool


def answers_of(state: Json) -> tuple[Json, list[Answer]]:
    """Return the parameters (plain data) and the answers in the state of a procedure.

    Raises ProcedureError for an invalid state.
    """
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
    """Return `expected`, the next level of a procedure.

    Raises ProcedureError if the level `given` is another one, or if `expected` is None: the procedure has ended.
    """
    if expected is None:
        raise ProcedureError("the procedure has ended: no more answers are accepted")
    if abs(given - expected) > LEVEL_TOLERANCE * max(abs(expected), abs(given)):
        raise ProcedureError(f"the answer is to level {given:g}, but level {expected:g} was shown")
    return expected


P = TypeVar("P", bound=CheckedTogether)


class Procedure(ABC, Generic[P]):
    """The base class of adaptive procedures, whose state consists of parameters and answers."""

    PARAMETERS: ClassVar[type[Any]]

    def __init__(self, parameters: P) -> None:
        self.parameters = parameters
        self.answers: list[Answer] = []

    @abstractmethod
    def level(self) -> float | None:
        """Return the level of the next trial, or None if the procedure has ended."""

    def answer(self, level: float, positive: bool) -> None:
        """Receive the answer to a level; a correct answer is positive.

        Raises ProcedureError if `level` is not the next one or the procedure has ended. QuestPlus accepts each of its
        levels at any time.
        """
        self._take(self._due(level), positive)

    def state(self) -> Json:
        """Return the state of the procedure, parameters and answers, as plain data."""
        return {
            "parameters": self.parameters.to_dict(),
            "answers": [[each.level, each.positive] for each in self.answers],
        }

    @classmethod
    def restored(cls, state: Json) -> Self:
        """Return the procedure that has this state. Raises ProcedureError or InvalidError for an invalid state."""
        parameters, answers = answers_of(state)
        made = cls(cls.PARAMETERS.model_validate(parameters))
        for each in answers:
            made._take(made._due(each.level), each.positive)
        return made

    @abstractmethod
    def estimate(self) -> Estimate:
        """Return the estimated threshold with its interval. Raises ProcedureError without answers."""

    def _due(self, given: float) -> float:
        """Return the next level of the procedure. Raises ProcedureError if `given` is another level."""
        return check_level(given, self.level())

    @abstractmethod
    def _take(self, shown: float, positive: bool) -> None:
        """Store the answer to the level `shown`, and update the next level."""
