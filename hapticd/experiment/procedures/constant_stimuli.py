"""The method of constant stimuli: each level equally often, in random order.

The order consists of blocks that contain each level once, in random order: practice and fatigue affect all levels
equally.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from hapticd.base.model import CheckedTogether
from hapticd.experiment.analysis.psychometric import bootstrap, fit
from hapticd.experiment.analysis.psychometric_shapes import Shape, is_logarithmic
from hapticd.experiment.procedures.procedure import Answer, Estimate, Level, Procedure, ProcedureError, Proportion


class ConstantStimuliParameters(CheckedTogether):
    """Parameters of the method of constant stimuli, as in a study's YAML."""

    kind: Literal["constant_stimuli"] = "constant_stimuli"
    levels: Annotated[tuple[Level, ...], Field(min_length=2, max_length=1000, strict=False)]
    repetitions: Annotated[int, Field(ge=1, le=10000)]
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    guess: Proportion = 0.0
    lapse: Annotated[float, Field(ge=0, lt=0.5)] | None = None
    """Probability of a negative answer at easy levels; None estimates the probability."""
    rising: bool = True
    """Whether positive answers become more frequent with rising level."""
    shape: Shape = "logistic"
    axis: Literal["linear", "logarithmic"] = "linear"

    def cross_faults(self) -> list[str]:
        """Return the conflicts between the parameters of constant stimuli."""
        faults = []
        if len(set(self.levels)) < len(self.levels):
            faults.append("levels must be different from each other")
        if self.logarithmic and min(self.levels) <= 0:
            faults.append("levels must be more than 0 on a logarithmic axis")
        if self.guess + (self.lapse or 0.0) >= 1:
            faults.append("the sum of guess and lapse must be less than 1")
        return faults

    @property
    def logarithmic(self) -> bool:
        """Whether the axis of the psychometric function is logarithmic."""
        return is_logarithmic(self.shape, self.axis == "logarithmic")


class ConstantStimuli(Procedure[ConstantStimuliParameters]):
    """A run of the method of constant stimuli."""

    PARAMETERS = ConstantStimuliParameters

    def __init__(self, parameters: ConstantStimuliParameters) -> None:
        super().__init__(parameters)
        generator = np.random.Generator(np.random.PCG64(parameters.seed))
        blocks = [generator.permutation(parameters.levels) for _ in range(parameters.repetitions)]
        self.order: list[float] = [float(each) for block in blocks for each in block]

    def level(self) -> float | None:
        """Return the next level of the random order, or None at the end of the order."""
        return self.order[len(self.answers)] if len(self.answers) < len(self.order) else None

    def estimate(self) -> Estimate:
        """Return the threshold of a psychometric function fitted to the answers, with its bootstrap interval.

        Raises ProcedureError without answers, and FitError if no function can be fitted to the answers.
        """
        if not self.answers:
            raise ProcedureError("no threshold: constant stimuli have no answers yet")
        given = self.parameters
        levels, at = np.unique([each.level for each in self.answers], return_inverse=True)
        positive = np.bincount(at, [each.positive for each in self.answers])
        found = fit(
            levels,
            positive,
            np.bincount(at),
            given.shape,
            guess=given.guess,
            lapse=given.lapse,
            logarithmic=given.logarithmic,
            rising=given.rising,
        )
        interval = bootstrap(found, seed=given.seed)["threshold"]
        return Estimate(interval.value, interval.low, interval.high)

    def _take(self, shown: float, positive: bool) -> None:
        self.answers.append(Answer(shown, positive))
