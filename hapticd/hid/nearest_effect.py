"""Finds the device effect that is nearest to a mode.

A mode is a decaying sinusoid, the vibration of a tap or rupture. A periodic effect of the PID class, here a sine, has a
period and an envelope of straight lines: it begins with the attack level, has the magnitude after the attack time, and
reaches the fade level during the fade time, which ends with the effect. Levels are absolute, as in DirectInput's
DIENVELOPE and Linux' struct ff_envelope. Times are integer counts of the device's unit. For each choice of times,
non-negative least squares give the levels; the choice with the smallest error is the nearest effect.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain, combinations
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from hapticd.config.modes import Mode
from hapticd.hid.plan import PeriodicScales, Scale
from hapticd.rendering.displayability import DISPLAYABLE_RATE_FRACTION

MAX_EFFECT_S: Final = 0.1
"""Longest duration of an effect. If the daemon is killed, an effect ends only by its duration."""
COMPARED_DECAY_TIMES: Final = 6.0
"""Effect and mode are compared over this many decay times of the mode."""
TRIED_COUNTS: Final = 50
"""About this many counts are tried for each duration of the envelope, or all counts if it has fewer."""
_SAMPLES_PER_CYCLE: Final = 24
"""Effect and mode are compared at this many samples per cycle, within the limits below of the total number."""
_MIN_COMPARED_SAMPLES: Final = 3000
_MAX_COMPARED_SAMPLES: Final = 200_000
_LEVEL_SUBSETS: Final = tuple(chain.from_iterable(combinations(range(3), size) for size in (1, 2, 3)))
"""Sets of levels that may be above zero: 0 attack level, 1 magnitude, 2 fade level."""

_Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class NearestEffect:
    """The device effect nearest to a mode with an initial amplitude of 1 N: levels in N, times in counts."""

    period: int
    duration: int
    attack: int
    fade: int
    attack_level: float
    magnitude: float
    fade_level: float
    period_s: float
    duration_s: float
    error: float
    """RMS of the difference between effect and mode, divided by the RMS of the mode."""

    @property
    def frequency_hz(self) -> float:
        """The frequency of the effect's sine, in Hz."""
        return 1.0 / self.period_s

    @property
    def peak(self) -> float:
        """The largest level of the effect's envelope, in N."""
        return max(self.attack_level, self.magnitude, self.fade_level)


class _TriedTimes(NamedTuple):
    """Envelopes that are tried, as arrays of equal length: times in counts, and the corners of the envelope in s."""

    duration: npt.NDArray[np.int64]
    attack: npt.NDArray[np.int64]
    fade: npt.NDArray[np.int64]
    attack_s: _Floats
    fade_from_s: _Floats
    end_s: _Floats


@lru_cache(maxsize=1024)
def nearest_effect(mode: Mode, scales: PeriodicScales) -> NearestEffect | None:
    """Return the effect nearest to a mode, for a device with fields of these scales; None if it can play no effect."""
    times = _tried_times(min(COMPARED_DECAY_TIMES * mode.decay_time_s, MAX_EFFECT_S), scales)
    if not len(times.end_s):
        return None
    best: NearestEffect | None = None
    nearest = scales.period.counts(1.0 / mode.frequency_hz)
    for period in range(nearest - 1, nearest + 2):
        period_s = scales.period.quantity(period)
        if not scales.period.min_counts <= period <= scales.period.max_counts or period_s <= 0.0:
            continue
        gram, product, power = _products(mode, period_s, times)
        levels = _non_negative_levels(gram, product)
        at = int(np.argmax(np.einsum("ij,ij->i", levels, product)))
        shown = _rounded_levels(levels[at], scales)
        error = math.sqrt(max(0.0, float(power - 2.0 * shown @ product[at] + shown @ gram[at] @ shown)) / power)
        if best is None or error < best.error:
            best = NearestEffect(
                period=period,
                duration=int(times.duration[at]),
                attack=int(times.attack[at]),
                fade=int(times.fade[at]),
                attack_level=float(shown[0]),
                magnitude=float(shown[1]),
                fade_level=float(shown[2]),
                period_s=period_s,
                duration_s=float(times.end_s[at]),
                error=error,
            )
    return best


def streamed_error(mode: Mode, carried_hz: float) -> float:
    """Return the relative RMS error of a mode that is sent as `carried_hz` forces a second, each held until the next.

    The error is sqrt(2 - 2 sin(h) / h) with h = w / (2 carried_hz) and the mode's angular frequency w: that of a steady
    sine after its delay is removed. It is 1 above 0.4 of the rate, where the mode is muted or replaced.
    """
    if mode.frequency_hz > DISPLAYABLE_RATE_FRACTION * carried_hz:
        return 1.0
    half = 0.5 * mode.angular_frequency_rad_per_s / carried_hz
    return math.sqrt(max(0.0, 2.0 - 2.0 * math.sin(half) / half))


def _tried_counts(scale: Scale, max_s: float) -> npt.NDArray[np.int64]:
    """Return about TRIED_COUNTS evenly spaced counts of a time field, for times from 0 to `max_s`."""
    first, last = scale.counts(0.0), scale.counts(max_s)
    return np.arange(first, last + 1, max(1, round((last - first) / TRIED_COUNTS)))


def _tried_times(max_s: float, scales: PeriodicScales) -> _TriedTimes:
    durations, attacks = _tried_counts(scales.duration, max_s), _tried_counts(scales.attack_time, max_s)
    duration, attack = (grid.ravel() for grid in np.meshgrid(durations, attacks, indexing="ij"))
    end_s, attack_s = scales.duration.quantity(duration), scales.attack_time.quantity(attack)
    fade_time = scales.fade_time
    # The longest fade that begins after the attack.
    counts = np.floor((end_s - attack_s) * fade_time.counts_per_unit + fade_time.zero_counts + 1e-6)
    fade = np.clip(counts, fade_time.min_counts - 1, fade_time.max_counts).astype(np.int64)
    fade_from_s = np.maximum(end_s - fade_time.quantity(fade), attack_s)
    valid = (end_s > 0.0) & (attack_s >= 0.0) & (attack_s < end_s) & (fade >= fade_time.min_counts)
    return _TriedTimes(duration[valid], attack[valid], fade[valid], attack_s[valid], fade_from_s[valid], end_s[valid])


def _products(mode: Mode, period_s: float, times: _TriedTimes) -> tuple[_Floats, _Floats, float]:
    """Return the normal equations of the least-squares fit of levels, for n envelopes.

    The three basis functions are the contributions of attack level, magnitude and fade level. The results are their
    Gram matrix [n][3][3], their inner products with the mode [n][3], and the mode's mean square, all as means over the
    compared time. The inner product over a segment of the envelope is a difference of cumulative sums.
    """
    span_s = COMPARED_DECAY_TIMES * mode.decay_time_s
    cycles = span_s * max(mode.frequency_hz, 1.0 / period_s)
    count = min(max(_MIN_COMPARED_SAMPLES, math.ceil(_SAMPLES_PER_CYCLE * cycles)), _MAX_COMPARED_SAMPLES)
    time_s = (np.arange(count) + 0.5) * (span_s / count)
    wanted = np.exp(-mode.decay_rate_per_s * time_s) * np.sin(mode.angular_frequency_rad_per_s * time_s)
    sine = np.sin(2.0 * np.pi * time_s / period_s)
    square, shared = sine * sine, wanted * sine
    parts = (square, time_s * square, time_s * time_s * square, shared, time_s * shared)
    sums = np.array([np.concatenate(([0.0], np.cumsum(part))) for part in parts]) / count

    def between(from_s: _Floats, to_s: _Floats) -> _Floats:
        places = [np.clip(np.rint(at / span_s * count).astype(np.int64), 0, count) for at in (from_s, to_s)]
        found: _Floats = sums[:, places[1]] - sums[:, places[0]]
        return found

    start_s, size = np.zeros_like(times.end_s), len(times.end_s)
    gram, product = np.zeros((size, 3, 3)), np.zeros((size, 3))
    # The magnitude alone, from the attack to the fade.
    flat = between(times.attack_s, times.fade_from_s)
    gram[:, 1, 1] += flat[0]
    product[:, 1] += flat[3]
    # A segment from level `first` at u to the next level at v has the weights (v - t) / (v - u) and (t - u) / (v - u).
    for first, u, v in ((0, start_s, times.attack_s), (1, times.fade_from_s, times.end_s)):
        zero, one, two, with_zero, with_one = between(u, v)
        length = np.where(v > u, v - u, np.inf)
        crossed = ((u + v) * one - u * v * zero - two) / length**2
        gram[:, first, first] += (v * v * zero - 2.0 * v * one + two) / length**2
        gram[:, first + 1, first + 1] += (two - 2.0 * u * one + u * u * zero) / length**2
        gram[:, first, first + 1] += crossed
        gram[:, first + 1, first] += crossed
        product[:, first] += (v * with_zero - with_one) / length
        product[:, first + 1] += (with_one - u * with_zero) / length
    return gram, product, float(wanted @ wanted) / count


def _non_negative_levels(gram: _Floats, product: _Floats) -> _Floats:
    """Return the levels [n][3] of a non-negative least-squares fit: the best valid solution over `_LEVEL_SUBSETS`."""
    best, gained = np.zeros_like(product), np.zeros(len(product))
    for subset in _LEVEL_SUBSETS:
        rows = list(subset)
        part = gram[:, rows][:, :, rows]
        # The ridge sets a level without contribution to zero.
        ridge = 1e-12 * np.trace(part, axis1=1, axis2=2) + 1e-30
        part = part + ridge[:, None, None] * np.eye(len(rows))
        found = np.linalg.solve(part, product[:, rows, None])[:, :, 0]
        gain = np.einsum("ij,ij->i", found, product[:, rows])
        better = (found >= 0.0).all(axis=1) & (gain > gained)
        gained[better] = gain[better]
        best[better] = 0.0
        best[np.ix_(better, rows)] = found[better]
    return best


def _rounded_levels(levels: _Floats, scales: PeriodicScales) -> _Floats:
    """Return the levels, for a mode of 1 N, as rounded at the largest amplitude that the fields can hold."""
    full_n = max_coefficient_n(float(levels.max()), scales)
    shown = [scale.quantity(scale.counts(level * full_n)) for scale, level in zip(scales.levels, levels, strict=True)]
    return np.array(shown) / full_n


def max_coefficient_n(peak: float, scales: PeriodicScales) -> float:
    """Return the largest amplitude of a mode, in N, for which `peak` times the amplitude fits every level field."""
    return min(scale.quantity(scale.max_counts) for scale in scales.levels) / max(peak, 1e-9)
