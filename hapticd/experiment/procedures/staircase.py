"""Transformed and weighted up-down staircases.

Levitt, "Transformed up-down methods in psychoacoustics", J. Acoust. Soc. Am. 49, 1971:

    rule           harder after            easier after          converges at
    1-up-1-down    1 positive answer       1 negative answer     50 % positive answers
    1-up-2-down    2 in a row              1                     70.7 %
    1-up-3-down    3 in a row              1                     79.4 %
    weighted       1, by the step          1, by step p/(1 - p)  p (Kaernbach, Perception & Psychophysics 49, 1991)

On a linear axis a step is in the unit of the level and is added; on a logarithmic axis it is a factor. The threshold is
the level at which the target proportion of answers is positive. Its estimate is the posterior mean of the threshold of
a psychometric function, given all answers. The prior is uniform over thresholds near the visited levels, over the
logarithm of the slope, and over FITTED_LAPSES (after Hall, "Hybrid adaptive procedure", J. Acoust. Soc. Am. 69, 1981).
The mean of the reversals is another estimate.
"""

from __future__ import annotations

from typing import Annotated, Final, Literal

import numpy as np
from pydantic import Field

from hapticd.analysis.statistics import Floats
from hapticd.base.model import CheckedTogether
from hapticd.experiment.analysis.psychometric_shapes import Shape, axis, inverse, is_logarithmic, level, rise
from hapticd.experiment.procedures.posterior import summary
from hapticd.experiment.procedures.procedure import Answer, Estimate, Level, Procedure, ProcedureError, Proportion

Rule = Literal["1-up-1-down", "1-up-2-down", "1-up-3-down", "weighted"]
POSITIVES_IN_A_ROW: Final[dict[Rule, int]] = {"1-up-1-down": 1, "1-up-2-down": 2, "1-up-3-down": 3, "weighted": 1}
"""Number of consecutive positive answers after which the level becomes harder."""
FITTED_LAPSES: Final = (0.0, 0.02, 0.05)
"""Lapse rates of the grid on which the threshold is estimated."""
_THRESHOLD_COUNT: Final = 121
"""Number of thresholds of the grid."""
_SLOPE_COUNT: Final = 15
"""Number of slopes of the grid."""
_MAX_SPREAD_FRACTION: Final = 0.4
"""The largest spread (1 / slope) of the grid is the last step plus this fraction of the visited range; the
smallest is a quarter of the last step.

A staircase on a wider function visits a wider range. In simulations 93 to 97 % of 95 % intervals contain the threshold.
"""
_THRESHOLD_MARGIN_FRACTION: Final = 0.5
"""Thresholds of the grid extend beyond the visited range by this fraction of it, or by four times the last step."""


class StaircaseParameters(CheckedTogether):
    """Parameters of a staircase, as in a study's YAML."""

    kind: Literal["staircase"] = "staircase"
    rule: Rule
    target: Annotated[float, Field(gt=0, lt=1)] | None = None
    """Target proportion of positive answers, only for the rule weighted."""
    start: Level
    least: Level
    most: Level
    steps: Annotated[
        tuple[Annotated[float, Field(gt=0, le=1e9)], ...], Field(min_length=1, max_length=64, strict=False)
    ]
    """Steps. After each reversal the next one applies; the last step applies to the end."""
    axis: Literal["linear", "logarithmic"] = "linear"
    harder: Literal["lower", "higher"] = "lower"
    """Whether lower or higher levels are harder."""
    reversals: Annotated[int, Field(ge=2, le=1000)] = 12
    """The staircase ends after this many reversals."""
    trials: Annotated[int, Field(ge=1, le=10000)] = 100
    """The staircase ends after this many answers."""
    discard: Annotated[int, Field(ge=0, le=999)] = 4
    """Number of reversals at the beginning that do not enter the mean of the reversals."""
    guess: Proportion = 0.0
    """Probability of a positive answer by guessing."""
    shape: Shape = "logistic"

    def cross_faults(self) -> list[str]:
        """Return the conflicts between the parameters of a staircase."""
        faults = []
        if not self.least < self.most:
            faults.append(f"least ({self.least:g}) must be less than most ({self.most:g})")
        elif not self.least <= self.start <= self.most:
            faults.append(f"start ({self.start:g}) must be between least ({self.least:g}) and most ({self.most:g})")
        if (self.rule == "weighted") != (self.target is not None):
            faults.append("target is required with rule weighted, and not allowed with other rules")
        elif not self.guess < self.proportion < 1:
            faults.append(
                f"the rule converges at {100 * self.proportion:.3g} % positive answers; guess must be less, is "
                f"{100 * self.guess:.3g} %"
            )
        if self.logarithmic and self.least <= 0:
            faults.append("least must be more than 0 on a logarithmic axis")
        if self.logarithmic and self.axis == "linear":
            faults.append("shape weibull needs axis: logarithmic")
        elif self.logarithmic and min(self.steps) <= 1:
            faults.append("steps are factors on a logarithmic axis: each must be more than 1")
        if self.discard > self.reversals - 2:
            faults.append(f"discard must be at most reversals - 2 = {self.reversals - 2}, is {self.discard}")
        return faults

    @property
    def logarithmic(self) -> bool:
        """Whether the axis of the psychometric function is logarithmic."""
        return is_logarithmic(self.shape, self.axis == "logarithmic")

    @property
    def proportion(self) -> float:
        """Proportion of positive answers at which the staircase converges."""
        return self.target if self.target is not None else 0.5 ** (1.0 / POSITIVES_IN_A_ROW[self.rule])


class Staircase(Procedure[StaircaseParameters]):
    """A run of a staircase."""

    PARAMETERS = StaircaseParameters

    def __init__(self, parameters: StaircaseParameters) -> None:
        super().__init__(parameters)
        self.reversals: list[float] = []
        """Levels at which the direction of the staircase changed."""
        self._level = parameters.start
        self._in_a_row = 0
        self._towards_harder: bool | None = None

    def level(self) -> float | None:
        """Return the level of the next trial, or None after the given number of reversals or trials."""
        ended = len(self.reversals) >= self.parameters.reversals or len(self.answers) >= self.parameters.trials
        return None if ended else self._level

    def reversal_mean(self) -> float | None:
        """Return the mean level of the reversals (changes of direction) after the first `discard`, or None without any.

        On a logarithmic axis the mean is geometric.
        """
        kept = self.reversals[self.parameters.discard :]
        if not kept:
            return None
        on_log = self.parameters.logarithmic
        return float(level(axis(np.array(kept), on_log).mean(keepdims=True), on_log)[0])

    def estimate(self) -> Estimate:
        """Return the threshold, the level at which the target proportion of answers is positive, with its interval.

        Raises ProcedureError without answers.
        """
        if not self.answers:
            raise ProcedureError("no threshold: the staircase has no answers yet")
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
            if self._in_a_row < POSITIVES_IN_A_ROW[given.rule]:
                return
        self._in_a_row = 0
        if self._towards_harder is not None and self._towards_harder != positive:
            self.reversals.append(shown)
        self._towards_harder = positive
        step = given.steps[min(len(self.reversals), len(given.steps) - 1)]
        self._level = self._moved(shown, step, positive)

    def _moved(self, shown: float, step: float, harder: bool) -> float:
        given = self.parameters
        weight = 1.0
        if given.rule == "weighted" and not harder:
            weight = given.proportion / (1.0 - given.proportion)
        up = harder == (given.harder == "higher")
        if given.logarithmic:
            moved = shown * step**weight if up else shown / step**weight
        else:
            moved = shown + step * weight if up else shown - step * weight
        return float(min(max(moved, given.least), given.most))


def _marginal(given: StaircaseParameters, visited: Floats, right: Floats, wrong: Floats) -> tuple[Floats, Floats]:
    """Return thresholds (t,) on the axis and their posterior probabilities (t,), for answers at levels (v,).

    `visited` has the levels on the axis, `right` and `wrong` the numbers of positive and negative answers.
    """
    last = float(np.log(given.steps[-1])) if given.logarithmic else given.steps[-1]
    least, most = axis(np.array((given.least, given.most)), given.logarithmic)
    reach = max(_THRESHOLD_MARGIN_FRACTION * float(visited[-1] - visited[0]), 4 * last)
    thresholds = np.linspace(max(least, visited[0] - reach), min(most, visited[-1] + reach), _THRESHOLD_COUNT)
    slopes = np.geomspace(
        1.0 / (_MAX_SPREAD_FRACTION * float(visited[-1] - visited[0]) + last), 4.0 / last, _SLOPE_COUNT
    )
    lapses = np.array(FITTED_LAPSES)[np.array(FITTED_LAPSES) < 1.0 - given.proportion]
    sign = 1.0 if given.harder == "lower" else -1.0
    above = inverse(given.shape, (given.proportion - given.guess) / (1.0 - given.guess - lapses))
    z = sign * (visited[:, None, None, None] - thresholds[:, None, None]) * slopes[:, None] + above
    positive = given.guess + (1.0 - given.guess - lapses) * rise(given.shape, z)
    bounded = np.clip(positive, 1e-12, 1.0 - 1e-12)
    log_likelihood = np.tensordot(right, np.log(bounded), 1) + np.tensordot(wrong, np.log1p(-bounded), 1)
    weights = np.exp(log_likelihood - log_likelihood.max()).sum(axis=(1, 2))
    return thresholds, np.asarray(weights / weights.sum())
