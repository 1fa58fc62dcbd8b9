"""A second mode that is struck together with the first."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from hapticd.fit.regression import Estimate, Floats, common, improbable, through_origin
from hapticd.fit.ringing import Ringing, fit_ringing
from hapticd.fit.tap_hit import CHANCE, COLOURED, LEAST_TAPS, TapHit, colour, levelled, noise_of
from hapticd.fit.tap_law import Amplitudes, json_of, json_table, table
from hapticd.yaml_source import Json

SECOND_GAIN: Final = 0.01
"""A second mode explains so much of the variance besides, at least."""
SECOND_TAPS: Final = 12
"""It is sought in so many taps, the loudest."""
ALIKE: Final = 0.1
"""And its frequency is the same in them within so much."""
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

    def to_dict(self) -> dict[str, Json]:
        return {
            "frequency_hz": json_of(self.frequency_hz),
            "decay_time_s": json_of(self.decay_time_s),
            "ratio": json_of(self.ratio),
            "first_slope_per_s": json_of(self.first_slope_per_s),
            "first_frequency_hz": json_of(self.first_frequency_hz),
            "first_decay_time_s": json_of(self.first_decay_time_s),
            "amplitudes": json_table(self.amplitudes),
            "variance_accounted_for": self.variance_accounted_for,
        }


def second_mode(hits: list[tuple[TapHit, Ringing]], explained: float) -> SecondMode | None:
    """A mode that most of the loudest taps have besides, at one frequency."""
    loudest = sorted(hits, key=lambda hit: hit[0].noise_m_per_s2 / hit[0].coefficient_m_per_s2)[:SECOND_TAPS]
    coloured = [(tap, ringing) for tap, ringing in loudest if colour(tap, ringing) > COLOURED]
    enough = max(LEAST_TAPS, len(loudest) / 2)
    if len(coloured) < enough:
        return None
    both: list[tuple[TapHit, Ringing]] = []
    for tap, ringing in coloured:
        pair = fit_ringing(tap.measured, tap.rate_hz, modes=2, onset_s=ringing.onset_s, sensor=tap.sensor)
        freedom = len(ringing.residual) - 6
        one, two = float(ringing.residual @ ringing.residual), float(pair.residual @ pair.residual)
        turns = float(pair.angular_frequency_rad_per_s.min()) * len(ringing.residual) / tap.rate_hz
        if improbable(one, freedom, two, freedom - 3) < CHANCE and turns > math.pi:
            both.append((tap, pair))
    if len(both) < enough:
        return None
    logs = np.log([pair.angular_frequency_rad_per_s for _, pair in both])
    alike = np.all(np.abs(logs - np.median(logs, axis=0)) < ALIKE, axis=1)
    together = float(np.median([pair.variance_accounted_for for _, pair in both]))
    if np.mean(alike) < 0.7 or np.sum(alike) < LEAST_TAPS or together < explained + SECOND_GAIN:
        return None
    return _pair_of([one for one, same in zip(both, alike, strict=True) if same], together)


def _pair_of(both: list[tuple[TapHit, Ringing]], together: float) -> SecondMode | None:
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
    )
