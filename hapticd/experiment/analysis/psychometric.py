"""Fit psychometric functions to answers: threshold, PSE, JND and Weber fraction with bootstrap intervals.

Fits maximize the likelihood, with a weak prior on an estimated lapse or guess (`likelihood_search`). Intervals come
from a parametric bootstrap (Wichmann and Hill, "The psychometric function: II", Perception & Psychophysics 63, 2001):
answers are drawn from the fitted function and fitted again, and the ends of an interval are percentiles.

F is the function without guess and lapse (psychometric_shapes). The figures have the unit of the level unless stated
otherwise:

    threshold         level at which F = 1/2, for a Weibull function 1 - 1/e
    pse               point of subjective equality: level at which F = 1/2
    jnd               just noticeable difference: half the distance between the levels at which F = 1/4 and F = 3/4
    weber_fraction    jnd / standard, or jnd / PSE if there is no standard; a ratio
    slope             as in psychometric_shapes, in the inverse unit of the axis
    guess, lapse      probabilities
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from hapticd.analysis.statistics import CONFIDENCE_LEVEL, Estimate, FitError, Floats
from hapticd.experiment.analysis.likelihood_search import (
    GUESS,
    LAPSE,
    MAX_RESAMPLE_ROUNDS,
    RESAMPLE_TOLERANCE,
    SLOPE,
    THRESHOLD,
    Box,
    log_likelihood,
    modelled,
    most_probable,
)
from hapticd.experiment.analysis.psychometric_shapes import (
    PSYCHOMETRIC_SHAPES,
    Shape,
    axis,
    inverse,
    is_logarithmic,
    level,
    probability,
    rise,
)

PSYCHOMETRIC_FIGURES: Final = ("threshold", "pse", "jnd", "weber_fraction", "slope", "guess", "lapse")
"""Names of the figures of a fit. The docstring of the module defines them."""
BOOTSTRAP_RESAMPLES: Final = 2000
_STEP_MARGIN: Final = 0.05
"""A fitted function F that is within this distance of 0 or 1 at every level counts as a step. Resampled answers would
equal the original ones, and the interval of the threshold would have no width.
"""


@dataclass(frozen=True, slots=True)
class PsychometricFit:
    """A fitted psychometric function, with the answers at k levels that it was fitted to."""

    shape: Shape
    logarithmic: bool
    rising: bool
    levels: Floats
    """Levels (k,)."""
    positive: Floats
    """Numbers of positive answers (k,)."""
    trials: Floats
    """Numbers of answers (k,)."""
    parameters: Floats
    """Threshold on the axis, log of the slope, guess and lapse (4,)."""
    box: Box
    standard: float | None
    """Level of the standard, for the Weber fraction, or None."""

    @property
    def figures(self) -> dict[str, float]:
        """The figures of the fit, such as threshold and jnd, by name; see PSYCHOMETRIC_FIGURES."""
        return {name: float(value[0]) for name, value in figures_of(self, self.parameters[None]).items()}

    @property
    def deviance(self) -> float:
        """Twice the difference between the log likelihoods of the observed proportions and of the function."""
        return float(_deviance(self, self.positive[None], self.parameters[None])[0])

    def undetermined(self, unit: str) -> str | None:
        """Return why the answers do not determine the PSE, with a remedy, or None if they determine it.

        `unit` is the unit of the levels, for the text.
        """
        half_way, slope = self.figures["pse"], self.parameters[SLOPE]
        low, high = float(self.levels.min()), float(self.levels.max())
        proportions = self.positive / self.trials
        center = np.average(_places(self), weights=self.trials)
        if _sign(self) * float(self.trials @ ((_places(self) - center) * proportions)) <= 0:
            way, keys = ("more", "`rising: false`, or `harder: higher`") if self.rising else ("fewer", "`rising: true`")
            return (
                f"correct answers do not become {way} from {low:g} to {high:g} {unit}: if they should become "
                f"{'fewer' if self.rising else 'more'}, set {keys} in the procedure; else use other levels"
            )
        if not low <= half_way <= high:
            beyond = f"above the highest level, {high:g}" if half_way > high else f"below the lowest level, {low:g}"
            return f"the threshold is {beyond} {unit}: levels beyond it are needed"
        if slope <= self.box.low[SLOPE]:
            return f"from {low:g} to {high:g} {unit} the answers hardly depend on the level: a wider range is needed"
        rises = rise(self.shape, _sign(self) * (_places(self) - self.parameters[THRESHOLD]) * np.exp(slope))
        if not ((rises > _STEP_MARGIN) & (rises < 1 - _STEP_MARGIN)).any():
            below, above = self.levels[self.levels <= half_way].max(), self.levels[self.levels >= half_way].min()
            return (
                f"the answers fit a step from chance to certainty between {below:g} and {above:g} {unit}: more answers "
                "near it are needed"
            )
        return None

    @property
    def as_steep_as_levels_show(self) -> bool:
        """Whether the fitted slope is at its upper bound, which depends on the smallest distance of two levels."""
        return bool(self.parameters[SLOPE] >= self.box.high[SLOPE])

    def probability(self, levels: Floats) -> Floats:
        """Return the fitted probability of a positive answer at each of `levels`, an array of any shape."""
        threshold = level(self.parameters[THRESHOLD], self.logarithmic)
        slope = np.exp(self.parameters[SLOPE]) * (1.0 if self.rising else -1.0)
        guess, lapse = self.parameters[GUESS], self.parameters[LAPSE]
        return probability(self.shape, levels, threshold, slope, guess, lapse, self.logarithmic)


def fit(
    levels: npt.ArrayLike,
    positive: npt.ArrayLike,
    trials: npt.ArrayLike,
    shape: Shape = "logistic",
    *,
    guess: float | None = 0.0,
    lapse: float | None = None,
    logarithmic: bool = False,
    rising: bool = True,
    standard: float | None = None,
) -> PsychometricFit:
    """Fit a psychometric function to answers at levels (k,) in any order: `positive` (k,) of `trials` (k,) answers.

    `guess` and `lapse` are fixed probabilities; one that is None is estimated. Raises FitError for answers at fewer
    than two levels, for impossible counts or parameters, and if all answers are equal.
    """
    if shape not in PSYCHOMETRIC_SHAPES:
        raise FitError(f"unknown psychometric function {shape!r}; known: {', '.join(PSYCHOMETRIC_SHAPES)}")
    x, right, of = (np.asarray(each, dtype=float) for each in (levels, positive, trials))
    if not (x.ndim == 1 and x.shape == right.shape == of.shape):
        raise FitError(
            f"levels, positive and trials must have equal lengths, have {x.size}, {right.size} and {of.size}"
        )
    if not (np.isfinite(x).all() and (right >= 0).all() and (right <= of).all()):
        raise FitError("levels must be finite, and positive answers between 0 and the number of trials")
    x, right, of = x[of > 0], right[of > 0], of[of > 0]
    if len(np.unique(x)) < 2:
        raise FitError(f"a psychometric function needs answers at two or more levels, has {len(np.unique(x))}")
    if right.sum() in (0.0, of.sum()):
        raise FitError("all answers are equal: easier or harder levels are needed to determine a threshold")
    if (guess or 0.0) + (lapse or 0.0) >= 1:
        raise FitError("the sum of guess and lapse must be less than 1")
    on_log = is_logarithmic(shape, logarithmic)
    if on_log and not (x > 0).all():
        raise FitError(f"levels of a {shape} function on a logarithmic axis must be positive, one is {x.min():g}")
    places = axis(x, on_log)
    box = Box.around(places, guess, lapse)
    found = most_probable(shape, places, right[None], of[None], box, 1.0 if rising else -1.0)[0]
    return PsychometricFit(shape, on_log, rising, x, right, of, found, box, standard)


def bootstrap(found: PsychometricFit, resamples: int = BOOTSTRAP_RESAMPLES, seed: int = 0) -> dict[str, Estimate]:
    """Return the PSYCHOMETRIC_FIGURES of a fit, with bootstrap intervals. Equal seeds give equal intervals."""
    generator = np.random.Generator(np.random.PCG64(seed))
    _, refitted = _resampled(found, generator, resamples)
    values, spread = figures_of(found, found.parameters[None]), figures_of(found, refitted)
    estimates = {}
    for name in PSYCHOMETRIC_FIGURES:
        low, high = percentiles(spread[name])
        estimates[name] = Estimate(float(values[name][0]), low, high)
    return estimates


def goodness_of_fit(found: PsychometricFit, resamples: int = BOOTSTRAP_RESAMPLES, seed: int = 0) -> float:
    """Return the p value of a fit's deviance by a parametric bootstrap: low if the function fits the answers badly."""
    generator = np.random.Generator(np.random.PCG64(seed))
    drawn, refitted = _resampled(found, generator, resamples)
    as_large = np.count_nonzero(_deviance(found, drawn, refitted) >= found.deviance)
    return (1.0 + float(as_large)) / (1.0 + resamples)


def percentiles(spread: Floats, level: float = CONFIDENCE_LEVEL) -> tuple[float, float]:
    """Return the ends of the interval that contains the fraction `level` of the resampled values `spread` (n,).

    Both ends are interpolated order statistics, at (n + 1) times the tail probabilities.
    """
    rest = 0.5 * (1.0 - level)
    low, high = np.quantile(spread, (rest, 1.0 - rest), method="weibull")
    return float(low), float(high)


def figures_of(found: PsychometricFit, parameters: Floats) -> dict[str, Floats]:
    """Return the PSYCHOMETRIC_FIGURES, each (b,), for parameters (b, 4), with the shape and axis of the fit `found`."""
    sign, slope = _sign(found), np.exp(parameters[:, SLOPE])

    def at(proportion: float) -> Floats:
        place = parameters[:, THRESHOLD] + sign * inverse(found.shape, proportion) / slope
        return level(place, found.logarithmic)

    pse, jnd = at(0.5), 0.5 * np.abs(at(0.75) - at(0.25))
    with np.errstate(divide="ignore", invalid="ignore"):
        weber = jnd / np.abs(pse if found.standard is None else found.standard)
    return {
        "threshold": level(parameters[:, THRESHOLD], found.logarithmic),
        "pse": pse,
        "jnd": jnd,
        "weber_fraction": weber,
        "slope": slope,
        "guess": parameters[:, GUESS],
        "lapse": parameters[:, LAPSE],
    }


def _places(found: PsychometricFit) -> Floats:
    return axis(found.levels, found.logarithmic)


def _sign(found: PsychometricFit) -> float:
    return 1.0 if found.rising else -1.0


def _resampled(found: PsychometricFit, generator: np.random.Generator, count: int) -> tuple[Floats, Floats]:
    """Return numbers of positive answers (count, k), drawn from a fit, and the parameters (count, 4) fitted to them."""
    chances = np.clip(modelled(found.shape, _places(found), found.parameters[None], _sign(found)), 0.0, 1.0)[0]
    drawn = generator.binomial(found.trials.astype(np.int64), chances, (count, len(chances))).astype(float)
    starts = np.repeat(found.parameters[None], count, axis=0)
    trials = np.broadcast_to(found.trials, drawn.shape)
    return drawn, most_probable(
        found.shape,
        _places(found),
        drawn,
        trials,
        found.box,
        _sign(found),
        starts,
        RESAMPLE_TOLERANCE,
        MAX_RESAMPLE_ROUNDS,
    )


def _deviance(found: PsychometricFit, positive: Floats, parameters: Floats) -> Floats:
    """Return the deviances (b,) of functions with parameters (b, 4) from b sets of answers to the k levels of a fit."""
    of = np.broadcast_to(found.trials, positive.shape)
    own = log_likelihood(positive, of, positive / of)
    return 2.0 * (own - log_likelihood(positive, of, modelled(found.shape, _places(found), parameters, _sign(found))))
