"""QUEST+: the level whose answer is expected to tell most of a psychometric function (Watson, "QUEST+: A general
multidimensional Bayesian adaptive psychometric method", Journal of Vision 17(3):10, 2017).

The posterior stands on a grid of thresholds, slopes, guesses and lapses, all equally probable at first. The next level
is the one with the least expected entropy; of several alike the first in the list.
"""

from __future__ import annotations

from functools import cached_property
from typing import Annotated, Literal, TypeAlias

import numpy as np
from pydantic import BeforeValidator, Field, ValidationError

from hapticd.base.model import CheckedTogether, problems_of
from hapticd.experiment.analysis.psychometric_shapes import Floats, Shape, axis, is_logarithmic, probability
from hapticd.experiment.analysis.psychometric_shapes import level as level_at
from hapticd.experiment.procedures.posterior import expected_entropies, marginal, summary, updated
from hapticd.experiment.procedures.procedure import (
    LEVEL_TOLERANCE,
    Answer,
    Estimate,
    Kept,
    Level,
    ProcedureError,
    Proportion,
)

MOST_CELLS = 2_000_000
"""Levels times grid points: 16 MB a table."""


class LevelGrid(CheckedTogether):
    """Values that are equally far from one another, on a linear or a logarithmic axis."""

    least: Level
    most: Level
    count: Annotated[int, Field(ge=2, le=1000)]
    axis: Literal["linear", "logarithmic"] = "linear"

    def cross_faults(self) -> list[str]:
        faults = []
        if not self.least < self.most:
            faults.append(f"least ({self.least:g}) must be less than most ({self.most:g})")
        if self.axis == "logarithmic" and self.least <= 0:
            faults.append("least must be more than 0 on a logarithmic axis")
        return faults

    @property
    def values(self) -> Floats:
        space = np.geomspace if self.axis == "logarithmic" else np.linspace
        return np.asarray(space(self.least, self.most, self.count), dtype=float)


def _spread(given: object) -> object:
    """A LevelGrid as the list of its values; lists as they are."""
    if not isinstance(given, dict):
        return given
    try:
        return LevelGrid.parsed(given).values.tolist()
    except ValidationError as error:
        raise ValueError("; ".join(map(str, problems_of(error)))) from None


Values: TypeAlias = Annotated[
    tuple[Level, ...], BeforeValidator(_spread), Field(min_length=1, max_length=1000, strict=False)
]
"""A list of values, or a LevelGrid, which becomes one."""


class QuestPlusParameters(CheckedTogether):
    """QUEST+, as a study's YAML has it."""

    kind: Literal["quest_plus"] = "quest_plus"
    levels: Values
    """That may be shown."""
    thresholds: Values | None = None
    """As the levels without them."""
    slopes: Values
    """See psychometric_shapes: of a Weibull function its exponent, else 1 over the spread on the axis."""
    guesses: Annotated[tuple[Proportion, ...], Field(min_length=1, max_length=100, strict=False)] = (0.0,)
    lapses: Annotated[tuple[Proportion, ...], Field(min_length=1, max_length=100, strict=False)] = (0.02,)
    shape: Shape = "weibull"
    axis: Literal["linear", "logarithmic"] = "logarithmic"
    trials: Annotated[int, Field(ge=1, le=10000)] = 60
    """It ends after so many answers,"""
    precision: Annotated[float, Field(gt=0, lt=1)] | None = None
    """or when half the 95 % interval of the threshold is at most this part of it."""

    def cross_faults(self) -> list[str]:
        faults = []
        axes = [np.array(self.levels), self.threshold_values, np.array(self.slopes)]
        for name, values in zip(("levels", "thresholds", "slopes"), axes, strict=True):
            if not (np.diff(values) > 0).all():
                faults.append(f"{name} must rise")
            elif name != "slopes" and self.logarithmic and values[0] <= 0:
                faults.append(f"{name} must be more than 0 on a logarithmic axis")
        if max(self.guesses) + max(self.lapses) >= 1:
            faults.append("the largest guess and the largest lapse must together be less than 1")
        cells = int(np.prod([len(each) for each in axes])) * len(self.guesses) * len(self.lapses)
        if cells > MOST_CELLS:
            faults.append(f"levels times thresholds, slopes, guesses and lapses are {cells}; {MOST_CELLS} are the most")
        if 0 in self.slopes:
            faults.append("slopes must not hold 0: such a function says nothing of a threshold")
        return faults

    @property
    def logarithmic(self) -> bool:
        return is_logarithmic(self.shape, self.axis == "logarithmic")

    @property
    def threshold_values(self) -> Floats:
        return np.array(self.levels if self.thresholds is None else self.thresholds, dtype=float)


class QuestPlus(Kept[QuestPlusParameters]):
    """One run of QUEST+; see `procedure.Procedure`."""

    PARAMETERS = QuestPlusParameters

    def __init__(self, parameters: QuestPlusParameters) -> None:
        super().__init__(parameters)
        self.levels: Floats = np.array(parameters.levels, dtype=float)
        slopes = parameters.slopes
        self.grid_shape = (
            len(parameters.threshold_values),
            len(slopes),
            len(parameters.guesses),
            len(parameters.lapses),
        )
        points = int(np.prod(self.grid_shape))
        self.posterior: Floats = np.full(points, 1.0 / points)
        """(g,) over thresholds, slopes, guesses and lapses, the last fastest."""

    @cached_property
    def table(self) -> Floats:
        """(l, g) probability of a positive answer."""
        given = self.parameters
        thresholds, slopes, guesses, lapses = np.meshgrid(
            given.threshold_values, given.slopes, given.guesses, given.lapses, indexing="ij", sparse=True
        )
        shown = self.levels[:, None, None, None, None]
        found = probability(given.shape, shown, thresholds, slopes, guesses, lapses, given.logarithmic)
        return found.reshape(len(self.levels), -1)

    def level(self) -> float | None:
        """The level that is expected to tell most; None at the end."""
        given = self.parameters
        if len(self.answers) >= given.trials or (given.precision is not None and self._precise(given.precision)):
            return None
        return float(self.levels[int(np.argmin(expected_entropies(self.posterior, self.table)))])

    def estimate(self) -> Estimate:
        """Posterior mean (on the axis) and 95 % interval of the threshold. Raises ProcedureError without answers."""
        if not self.answers:
            raise ProcedureError("QUEST+ has no answers: nothing can be estimated")
        on_log = self.parameters.logarithmic
        places = axis(self.parameters.threshold_values, on_log)
        weights = marginal(self.posterior, self.grid_shape, 0)
        return Estimate(*summary(places, weights, lambda place: level_at(place, on_log)))

    def _precise(self, precision: float) -> bool:
        if not self.answers:
            return False
        found = self.estimate()
        return found.high - found.low <= 2 * precision * abs(found.threshold)

    def _due(self, given: float) -> float:
        """Any of the levels, at the end, too: `_take` refuses another one."""
        return given

    def _take(self, shown: float, positive: bool) -> None:
        place = int(np.argmin(np.abs(self.levels - shown)))
        near = float(self.levels[place])
        if abs(near - shown) > LEVEL_TOLERANCE * abs(near):
            raise ProcedureError(
                f"the answer is to level {shown:g}, which is none of QUEST+'s; {near:g} is the nearest"
            )
        likelihood = self.table[place] if positive else 1.0 - self.table[place]
        if not float(np.sum(self.posterior * likelihood)) > 0:
            raise ProcedureError(f"this answer to level {near:g} is impossible with any parameters: allow for lapses")
        self.posterior = updated(self.posterior, likelihood)
        self.answers.append(Answer(near, positive))
