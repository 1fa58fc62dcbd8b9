"""One tap as it was found and fitted, and what its noise says of its figures."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Protocol, TypeAlias

import numpy as np

from hapticd.analysis.recordings.sensor import Sensor
from hapticd.analysis.statistics import FitError, Floats
from hapticd.base.yaml_source import Json
from hapticd.config.modes import Mode
from hapticd.fit.plain_data import fields_of
from hapticd.fit.taps.ringing import Ringing

LEAST_TAPS: Final = 3
LEAST_SPEED_M_PER_S: Final = 1e-3
MOST_SPEED_M_PER_S: Final = 10.0
SPEED_RANGE: Final = 1.2
"""The fastest tap is at least so many times as fast as the slowest."""
ALIKE_NOISE: Final = 1.5
NO_NOISE: Final = 1e-9
"""Of the coefficient: the least noise a tap is taken to have."""
COLOURED: Final = 1.3
"""A residual so many times the noise before the onset has more in it than noise."""
CHANCE: Final = 0.01
WELL_EXPLAINED: Final = 0.95
"""Of the variance of the median tap: what explains less is reported."""


@dataclass(frozen=True, slots=True)
class TapHit:
    """One tap: what was fitted, and the stretch of the recording that it was fitted to."""

    recording: str
    onset_s: float
    speed_m_per_s: float
    coefficient_m_per_s2: float
    first_peak_m_per_s2: float
    decay_rate_per_s: float
    angular_frequency_rad_per_s: float
    variance_accounted_for: float
    noise_m_per_s2: float
    begin_s: float
    """Of the stretch, on the recording's clock."""
    rate_hz: float
    measured: Floats
    modelled: Floats
    sensor: Sensor | None = None
    pair: Ringing | None = None
    """Two modes, where one explains too little and two explain more."""
    alone: bool = True
    """Whether one mode does for it."""

    def turned(self) -> TapHit:
        """With the sign of the acceleration turned."""
        pair = self.pair
        if pair is not None:
            pair = dataclasses.replace(pair, coefficients=-pair.coefficients, residual=-pair.residual)
        return dataclasses.replace(
            self,
            coefficient_m_per_s2=-self.coefficient_m_per_s2,
            first_peak_m_per_s2=-self.first_peak_m_per_s2,
            measured=-self.measured,
            modelled=-self.modelled,
            pair=pair,
        )

    def to_dict(self) -> dict[str, Json]:
        names = ("recording", "onset_s", "speed_m_per_s", "coefficient_m_per_s2", "first_peak_m_per_s2")
        return {
            **fields_of(self, *names),
            "frequency_hz": self.angular_frequency_rad_per_s / (2 * math.pi),
            "decay_time_s": 1 / self.decay_rate_per_s,
            "variance_accounted_for": self.variance_accounted_for,
        }


Hit: TypeAlias = tuple[TapHit, Ringing]
"""A tap, and the mode that was fitted to it."""


def noise_of(taps: Sequence[TapHit]) -> Floats:
    """(n,) variances of the noise; what differs no more than short stretches do by chance is taken as alike."""
    found = np.array([tap.noise_m_per_s2 for tap in taps])
    usual = float(np.median(found))
    return np.where((found < ALIKE_NOISE * usual) & (usual < ALIKE_NOISE * found), usual, found) ** 2


def levelled(own: Floats, scale: Floats) -> Floats:
    """The variances' common factor: of what a tap of its noise would have. Their own luck does not enter."""
    return np.asarray(scale * np.median(own / scale), dtype=np.float64)


def peak_variance(ringing: Ringing) -> float:
    """Of A p(B, w), to first order."""
    values = np.array(
        [ringing.coefficients[0], ringing.decay_rate_per_s[0], ringing.angular_frequency_rad_per_s[0]], dtype=np.float64
    )

    def peak(at: Floats) -> float:
        return float(at[0]) * Mode(float(at[1]), float(at[2])).peak

    slopes = np.empty(3)
    for which in range(3):
        step = np.zeros(3)
        step[which] = 1e-5 * values[which]
        slopes[which] = (peak(values + step) - peak(values - step)) / (2 * step[which])
    return float(slopes @ ringing.covariance[:3, :3] @ slopes)


def colour(tap: TapHit, ringing: Ringing) -> float:
    """What is left over while it rings, over what was there before."""
    onset = max(2, math.floor(ringing.onset_s * tap.rate_hz))
    end = math.ceil((ringing.onset_s + 5 / tap.decay_rate_per_s) * tap.rate_hz)
    before = float(np.std(ringing.residual[:onset]))
    return float(np.std(ringing.residual[onset:end])) / before if before > 0 else math.inf


@dataclass(frozen=True, slots=True)
class Figures:
    """Those of all taps, (n,) each; variances are of the noise alone, without the luck of each tap."""

    speeds: Floats
    amplitudes: Floats
    """A, in m/s^2."""
    peaks: Floats
    """The largest accelerations of the first cycles."""
    decays: Floats
    """Logarithms of B."""
    angulars: Floats
    """Logarithms of w."""
    noise: Floats
    of_amplitude: Floats
    of_peak: Floats
    of_decay: Floats
    of_angular: Floats

    @classmethod
    def of(cls, hits: Sequence[Hit]) -> Figures:
        taps = [tap for tap, _ in hits]
        noise = noise_of(taps)
        decays = np.log([tap.decay_rate_per_s for tap in taps])
        angulars = np.log([tap.angular_frequency_rad_per_s for tap in taps])
        peaks = np.array([tap.first_peak_m_per_s2 for tap in taps])
        # By the peak, whose error has little to do with those of decay and frequency.
        relative = noise / peaks**2
        spreads = np.array([np.diag(ringing.covariance)[:3] for _, ringing in hits])
        return cls(
            speeds=np.array([tap.speed_m_per_s for tap in taps]),
            amplitudes=np.array([tap.coefficient_m_per_s2 for tap in taps]),
            peaks=peaks,
            decays=decays,
            angulars=angulars,
            noise=noise,
            of_amplitude=levelled(spreads[:, 0], noise),
            of_peak=levelled(np.array([peak_variance(ringing) for _, ringing in hits]), noise),
            of_decay=levelled(spreads[:, 1] / np.exp(2 * decays), relative),
            of_angular=levelled(spreads[:, 2] / np.exp(2 * angulars), relative),
        )


class Approached(Protocol):
    """What a tap of any form has."""

    @property
    def recording(self) -> str: ...

    @property
    def onset_s(self) -> float: ...

    @property
    def speed_m_per_s(self) -> float: ...


def check_speeds(taps: Sequence[Approached]) -> None:
    """Raises FitError where speeds cannot be, or are all about the same."""
    slowest, fastest = min(taps, key=lambda tap: tap.speed_m_per_s), max(taps, key=lambda tap: tap.speed_m_per_s)
    for tap, allowed, unit in (
        (fastest, fastest.speed_m_per_s <= MOST_SPEED_M_PER_S, "is it in mm/s, or are columns swapped?"),
        (slowest, slowest.speed_m_per_s >= LEAST_SPEED_M_PER_S, "is it in km/s, or the position in the wrong unit?"),
    ):
        if not allowed:
            raise FitError(
                f"{tap.recording}: the tap at {tap.onset_s:.4g} s has a speed of {tap.speed_m_per_s:.4g} m/s, taps "
                f"have {LEAST_SPEED_M_PER_S:g} to {MOST_SPEED_M_PER_S:g}: {unit}"
            )
    if fastest.speed_m_per_s < SPEED_RANGE * slowest.speed_m_per_s:
        raise FitError(
            f"all {len(taps)} taps have about one speed ({slowest.speed_m_per_s:.4g} to "
            f"{fastest.speed_m_per_s:.4g} m/s): a slope over speed needs slow ones and fast ones"
        )
