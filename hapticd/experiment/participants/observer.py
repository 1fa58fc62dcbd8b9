"""The perception and the answers of a simulated participant, computed from samples alone: names of stimuli are unused.

The felt force is the commanded force `force_n`, filtered to TOUCH_BAND_HZ: mass times acceleration of the handle.
Three features are computed from this force, as logarithms. Noise of a logarithm corresponds to a Weber fraction.

    hardness   rate of change of the force after an onset / approach speed: the rate-hardness of Lawrence,
               Pao, Dougherty, Salada and Pavlou, IEEE Trans. Robotics and Automation 16, 2000
    fineness   periods of the felt force per metre along the surface
    loudness   root mean square of the felt force

Noise of standard deviation `noise` is added to each feature of each stimulus. Two stimuli are judged the same if their
features differ by less than `criterion`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from hapticd.analysis.statistics import Floats
from hapticd.base.core import Flag
from hapticd.experiment.front import Choice, Seen
from hapticd.experiment.keys import POSITION_MEANINGS
from hapticd.experiment.stage import Samples

Feature: TypeAlias = Literal["hardness", "fineness", "loudness"]

TOUCH_BAND_HZ: Final = (20.0, 1000.0)
"""Range of felt frequencies (Bolanowski, Gescheider, Verrillo and Checkosky, J. Acoust. Soc. Am. 84, 1988)."""
MIN_FELT_FORCE_N: Final = 0.05
"""A contact begins when the force exceeds this smallest felt force."""
TAP_WINDOW_S: Final = 0.02
"""Duration after an onset in which the hardness of a tap is computed."""
RUPTURE_FORCE_DROP_N: Final = 0.4
"""A fall of the force by more than this within TAP_WINDOW_S is felt as a rupture."""
_MIN_LOG_ARGUMENT: Final = 1e-6
"""Lower bound of a value before its logarithm or reciprocal, which avoids infinities."""
_CELLS_PER_M: Final = 20_000.0
"""Number of cells per metre in which the force along a surface is averaged for its profile."""
_MIN_PROFILE_CELLS: Final = 64
"""A profile needs at least this number of visited cells."""
_FINENESS_RANGE_PER_M: Final = (60.0, 1500.0)
"""Range of the fineness, in periods per metre. The lowest one stands for a surface without texture."""


@dataclass(frozen=True, slots=True)
class ObserverParameters:
    """Noise and criterion of an observer, which limit how well the observer distinguishes stimuli.

    They maximize the likelihood of six cells in Table 2 of Okamura, Dennerlein and Howe (ICRA 1998): pairs of the soft
    materials wood, acrylic and delrin with force and vibration, given the hardness that a simulated hand feels in them.
    No other value of the paper was used.
    """

    noise: float = 0.41
    """Standard deviation of the noise of a feature, which is a natural logarithm."""
    criterion: float = 0.625
    """Smallest difference of two features, natural logarithms, with which stimuli are judged as different."""


class Observer:
    """A simulated observer, whose answers follow from one feature of each stimulus."""

    def __init__(self, chance: np.random.Generator, parameters: ObserverParameters | None = None) -> None:
        self._chance = chance
        self._parameters = parameters or ObserverParameters()
        self._learned: dict[str, list[float]] = {}

    def percept(self, feature: Feature, felt: Samples, surface: Seen) -> float:
        """Return the percept of a stimulus: a feature of the samples felt at its surface, with noise."""
        found = FEATURE_FUNCTIONS[feature](felt, surface)
        return found + self._parameters.noise * float(self._chance.standard_normal())

    def compare(self, percepts: list[float], answers: tuple[Choice, ...]) -> str:
        """Return the name of the answer for the stimulus with the largest percept, or for equal stimuli."""
        by_meaning = {answer.means: answer.name for answer in answers}
        order = np.argsort(percepts)
        if "same" in by_meaning and percepts[order[-1]] - percepts[order[-2]] < self._parameters.criterion:
            return by_meaning["same"]
        meant = POSITION_MEANINGS[int(order[-1])]
        return by_meaning[meant] if meant in by_meaning else self.guess(answers)

    def rank(self, percepts: list[float]) -> str:
        """Return a ranking, the positions from the largest percept to the smallest, such as second>first>third."""
        return ">".join(POSITION_MEANINGS[int(at)] for at in np.argsort(percepts)[::-1])

    def identify(self, percept: float, answers: tuple[Choice, ...]) -> str:
        """Return the name of the answer whose learned percepts have the mean nearest to `percept`, or else a guess."""
        known = {answer.name: self._learned[answer.name] for answer in answers if answer.name in self._learned}
        if not known:
            return self.guess(answers)
        return min(known, key=lambda name: abs(float(np.mean(known[name])) - percept))

    def learn(self, percept: float, right: str) -> None:
        """Store the percept of a stimulus whose correct answer, `right`, is known from feedback."""
        self._learned.setdefault(right, []).append(percept)

    def rate(self, percept: float, low: float, high: float) -> float:
        """Return a rating from `low` to `high`, by the rank of `percept` among all rated percepts including itself."""
        rated = self._learned.setdefault("", [])
        rated.append(percept)
        fraction = (sum(each < percept for each in rated) + 0.5) / len(rated)
        return low + fraction * (high - low)

    def guess(self, answers: tuple[Choice, ...]) -> str:
        """Return the name of a random answer."""
        return answers[int(self._chance.integers(len(answers)))].name


def banded(signal: Floats, period_s: float) -> Floats:
    """Return a signal (n,) or (n, k), filtered to TOUCH_BAND_HZ without a phase shift, with slopes of second order."""
    frequency = np.fft.rfftfreq(len(signal), period_s)
    low, high = TOUCH_BAND_HZ
    with np.errstate(divide="ignore"):
        gain = 1.0 / (1.0 + (low / np.maximum(frequency, _MIN_LOG_ARGUMENT)) ** 2) / (1.0 + (frequency / high) ** 2)
    gain = gain.reshape(-1, *(1,) * (signal.ndim - 1))
    return np.asarray(np.fft.irfft(np.fft.rfft(signal, axis=0) * gain, len(signal), axis=0))


def _period_s(felt: Samples) -> float:
    return float(np.median(np.diff(felt["time_ns"].astype(np.int64)))) / 1e9


def hardness(felt: Samples, surface: Seen) -> float:
    """Return the mean over taps of log(rate of change of the felt force / approach speed), with units N/s and m/s."""
    if len(felt) < 3:
        return math.log(_MIN_LOG_ARGUMENT)
    period_s = _period_s(felt)
    normal = np.array(surface.normal)
    force = np.asarray(felt["force_n"] @ normal)
    rate = np.abs(np.gradient(banded(force, period_s), period_s))
    speed = -np.asarray(felt["velocity_m_per_s"] @ normal)
    window = max(2, round(TAP_WINDOW_S / period_s))
    found = []
    for at in onsets(force, window):
        before = max(0, at - window // 4)
        approach = float(speed[before : at + 1].max())
        if approach > 0.01:
            found.append(math.log(max(_MIN_LOG_ARGUMENT, float(rate[at : at + window].max()) / approach)))
    return float(np.mean(found)) if found else math.log(_MIN_LOG_ARGUMENT)


def onsets(force: Floats, window: int) -> list[int]:
    """Return the indices at which a force (n,) exceeds MIN_FELT_FORCE_N after `window` samples in which it did not."""
    over = np.abs(force) > MIN_FELT_FORCE_N
    rises = np.flatnonzero(np.diff(over.astype(np.int8)) == 1) + 1
    return [int(at) for at in rises if not over[max(0, at - window) : at].any()]


def fineness(felt: Samples, surface: Seen) -> float:
    """Return the logarithm of the number of periods per metre of the felt force along a touched surface, in 1/m.

    The period is the lag of the largest maximum of the autocorrelation, as for the pitch of a voice (Boersma, Proc.
    Institute of Phonetic Sciences Amsterdam 17, 1993): the fundamental period, whichever harmonic is the strongest. The
    autocorrelations of both directions are added, as a force along the surface changes sign with the direction.
    """
    if len(felt) < 3:
        return math.log(_FINENESS_RANGE_PER_M[0])
    touched = (felt["flags"] & Flag.CONTACT) != 0
    n_x, n_y = surface.normal
    along = np.asarray(felt["position_m"] @ np.array([n_y, -n_x]))
    speed = np.asarray(felt["velocity_m_per_s"] @ np.array([n_y, -n_x]))
    cell = np.floor((along - along.min()) * _CELLS_PER_M).astype(np.int64)
    force = banded(np.asarray(felt["force_n"]), _period_s(felt))
    power: Floats = np.zeros(int(cell.max()) + 2)
    for way in (speed > 0, speed < 0):
        power += _power_along(cell[touched & way], force[touched & way], len(power))
    alike = np.fft.irfft(power)
    first, last = (round(_CELLS_PER_M / each) for each in reversed(_FINENESS_RANGE_PER_M))
    lags = np.arange(first, min(last, len(power) - 2) + 1)
    peaks = lags[(alike[lags] > alike[lags - 1]) & (alike[lags] >= alike[lags + 1]) & (alike[lags] > 0.0)]
    if len(peaks) == 0:
        return math.log(_FINENESS_RANGE_PER_M[0])
    best = int(peaks[np.argmax(alike[peaks])])
    before, here, after = alike[best - 1 : best + 2]
    return math.log(_CELLS_PER_M / (best + 0.5 * (before - after) / (before - 2.0 * here + after)))


def _power_along(cell: npt.NDArray[np.int64], force: Floats, count: int) -> Floats:
    """Return the spatial power spectrum (count,) of a force (n, 2) along a surface, summed over both axes.

    `cell` (n,) is the cell of the surface that contains a sample. The profile of the force is padded with zeros for a
    linear autocorrelation. For fewer cells than _MIN_PROFILE_CELLS the result is 0.
    """
    size = 2 * (count - 1)
    times = np.bincount(cell, minlength=1)
    kept = np.flatnonzero(times)
    if len(kept) < _MIN_PROFILE_CELLS:
        return np.zeros(count)
    every = np.arange(kept[0], kept[-1] + 1)
    found: Floats = np.zeros(count)
    for axis in force.T:
        profile = np.interp(every, kept, np.bincount(cell, axis)[kept] / times[kept])
        found += np.abs(np.fft.rfft((profile - profile.mean()) * np.hanning(len(profile)), size)) ** 2
    return found


def loudness(felt: Samples, surface: Seen) -> float:
    """Return the logarithm of the root mean square of the felt force in N."""
    if len(felt) < 3:
        return math.log(_MIN_LOG_ARGUMENT)
    force = banded(np.asarray(felt["force_n"]), _period_s(felt))
    return math.log(max(_MIN_LOG_ARGUMENT, float(np.sqrt((force**2).sum(axis=1).mean()))))


FEATURE_FUNCTIONS: Final = {"hardness": hardness, "fineness": fineness, "loudness": loudness}
"""The function that computes each feature from the felt samples and the surface."""


def rupture_felt_s(felt: Samples, surface: Seen) -> float | None:
    """Return the time in s from the first sample to the first rupture that is felt, or None.

    A fall of the force by more than RUPTURE_FORCE_DROP_N within TAP_WINDOW_S is felt as a rupture.
    """
    if len(felt) < 3:
        return None
    period_s = _period_s(felt)
    force = np.asarray(felt["force_n"] @ np.array(surface.normal))
    window = max(1, round(TAP_WINDOW_S / period_s))
    if len(force) <= window:
        return None
    fell = np.flatnonzero(force[:-window] - force[window:] > RUPTURE_FORCE_DROP_N)
    return None if len(fell) == 0 else float(fell[0] + window) * period_s
