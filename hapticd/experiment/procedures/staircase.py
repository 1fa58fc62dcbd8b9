"""Transformed up-down staircases (Levitt, "Transformed up-down methods in psychoacoustics", J. Acoust. Soc. Am. 49,
1971).

    rule           harder after            easier after          converges at
    1-up-1-down    1 positive answer       1 negative answer     50 % positive answers
    1-up-2-down    2 in a row              1                     70.7 %
    1-up-3-down    3 in a row              1                     79.4 %
    weighted       1, by the step          1, by step p/(1 - p)  p (Kaernbach, Perception & Psychophysics 49, 1991)

On a linear axis a step is in the unit of the level and is added; on a logarithmic axis it is a factor. The threshold is
the level at which the target proportion of answers is positive. It is estimated from all answers: the posterior mean
and the interval of a psychometric function whose threshold is uniform over the levels near those visited, whose slope
is uniform in its logarithm, and whose lapses are any of LAPSES (after Hall, "Hybrid adaptive procedure", J. Acoust.
Soc. Am. 69, 1981). The mean of the reversals is reported beside it.
"""

from __future__ import annotations

from typing import Annotated, Final, Literal

import numpy as np
from pydantic import Field

from hapticd.base.model import CheckedTogether
from hapticd.experiment.analysis.psychometric_shapes import Floats, Shape, axis, inverse, is_logarithmic, level, rise
from hapticd.experiment.procedures.posterior import summary
from hapticd.experiment.procedures.procedure import (
    Answer,
    Estimate,
    Kept,
    Level,
    ProcedureError,
    Proportion,
)

Rule = Literal["1-up-1-down", "1-up-2-down", "1-up-3-down", "weighted"]
IN_A_ROW: Final[dict[Rule, int]] = {"1-up-1-down": 1, "1-up-2-down": 2, "1-up-3-down": 3, "weighted": 1}
LAPSES: Final = (0.0, 0.02, 0.05)
_THRESHOLDS: Final = 121
_SLOPES: Final = 15
_WIDEST: Final = 0.4
"""Of the range visited: the largest spread of a function, a step more; the least is a quarter of a step. A staircase
visits a wider range than that where the function is wider. With it 95 % intervals cover 93 to 97 % in simulations."""
_BEYOND: Final = 0.5
"""Of the range visited: so far beyond either end the threshold may be."""


class StaircaseParameters(CheckedTogether):
    """A staircase, as a study's YAML has it."""

    kind: Literal["staircase"] = "staircase"
    rule: Rule
    target: Annotated[float, Field(gt=0, lt=1)] | None = None
    """Proportion of positive answers; of the rule weighted alone."""
    start: Level
    least: Level
    most: Level
    steps: Annotated[
        tuple[Annotated[float, Field(gt=0, le=1e9)], ...], Field(min_length=1, max_length=64, strict=False)
    ]
    """The first until the first reversal, the next until the second, the last one to the end."""
    axis: Literal["linear", "logarithmic"] = "linear"
    harder: Literal["lower", "higher"] = "lower"
    """Levels that are harder."""
    reversals: Annotated[int, Field(ge=2, le=1000)] = 12
    """It ends after so many,"""
    trials: Annotated[int, Field(ge=1, le=10000)] = 100
    """or after so many answers."""
    discard: Annotated[int, Field(ge=0, le=999)] = 4
    """Reversals that the mean of reversals leaves out, from the first."""
    guess: Proportion = 0.0
    """Probability of a positive answer far below threshold."""
    shape: Shape = "logistic"

    def cross_faults(self) -> list[str]:
        faults = []
        if not self.least < self.most:
            faults.append(f"least ({self.least:g}) must be less than most ({self.most:g})")
        elif not self.least <= self.start <= self.most:
            faults.append(f"start ({self.start:g}) must lie between least ({self.least:g}) and most ({self.most:g})")
        if (self.rule == "weighted") != (self.target is not None):
            faults.append("target is needed by the rule weighted, and belongs to it alone")
        elif not self.guess < self.proportion < 1:
            faults.append(
                f"the rule converges at {100 * self.proportion:.3g} % positive answers, which must be more than guess "
                f"({100 * self.guess:.3g} %)"
            )
        if self.logarithmic and self.least <= 0:
            faults.append("least must be more than 0 on a logarithmic axis")
        if self.logarithmic and self.axis == "linear":
            faults.append("a weibull function needs axis: logarithmic")
        elif self.logarithmic and min(self.steps) <= 1:
            faults.append("steps are factors on a logarithmic axis: each must be more than 1")
        if self.discard > self.reversals - 2:
            faults.append(f"discard ({self.discard}) must leave 2 of the {self.reversals} reversals")
        return faults

    @property
    def logarithmic(self) -> bool:
        return is_logarithmic(self.shape, self.axis == "logarithmic")

    @property
    def proportion(self) -> float:
        """Of positive answers at which it converges."""
        return self.target if self.target is not None else 0.5 ** (1.0 / IN_A_ROW[self.rule])


class Staircase(Kept[StaircaseParameters]):
    """One run of a staircase; see `procedure.Procedure`."""

    PARAMETERS = StaircaseParameters

    def __init__(self, parameters: StaircaseParameters) -> None:
        super().__init__(parameters)
        self.reversals: list[float] = []
        """Levels at which the direction changed."""
        self._level = parameters.start
        self._in_a_row = 0
        self._towards_harder: bool | None = None

    def level(self) -> float | None:
        """The next level; None after all reversals or trials."""
        ended = len(self.reversals) >= self.parameters.reversals or len(self.answers) >= self.parameters.trials
        return None if ended else self._level

    def reversal_mean(self) -> float | None:
        """Mean of the reversals (on a logarithmic axis the geometric one) without those discarded; None without any."""
        kept = self.reversals[self.parameters.discard :]
        if not kept:
            return None
        on_log = self.parameters.logarithmic
        return float(level(axis(np.array(kept), on_log).mean(keepdims=True), on_log)[0])

    def estimate(self) -> Estimate:
        """The level of the target proportion. Raises ProcedureError without answers."""
        if not self.answers:
            raise ProcedureError("the staircase has no answers: nothing can be estimated")
        given = self.parameters
        visited, at = np.unique(
            axis(np.array([each.level for each in self.answers]), given.logarithmic), return_inverse=True
        )
        positive = np.array([each.positive for each in self.answers], dtype=float)
        right: Floats = np.bincount(at, positive).astype(float)
        wrong: Floats = np.bincount(at, 1.0 - positive).astype(float)
        thresholds, weights = _marginal(given, visited, right, wrong)
        return Estimate(*summary(thresholds, weights, lambda place: level(place, given.logarithmic)))

    def _take(self, shown: float, positive: bool) -> None:
        self.answers.append(Answer(shown, positive))
        given = self.parameters
        if positive:
            self._in_a_row += 1
            if self._in_a_row < IN_A_ROW[given.rule]:
                return
        self._in_a_row = 0
        if self._towards_harder is not None and self._towards_harder != positive:
            self.reversals.append(shown)
        self._towards_harder = positive
        step = given.steps[min(len(self.reversals), len(given.steps) - 1)]
        self._level = self._moved(shown, step, positive)

    def _moved(self, shown: float, step: float, harder: bool) -> float:
        given = self.parameters
        share = 1.0
        if given.rule == "weighted" and not harder:
            share = given.proportion / (1.0 - given.proportion)
        up = harder == (given.harder == "higher")
        if given.logarithmic:
            moved = shown * step**share if up else shown / step**share
        else:
            moved = shown + step * share if up else shown - step * share
        return float(min(max(moved, given.least), given.most))


def _marginal(given: StaircaseParameters, visited: Floats, right: Floats, wrong: Floats) -> tuple[Floats, Floats]:
    """Places on the axis of the level with the target proportion, (t,), and their probabilities (t,)."""
    last = float(np.log(given.steps[-1])) if given.logarithmic else given.steps[-1]
    least, most = axis(np.array((given.least, given.most)), given.logarithmic)
    reach = max(_BEYOND * float(visited[-1] - visited[0]), 4 * last)
    thresholds = np.linspace(max(least, visited[0] - reach), min(most, visited[-1] + reach), _THRESHOLDS)
    slopes = np.geomspace(1.0 / (_WIDEST * float(visited[-1] - visited[0]) + last), 4.0 / last, _SLOPES)
    lapses = np.array(LAPSES)[np.array(LAPSES) < 1.0 - given.proportion]
    sign = 1.0 if given.harder == "lower" else -1.0
    above = inverse(given.shape, (given.proportion - given.guess) / (1.0 - given.guess - lapses))
    z = sign * (visited[:, None, None, None] - thresholds[:, None, None]) * slopes[:, None] + above
    positive = given.guess + (1.0 - given.guess - lapses) * rise(given.shape, z)
    bounded = np.clip(positive, 1e-12, 1.0 - 1e-12)
    log_likelihood = np.tensordot(right, np.log(bounded), 1) + np.tensordot(wrong, np.log1p(-bounded), 1)
    weights = np.exp(log_likelihood - log_likelihood.max()).sum(axis=(1, 2))
    return thresholds, np.asarray(weights / weights.sum())
