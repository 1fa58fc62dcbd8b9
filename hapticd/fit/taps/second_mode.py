"""A second mode that is struck together with the first."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hapticd.analysis.recordings.sensor import Sensor
from hapticd.analysis.statistics import Estimate, Floats, common, improbable, through_origin
from hapticd.base.yaml_source import Json
from hapticd.config.modes import Mode
from hapticd.fit.exclusions import LeftOut
from hapticd.fit.taps.hit import (
    CHANCE,
    COLOURED,
    LEAST_TAPS,
    NO_NOISE,
    WELL_EXPLAINED,
    Hit,
    TapHit,
    colour,
    levelled,
    noise_of,
)
from hapticd.fit.taps.law import Amplitudes, json_table, table
from hapticd.fit.taps.ringing import Ringing, fit_ringing

SECOND_GAIN: Final = 0.01
"""A second mode explains so much of the variance besides, at least."""
SECOND_TAPS: Final = 12
"""It is sought in so many taps, the loudest."""
AGREEING: Final = 0.7
"""So large a part of the pairs has the same two frequencies."""
ALIKE: Final = 0.1
"""And its frequency is the same in them within so much."""
EXPLAINED: Final = 0.5
"""A tap of whose variance less is explained is not used."""
LEAST_SAMPLES: Final = 24
"""That two modes are fitted to."""
LONGEST: Final = 4096
"""Samples after the onset, that two modes are fitted to."""
PULSE: Final = 0.3
"""A second mode that falls to 1/e within this part of its own period is none."""
MOST_RATIO: Final = 10.0
"""Of a second mode, as materials have it."""


@dataclass(frozen=True, slots=True)
class SecondMode:
    """A mode that is struck together with the first, and the first as it is beside it."""

    frequency_hz: Estimate
    decay_time_s: Estimate
    ratio: Estimate
    """Its coefficient over the first one's."""
    first_slope_per_s: Estimate
    """Of the first one's coefficient over the speed."""
    first_frequency_hz: Estimate
    first_decay_time_s: Estimate
    amplitudes: Amplitudes
    """Of the first, as TapFit's."""
    variance_accounted_for: float
    """By both, median over the taps."""
    alone: float
    """By one mode, median over the taps."""
    kept: bool
    """Whether the material has it without being asked: one mode explains too little."""

    def to_dict(self) -> dict[str, Json]:
        return {
            "frequency_hz": self.frequency_hz.to_dict(),
            "decay_time_s": self.decay_time_s.to_dict(),
            "ratio": self.ratio.to_dict(),
            "first_slope_per_s": self.first_slope_per_s.to_dict(),
            "first_frequency_hz": self.first_frequency_hz.to_dict(),
            "first_decay_time_s": self.first_decay_time_s.to_dict(),
            "amplitudes": json_table(self.amplitudes),
            "variance_accounted_for": self.variance_accounted_for,
            "variance_by_one_mode": self.alone,
            "kept": self.kept,
        }


def pair_of(measured: Floats, rate_hz: float, ringing: Ringing, sensor: Sensor | None) -> Ringing | None:
    """Two modes, where they explain so much more than `ringing` that it is no luck; else None."""
    if len(measured) < LEAST_SAMPLES:
        return None
    head = measured[: math.ceil(ringing.onset_s * rate_hz) + LONGEST]
    pair = fit_ringing(head, rate_hz, modes=2, onset_s=ringing.onset_s, sensor=sensor)
    left = ringing.residual[: len(head)]
    freedom = len(head) - 6
    one, two = float(left @ left), float(pair.residual @ pair.residual)
    turns = float(pair.angular_frequency_rad_per_s.min()) * len(head) / rate_hz
    return pair if improbable(one, freedom, two, freedom - 3) < CHANCE and turns > math.pi else None


def as_pairs(hits: list[Hit], left: LeftOut) -> tuple[list[Hit], SecondMode | None]:
    """Where one mode explains too little of the median tap and most have the same two: the taps as these two have
    them, the louder one first, and what they have in common. Elsewhere those taps that one mode does for."""
    alone = float(np.median([ringing.variance_accounted_for for _, ringing in hits])) if hits else 1.0
    usual = None if alone >= WELL_EXPLAINED else _usual(hits)
    kept = [hit for hit in hits if hit[0].alone]
    if usual is None:
        _tell(hits, left)
        return kept, None
    paired: list[Hit] = []
    pairs: list[tuple[TapHit, Ringing]] = []
    others: list[TapHit] = []
    for tap, ringing in hits:
        pair = None if tap.pair is None else _in_order(tap.pair, usual)
        off = abs(math.log(tap.angular_frequency_rad_per_s) - usual[0])
        if pair is not None:
            paired.append(_first_of(tap, pair))
            pairs.append((paired[-1][0], pair))
        elif ringing.variance_accounted_for >= WELL_EXPLAINED and off < ALIKE:
            paired.append((tap, ringing))
        else:
            others.append(tap)
    upright = _upright(pairs)
    second = _pair_of(upright, _together(upright), alone, True) if len(upright) >= LEAST_TAPS else None
    if second is None:
        _tell(hits, left)
        return kept, None
    for tap in others:
        left.add(tap.recording, "it has not the two modes of the others", "tap", tap.onset_s)
    return paired, second


def _tell(hits: list[Hit], left: LeftOut) -> None:
    for tap, ringing in hits:
        if not tap.alone:
            share = 100 * ringing.variance_accounted_for
            reason = f"a decaying sinusoid explains {share:.0f} % of it, and the others do not have the two that it has"
            left.add(tap.recording, reason, "tap", tap.onset_s)


def _usual(hits: Sequence[Hit]) -> Floats | None:
    """Logarithms of the two angular frequencies that most taps have, of the louder one first; None where one mode is
    enough, or where they do not agree."""
    pairs = [tap.pair for tap, _ in hits if tap.pair is not None]
    if len(pairs) < max(LEAST_TAPS, len(hits) / 2):
        return None
    # By frequency: which of them is louder may change from tap to tap.
    rising = [np.argsort(pair.angular_frequency_rad_per_s) for pair in pairs]
    logs = np.array(
        [np.log(pair.angular_frequency_rad_per_s[order]) for pair, order in zip(pairs, rising, strict=True)]
    )
    usual = np.median(logs, axis=0)
    alike = np.all(np.abs(logs - usual) < ALIKE, axis=1)
    if np.sum(alike) < max(LEAST_TAPS, AGREEING * len(pairs)):
        return None
    sizes = np.array(
        [
            (np.abs(pair.coefficients) / np.sqrt(pair.decay_rate_per_s))[order]
            for pair, order, same in zip(pairs, rising, alike, strict=True)
            if same
        ]
    )
    first = 0 if np.median(sizes[:, 0] / sizes[:, 1]) >= 1 else 1
    return np.array([usual[first], usual[1 - first]])


def _in_order(pair: Ringing, usual: Floats) -> Ringing | None:
    """With the modes in the order of these; None where they are others."""
    for order in ([0, 1], [1, 0]):
        if np.all(np.abs(np.log(pair.angular_frequency_rad_per_s[order]) - usual) < ALIKE):
            places = [*order, *(2 + mode for mode in order), *(4 + mode for mode in order), 6]
            return dataclasses.replace(
                pair,
                coefficients=pair.coefficients[order],
                decay_rate_per_s=pair.decay_rate_per_s[order],
                angular_frequency_rad_per_s=pair.angular_frequency_rad_per_s[order],
                covariance=pair.covariance[np.ix_(places, places)],
            )
    return None


def _first_of(tap: TapHit, pair: Ringing) -> Hit:
    """The tap as the first of two modes has it, and that mode as if it were fitted alone."""
    mode = Mode(float(pair.decay_rate_per_s[0]), float(pair.angular_frequency_rad_per_s[0]))
    coefficient = float(pair.coefficients[0])
    places = [0, 2, 4, 6]
    first = dataclasses.replace(
        pair,
        coefficients=pair.coefficients[:1],
        decay_rate_per_s=pair.decay_rate_per_s[:1],
        angular_frequency_rad_per_s=pair.angular_frequency_rad_per_s[:1],
        covariance=pair.covariance[np.ix_(places, places)],
    )
    hit = dataclasses.replace(
        tap,
        onset_s=tap.begin_s + pair.onset_s,
        coefficient_m_per_s2=coefficient,
        first_peak_m_per_s2=coefficient * mode.peak,
        decay_rate_per_s=mode.decay_rate_per_s,
        angular_frequency_rad_per_s=mode.angular_frequency_rad_per_s,
        variance_accounted_for=pair.variance_accounted_for,
        noise_m_per_s2=max(pair.noise_m_per_s2, NO_NOISE * abs(coefficient)),
        measured=tap.measured[: len(pair.residual)],
        modelled=tap.measured[: len(pair.residual)] - pair.residual,
        pair=pair,
    )
    return hit, first


def _upright(pairs: Sequence[Hit]) -> list[Hit]:
    """Those whose first modes begin as most do, with positive coefficients."""
    signs = np.sign([tap.coefficient_m_per_s2 for tap, _ in pairs])
    usual = 1.0 if np.sum(signs) >= 0 else -1.0
    found = [tap if usual > 0 else tap.turned() for (tap, _), sign in zip(pairs, signs, strict=True) if sign == usual]
    return [(tap, tap.pair) for tap in found if tap.pair is not None]


def _together(both: Sequence[Hit]) -> float:
    return float(np.median([pair.variance_accounted_for for _, pair in both]))


def second_mode(hits: list[Hit], explained: float) -> SecondMode | None:
    """A mode that most of the loudest taps have besides, at one frequency, where one explains so much."""
    loudest = sorted(hits, key=lambda hit: hit[0].noise_m_per_s2 / hit[0].coefficient_m_per_s2)[:SECOND_TAPS]
    coloured = [(tap, ringing) for tap, ringing in loudest if colour(tap, ringing) > COLOURED]
    enough = max(LEAST_TAPS, len(loudest) / 2)
    if len(coloured) < enough:
        return None
    tried = ((tap, pair_of(tap.measured, tap.rate_hz, ringing, tap.sensor)) for tap, ringing in coloured)
    both = [(tap, pair) for tap, pair in tried if pair is not None]
    if len(both) < enough:
        return None
    logs = np.log([pair.angular_frequency_rad_per_s for _, pair in both])
    alike = np.all(np.abs(logs - np.median(logs, axis=0)) < ALIKE, axis=1)
    together = _together(both)
    if np.mean(alike) < AGREEING or np.sum(alike) < LEAST_TAPS or together < explained + SECOND_GAIN:
        return None
    return _pair_of([one for one, same in zip(both, alike, strict=True) if same], together, explained, False)


def _pair_of(both: list[Hit], together: float, alone: float, kept: bool) -> SecondMode | None:
    """What they have in common; None where that is no pair, but one mode of another shape."""
    speeds = np.array([tap.speed_m_per_s for tap, _ in both])
    noise = noise_of([tap for tap, _ in both])
    relative = noise / np.array([tap.first_peak_m_per_s2 for tap, _ in both]) ** 2
    coefficients = np.array([pair.coefficients for _, pair in both])
    decays = np.array([pair.decay_rate_per_s for _, pair in both])
    angulars = np.array([pair.angular_frequency_rad_per_s for _, pair in both])
    covariances = np.array([pair.covariance for _, pair in both])
    own = np.array([np.diag(covariance) for covariance in covariances])
    ratios = coefficients[:, 1] / coefficients[:, 0]
    of_ratio = ratios**2 * (
        own[:, 0] / coefficients[:, 0] ** 2
        + own[:, 1] / coefficients[:, 1] ** 2
        - 2 * covariances[:, 0, 1] / (coefficients[:, 0] * coefficients[:, 1])
    )

    def shared(values: Floats, variances: Floats) -> Estimate:
        return common(np.log(values), levelled(variances / values**2, relative))

    of_first = levelled(own[:, 0], noise)
    slope = through_origin(speeds, coefficients[:, 0], of_first, speeds**2).coefficients[0]
    ratio = common(ratios, levelled(of_ratio, relative))
    decay = [shared(decays[:, mode], own[:, 2 + mode]) for mode in range(2)]
    angular = [shared(angulars[:, mode], own[:, 4 + mode]) for mode in range(2)]
    same = abs(angular[1].value - angular[0].value) < ALIKE
    # In periods of its own; what is over sooner is a pulse.
    lasts = math.exp(angular[1].value - decay[1].value) / (2 * math.pi)
    if slope.value <= 0 or abs(ratio.value) > MOST_RATIO or same or lasts < PULSE:
        return None
    return SecondMode(
        frequency_hz=angular[1].mapped(lambda log: math.exp(log) / (2 * math.pi)),
        decay_time_s=decay[1].mapped(lambda log: math.exp(-log)),
        ratio=ratio,
        first_slope_per_s=slope,
        first_frequency_hz=angular[0].mapped(lambda log: math.exp(log) / (2 * math.pi)),
        first_decay_time_s=decay[0].mapped(lambda log: math.exp(-log)),
        amplitudes=table(speeds, coefficients[:, 0], of_first),
        variance_accounted_for=together,
        alone=alone,
        kept=kept,
    )
