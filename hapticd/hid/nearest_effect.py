"""The nearest effect to a mode, of those that a device can play itself.

A sine of the PID class has a period, and an envelope of straight lines: from the attack level to the magnitude over the
attack time, and from there to the fade level over the fade time, at the end of its duration. Levels are absolute, as
the magnitude is (so in DirectInput's DIENVELOPE and in Linux' struct ff_envelope). Times are whole counts of the
device's. The nearest such effect to a mode is found by least squares over its levels, none of them below zero, for each
choice of its times.
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
from hapticd.hid.plan import Numbers, Scale
from hapticd.rendering.displayability import DISPLAYABLE_RATE_FRACTION

LONGEST_S: Final = 0.1
"""No effect plays longer: nothing but its end stops it where the daemon is gone."""
SPAN: Final = 6.0
"""So many decay times are compared."""
STEPS: Final = 50
"""Times are tried at this many places over the span, or at every count if those are fewer."""
_SAMPLES: Final = 3000
_PER_CYCLE: Final = 24
_MOST_SAMPLES: Final = 200_000
_SUBSETS: Final = tuple(chain.from_iterable(combinations(range(3), size) for size in (1, 2, 3)))

_Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class NearestEffect:
    """The nearest effect to a mode with a coefficient of one: times in counts of the device, levels over one."""

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
    """RMS of the difference from the mode over the mode's."""

    @property
    def frequency_hz(self) -> float:
        """What is shown in place of the mode's frequency."""
        return 1.0 / self.period_s

    @property
    def peak(self) -> float:
        """The largest level."""
        return max(self.attack_level, self.magnitude, self.fade_level)


class _Times(NamedTuple):
    """What is tried, each of the same length: counts, and where the lines of the envelope meet, s."""

    duration: npt.NDArray[np.int64]
    attack: npt.NDArray[np.int64]
    fade: npt.NDArray[np.int64]
    attack_s: _Floats
    fade_from_s: _Floats
    end_s: _Floats


@lru_cache(maxsize=1024)
def nearest_effect(mode: Mode, numbers: Numbers) -> NearestEffect | None:
    """The nearest effect that a device with these numbers can play; None where there is none at all."""
    times = _times(min(SPAN * mode.decay_time_s, LONGEST_S), numbers)
    if not len(times.end_s):
        return None
    best: NearestEffect | None = None
    nearest = numbers.period.counts(1.0 / mode.frequency_hz)
    for period in sorted({*range(nearest - 1, nearest + 2)}):
        period_s = numbers.period.quantity(period)
        if not numbers.period.least <= period <= numbers.period.most or period_s <= 0.0:
            continue
        gram, product, power = _products(mode, period_s, times)
        levels = _not_negative(gram, product)
        at = int(np.argmax(np.einsum("ij,ij->i", levels, product)))
        shown = _rounded(levels[at], numbers)
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
    """RMS of the difference over RMS, of a mode that is held for a frame of the link at a time.

    sqrt(2 - 2 sin(h) / h), h = w / (2 rate), is that of a steady sine once its delay is taken off. 1 above 0.4 of the
    rate, where nothing is shown, or something else.
    """
    if mode.frequency_hz > DISPLAYABLE_RATE_FRACTION * carried_hz:
        return 1.0
    half = 0.5 * mode.angular_frequency_rad_per_s / carried_hz
    return math.sqrt(max(0.0, 2.0 - 2.0 * math.sin(half) / half))


def _multiples(scale: Scale, longest: float) -> npt.NDArray[np.int64]:
    """Counts of times from nothing to the longest, at most about STEPS of them."""
    first, last = scale.counts(0.0), scale.counts(longest)
    return np.arange(first, last + 1, max(1, round((last - first) / STEPS)))


def _times(longest: float, numbers: Numbers) -> _Times:
    durations, attacks = _multiples(numbers.duration, longest), _multiples(numbers.attack_time, longest)
    duration, attack = (grid.ravel() for grid in np.meshgrid(durations, attacks, indexing="ij"))
    end_s, attack_s = numbers.duration.quantity(duration), numbers.attack_time.quantity(attack)
    fade_time = numbers.fade_time
    # The longest fade that begins after the attack.
    counts = np.floor((end_s - attack_s) * fade_time.counts_per_unit + fade_time.zero_counts + 1e-6)
    fade = np.clip(counts, fade_time.least - 1, fade_time.most).astype(np.int64)
    fade_from_s = np.maximum(end_s - fade_time.quantity(fade), attack_s)
    sound = (end_s > 0.0) & (attack_s >= 0.0) & (attack_s < end_s) & (fade >= fade_time.least)
    return _Times(duration[sound], attack[sound], fade[sound], attack_s[sound], fade_from_s[sound], end_s[sound])


def _products(mode: Mode, period_s: float, times: _Times) -> tuple[_Floats, _Floats, float]:
    """Of what attack level, magnitude and fade level contribute to the effects: their products with each other
    [n][3][3], with the mode [n][3], and the mode's with itself; means over the span.

    Sums up to each sample are made once; every product over a stretch between two knots is a difference of them.
    """
    span_s = SPAN * mode.decay_time_s
    cycles = span_s * max(mode.frequency_hz, 1.0 / period_s)
    count = min(max(_SAMPLES, math.ceil(_PER_CYCLE * cycles)), _MOST_SAMPLES)
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
    # A line from level `first` at u to the next one at v: (v - t) / (v - u) of the one, (t - u) / (v - u) of the other.
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


def _not_negative(gram: _Floats, product: _Floats) -> _Floats:
    """[n][3]: least squares with no level below zero. The best of the solutions in which some of them are zero."""
    best, gained = np.zeros_like(product), np.zeros(len(product))
    for subset in _SUBSETS:
        rows = list(subset)
        part = gram[:, rows][:, :, rows]
        # What contributes nothing gets nothing.
        ridge = 1e-12 * np.trace(part, axis1=1, axis2=2) + 1e-30
        part = part + ridge[:, None, None] * np.eye(len(rows))
        found = np.linalg.solve(part, product[:, rows, None])[:, :, 0]
        gain = np.einsum("ij,ij->i", found, product[:, rows])
        better = (found >= 0.0).all(axis=1) & (gain > gained)
        gained[better] = gain[better]
        best[better] = 0.0
        best[np.ix_(better, rows)] = found[better]
    return best


def _rounded(levels: _Floats, numbers: Numbers) -> _Floats:
    """The levels as the device has them where the strike is as strong as it can be; weaker ones are coarser."""
    full_n = most_n(float(levels.max()), numbers)
    scales = (numbers.attack_level, numbers.magnitude, numbers.fade_level)
    shown = [scale.quantity(scale.counts(level * full_n)) for scale, level in zip(scales, levels, strict=True)]
    return np.array(shown) / full_n


def most_n(peak: float, numbers: Numbers) -> float:
    """The largest coefficient, N, whose largest level every field can hold."""
    return min(scale.largest for scale in (numbers.attack_level, numbers.magnitude, numbers.fade_level)) / max(
        peak, 1e-9
    )
