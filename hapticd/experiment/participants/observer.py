"""What a simulated participant feels, and what it answers: from samples alone, never from names.

Felt is the command in the band of touch: force_n between BAND_HZ, divided by the mass that moves, is the acceleration
that the vibration gives to the handle. Three features follow from it, each a logarithm, so that internal noise is a
Weber fraction:

    hardness   rate of change of the force after an onset over the speed of the approach: the rate-hardness of Lawrence,
               Pao, Dougherty, Salada and Pavlou, IEEE Trans. Robotics and Automation 16, 2000
    fineness   repetitions of the felt force per metre of the way along the surface
    loudness   root mean square of the felt force

Noise of standard deviation `noise` is added to each feature once a place. Two places are the same where they differ by
less than `criterion`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from hapticd.base.core import Flag
from hapticd.experiment.front import Choice, Seen
from hapticd.experiment.stage import Samples

Floats: TypeAlias = npt.NDArray[np.float64]
Feature: TypeAlias = Literal["hardness", "fineness", "loudness"]

BAND_HZ: Final = (20.0, 1000.0)
"""Vibration is felt between them: Bolanowski, Gescheider, Verrillo and Checkosky, J. Acoust. Soc. Am. 84, 1988."""
ONSET_N: Final = 0.05
"""A force that is felt: a contact begins."""
WINDOW_S: Final = 0.02
"""After an onset, that a tap is judged by."""
DROP_N: Final = 0.4
"""A force that falls by so much within WINDOW_S is felt as a rupture."""
_LEAST: Final = 1e-6
_CELLS_PER_M: Final = 20_000.0
_LEAST_CELLS: Final = 64
_FINENESS_PER_M: Final = (60.0, 1500.0)


@dataclass(frozen=True, slots=True)
class ObserverParameters:
    """How well an observer tells features apart.

    Noise and criterion maximise the likelihood of Table 2's six cells of soft materials (wood, acrylic and delrin,
    force and vibration) of Okamura, Dennerlein and Howe, ICRA 1998, given the hardness that this observer's hand
    feels in them. No other figure of the paper was used.
    """

    noise: float = 0.41
    criterion: float = 0.625


class Observer:
    """Judges places by a feature."""

    def __init__(self, chance: np.random.Generator, parameters: ObserverParameters | None = None) -> None:
        self._chance = chance
        self._parameters = parameters or ObserverParameters()
        self._learned: dict[str, list[float]] = {}

    def percept(self, feature: Feature, felt: Samples, surface: Seen) -> float:
        """A feature of what was felt at one place, with the noise of this judgement."""
        found = FEATURES[feature](felt, surface)
        return found + self._parameters.noise * float(self._chance.standard_normal())

    def compare(self, percepts: list[float], answers: tuple[Choice, ...]) -> str:
        """The answer of the place with the largest percept, or that they are the same where there is such an answer."""
        by_meaning = {answer.means: answer.name for answer in answers}
        order = np.argsort(percepts)
        if "same" in by_meaning and percepts[order[-1]] - percepts[order[-2]] < self._parameters.criterion:
            return by_meaning["same"]
        meant = POSITIONS[int(order[-1])]
        return by_meaning[meant] if meant in by_meaning else self.guess(answers)

    def rank(self, percepts: list[float]) -> str:
        """Positions from the largest percept down: second>first>third."""
        return ">".join(POSITIONS[int(at)] for at in np.argsort(percepts)[::-1])

    def identify(self, percept: float, answers: tuple[Choice, ...]) -> str:
        """The answer whose remembered percepts are nearest; a guess before anything was learned."""
        known = {answer.name: self._learned[answer.name] for answer in answers if answer.name in self._learned}
        if not known:
            return self.guess(answers)
        return min(known, key=lambda name: abs(float(np.mean(known[name])) - percept))

    def learn(self, percept: float, right: str) -> None:
        """Remembers what belonged to an answer, from feedback."""
        self._learned.setdefault(right, []).append(percept)

    def rate(self, percept: float, low: float, high: float) -> float:
        """A number between two ends: where the percept lies among all so far."""
        heard = self._learned.setdefault("", [])
        heard.append(percept)
        share = (sum(each < percept for each in heard) + 0.5) / len(heard)
        return low + share * (high - low)

    def guess(self, answers: tuple[Choice, ...]) -> str:
        return answers[int(self._chance.integers(len(answers)))].name


POSITIONS: Final = ("first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth")


def banded(signal: Floats, period_s: float) -> Floats:
    """(n,) or (n, k) in the band of touch: second order at either end, without a shift in time."""
    frequency = np.fft.rfftfreq(len(signal), period_s)
    low, high = BAND_HZ
    with np.errstate(divide="ignore"):
        gain = 1.0 / (1.0 + (low / np.maximum(frequency, _LEAST)) ** 2) / (1.0 + (frequency / high) ** 2)
    gain = gain.reshape(-1, *(1,) * (signal.ndim - 1))
    return np.asarray(np.fft.irfft(np.fft.rfft(signal, axis=0) * gain, len(signal), axis=0))


def _period_s(felt: Samples) -> float:
    return float(np.median(np.diff(felt["time_ns"].astype(np.int64)))) / 1e9


def hardness(felt: Samples, surface: Seen) -> float:
    """Mean over the onsets of log(rate of change of the felt force / speed of the approach), in log(N/s / (m/s))."""
    if len(felt) < 3:
        return math.log(_LEAST)
    period_s = _period_s(felt)
    normal = np.array(surface.normal)
    force = np.asarray(felt["force_n"] @ normal)
    rate = np.abs(np.gradient(banded(force, period_s), period_s))
    speed = -np.asarray(felt["velocity_m_per_s"] @ normal)
    window = max(2, round(WINDOW_S / period_s))
    found = []
    for at in onsets(force, window):
        before = max(0, at - window // 4)
        approach = float(speed[before : at + 1].max())
        if approach > 0.01:
            found.append(math.log(max(_LEAST, float(rate[at : at + window].max()) / approach)))
    return float(np.mean(found)) if found else math.log(_LEAST)


def onsets(force: Floats, window: int) -> list[int]:
    """Indices at which a force becomes felt, after it was not for a window."""
    over = np.abs(force) > ONSET_N
    found, quiet = [], window
    for at in np.flatnonzero(np.diff(over.astype(np.int8)) == 1) + 1:
        if not over[max(0, at - quiet) : at].any():
            found.append(int(at))
    return found


def fineness(felt: Samples, surface: Seen) -> float:
    """Log of the repetitions of the felt force per metre along the surface while touched, in log(1/m).

    The repetition is the strongest maximum of the autocorrelation, as of the pitch of a voice (Boersma, Proc. Institute
    of Phonetic Sciences Amsterdam 17, 1993): a pattern's own period, whichever of its harmonics is the strongest. Ways
    to and fro are added as autocorrelations, since a force along the surface turns with the way.
    """
    if len(felt) < 3:
        return math.log(_FINENESS_PER_M[0])
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
    first, last = (round(_CELLS_PER_M / each) for each in reversed(_FINENESS_PER_M))
    lags = np.arange(first, min(last, len(power) - 2) + 1)
    peaks = lags[(alike[lags] > alike[lags - 1]) & (alike[lags] >= alike[lags + 1]) & (alike[lags] > 0.0)]
    if len(peaks) == 0:
        return math.log(_FINENESS_PER_M[0])
    best = int(peaks[np.argmax(alike[peaks])])
    before, here, after = alike[best - 1 : best + 2]
    return math.log(_CELLS_PER_M / (best + 0.5 * (before - after) / (before - 2.0 * here + after)))


def _power_along(cell: npt.NDArray[np.int64], force: Floats, count: int) -> Floats:
    """Power spectrum (count,) of a force (n, 2) along the cells that it was felt in, both axes added; padded, so that
    it is that of a linear autocorrelation. Zeros for a way that is too short."""
    size = 2 * (count - 1)
    times = np.bincount(cell, minlength=1)
    kept = np.flatnonzero(times)
    if len(kept) < _LEAST_CELLS:
        return np.zeros(count)
    every = np.arange(kept[0], kept[-1] + 1)
    found: Floats = np.zeros(count)
    for axis in force.T:
        profile = np.interp(every, kept, np.bincount(cell, axis)[kept] / times[kept])
        found += np.abs(np.fft.rfft((profile - profile.mean()) * np.hanning(len(profile)), size)) ** 2
    return found


def loudness(felt: Samples, surface: Seen) -> float:
    """Log of the root mean square of the felt force, in log(N)."""
    if len(felt) < 3:
        return math.log(_LEAST)
    force = banded(np.asarray(felt["force_n"]), _period_s(felt))
    return math.log(max(_LEAST, float(np.sqrt((force**2).sum(axis=1).mean()))))


FEATURES: Final = {"hardness": hardness, "fineness": fineness, "loudness": loudness}


def rupture_felt_s(felt: Samples, surface: Seen) -> float | None:
    """When a fall of the force was felt, in s since the first sample; None: none was."""
    if len(felt) < 3:
        return None
    period_s = _period_s(felt)
    force = np.asarray(felt["force_n"] @ np.array(surface.normal))
    window = max(1, round(WINDOW_S / period_s))
    if len(force) <= window:
        return None
    fell = np.flatnonzero(force[:-window] - force[window:] > DROP_N)
    return None if len(fell) == 0 else float(fell[0] + window) * period_s
