"""QUEST+: shows the level after whose answer the smallest entropy of the parameters is expected.

Watson, "QUEST+: A general multidimensional Bayesian adaptive psychometric method", Journal of Vision 17(3):10, 2017.
The parameters of a psychometric function have a uniform prior on a grid of thresholds, slopes, guesses and lapses. Of
several levels with the smallest expected entropy, the first in the list is shown.
"""

from __future__ import annotations

from functools import cached_property
from typing import Annotated, Literal, TypeAlias

import numpy as np
from pydantic import BeforeValidator, Field, ValidationError

from hapticd.analysis.statistics import Floats
from hapticd.base.model import CheckedTogether, problems_of
from hapticd.experiment.analysis.psychometric_shapes import Shape, axis, is_logarithmic, probability
from hapticd.experiment.analysis.psychometric_shapes import level as level_at
from hapticd.experiment.procedures.posterior import expected_entropies, marginal, summary, updated
from hapticd.experiment.procedures.procedure import (
    LEVEL_TOLERANCE,
    Answer,
    Estimate,
    Level,
    Procedure,
    ProcedureError,
    Proportion,
)

MAX_TABLE_CELLS = 2_000_000
"""Largest number of levels times grid points, with which the table of probabilities has 16 MB."""


class LevelGrid(CheckedTogether):
    """`count` values from `least` to `most`, equidistant on a linear or logarithmic axis."""

    least: Level
    most: Level
    count: Annotated[int, Field(ge=2, le=1000)]
    axis: Literal["linear", "logarithmic"] = "linear"

    def cross_faults(self) -> list[str]:
        """Return the conflicts between the keys `least`, `most` and `axis` of a grid."""
        faults = []
        if not self.least < self.most:
            faults.append(f"least ({self.least:g}) must be less than most ({self.most:g})")
        if self.axis == "logarithmic" and self.least <= 0:
            faults.append("least must be more than 0 on a logarithmic axis")
        return faults

    @property
    def values(self) -> Floats:
        """The values of the grid, in increasing order."""
        space = np.geomspace if self.axis == "logarithmic" else np.linspace
        return np.asarray(space(self.least, self.most, self.count), dtype=float)


def _listed_values(given: object) -> object:
    """Convert a mapping with the keys of a LevelGrid to the list of its values. Return other input unchanged."""
    if not isinstance(given, dict):
        return given
    try:
        return LevelGrid.parsed(given).values.tolist()
    except ValidationError as error:
        raise ValueError("; ".join(map(str, problems_of(error)))) from None


Values: TypeAlias = Annotated[
    tuple[Level, ...], BeforeValidator(_listed_values), Field(min_length=1, max_length=1000, strict=False)
]
"""A list of values, which can be given as a LevelGrid."""


class QuestPlusParameters(CheckedTogether):
    """Parameters of QUEST+, as in a study's YAML."""

    kind: Literal["quest_plus"] = "quest_plus"
    levels: Values
    thresholds: Values | None = None
    """Thresholds of the grid; None means the levels."""
    slopes: Values
    """Slopes of the grid: exponents of a Weibull function, or 1 / (spread on the axis) of another function."""
    guesses: Annotated[tuple[Proportion, ...], Field(min_length=1, max_length=100, strict=False)] = (0.0,)
    lapses: Annotated[tuple[Proportion, ...], Field(min_length=1, max_length=100, strict=False)] = (0.02,)
    shape: Shape = "weibull"
    axis: Literal["linear", "logarithmic"] = "logarithmic"
    trials: Annotated[int, Field(ge=1, le=10000)] = 60
    """Number of answers after which the procedure ends."""
    precision: Annotated[float, Field(gt=0, lt=1)] | None = None
    """The procedure ends early if half the 95 % interval of the threshold is at most this fraction of the threshold."""

    def cross_faults(self) -> list[str]:
        """Return the conflicts between the parameters of QUEST+."""
        faults = []
        axes = [np.array(self.levels), self.threshold_values, np.array(self.slopes)]
        for name, values in zip(("levels", "thresholds", "slopes"), axes, strict=True):
            if not (np.diff(values) > 0).all():
                faults.append(f"{name} must rise")
            elif name != "slopes" and self.logarithmic and values[0] <= 0:
                faults.append(f"{name} must be more than 0 on a logarithmic axis")
        if max(self.guesses) + max(self.lapses) >= 1:
            faults.append("the sum of the largest guess and the largest lapse must be less than 1")
        cells = int(np.prod([len(each) for each in axes])) * len(self.guesses) * len(self.lapses)
        if cells > MAX_TABLE_CELLS:
            faults.append(
                f"levels x thresholds x slopes x guesses x lapses must be at most {MAX_TABLE_CELLS}, are {cells}"
            )
        if 0 in self.slopes:
            faults.append("slopes must not contain 0: a function with slope 0 has no threshold")
        return faults

    @property
    def logarithmic(self) -> bool:
        """Whether the axis of the psychometric function is logarithmic."""
        return is_logarithmic(self.shape, self.axis == "logarithmic")

    @property
    def threshold_values(self) -> Floats:
        """Thresholds of the grid: `thresholds`, or `levels` if these are not given."""
        return np.array(self.levels if self.thresholds is None else self.thresholds, dtype=float)


class QuestPlus(Procedure[QuestPlusParameters]):
    """A run of QUEST+."""

    PARAMETERS = QuestPlusParameters

    def __init__(self, parameters: QuestPlusParameters) -> None:
        super().__init__(parameters)
        self.levels: Floats = np.array(parameters.levels, dtype=float)
        given = parameters
        self.grid_shape = (len(given.threshold_values), len(given.slopes), len(given.guesses), len(given.lapses))
        points = int(np.prod(self.grid_shape))
        self.posterior: Floats = np.full(points, 1.0 / points)
        """Posterior (g,) over the grid of thresholds, slopes, guesses and lapses, of which lapses change fastest."""

    @cached_property
    def table(self) -> Floats:
        """Probability (l, g) of a positive answer at each of l levels, for the parameters at each of g grid points."""
        given = self.parameters
        thresholds, slopes, guesses, lapses = np.meshgrid(
            given.threshold_values, given.slopes, given.guesses, given.lapses, indexing="ij", sparse=True
        )
        shown = self.levels[:, None, None, None, None]
        found = probability(given.shape, shown, thresholds, slopes, guesses, lapses, given.logarithmic)
        return found.reshape(len(self.levels), -1)

    def level(self) -> float | None:
        """Return the level with the smallest expected entropy, or None if the procedure has ended."""
        given = self.parameters
        if len(self.answers) >= given.trials or (given.precision is not None and self._precise(given.precision)):
            return None
        return float(self.levels[int(np.argmin(expected_entropies(self.posterior, self.table)))])

    def estimate(self) -> Estimate:
        """Return posterior mean (on the axis) and interval of the threshold. Raises ProcedureError without answers."""
        if not self.answers:
            raise ProcedureError("no threshold: QUEST+ has no answers yet")
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
        """Return `given`: QUEST+ accepts answers to any of its levels. `_take` refuses other levels."""
        return given

    def _take(self, shown: float, positive: bool) -> None:
        place = int(np.argmin(np.abs(self.levels - shown)))
        near = float(self.levels[place])
        if abs(near - shown) > LEVEL_TOLERANCE * abs(near):
            raise ProcedureError(
                f"the answer is to level {shown:g}, which is not a level of QUEST+; the nearest is {near:g}"
            )
        likelihood = self.table[place] if positive else 1.0 - self.table[place]
        if not float(np.sum(self.posterior * likelihood)) > 0:
            raise ProcedureError(
                f"this answer at level {near:g} has probability 0 at every grid point: add a lapse above 0"
            )
        self.posterior = updated(self.posterior, likelihood)
        self.answers.append(Answer(near, positive))
