"""A recording's columns on a uniform clock: what its times say, and what of them can be put right."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt

from hapticd.analysis.recordings.quantities import LARGEST, NAMES, Quantity
from hapticd.analysis.recordings.table import MAX_SAMPLES
from hapticd.analysis.statistics import Floats, require_scipy

LEAST_SAMPLES: Final = 16
UNIFORM: Final = 1e-3
"""A clock whose samples are no more than this part of a period from where they should be is taken as uniform."""
JITTER: Final = 0.5
"""Samples farther than this from where they should be, in periods, are missing or doubled ones."""
RATES_ALIKE: Final = 0.02
WANDER: Final = 0.01
PARTS: Final = 20
"""A clock that runs away from a uniform one is taken where each of so many parts of the recording has the mean rate
within so much; what is no clock at all, a position for one, changes more."""
OUTSTANDING: Final = 6.0
"""A distance between samples that is so many times the scatter of all of them off the usual one is a gap."""
MISSING: Final = 1.0
"""So many samples may be missing, as a part of those that are there;"""
OFTEN: Final = 50
FEW_GAPS: Final = 3
"""in so many places, or in one of so many samples."""
LOWEST_HZ: Final = 100.0
HIGHEST_HZ: Final = 1e6


Gaps: TypeAlias = tuple[tuple[int, int], ...]


def uniform(
    found: dict[Quantity, Floats], rate_hz: float | None, rounding_s: float
) -> tuple[dict[Quantity, Floats], float, Gaps]:
    """The columns at equal distances, the rate, and where samples are missing, which straight lines stand for there;
    times are rounded to `rounding_s`, or more than that. Raises ValueError."""
    _check_columns(found)
    columns: dict[Quantity, Floats] = {quantity: values for quantity, values in found.items() if quantity != "time"}
    if rate_hz is not None and not LOWEST_HZ <= rate_hz <= HIGHEST_HZ:
        raise ValueError(f"a rate of {rate_hz:g} Hz is out of range: recordings have {LOWEST_HZ:g} Hz to 1 MHz")
    if "time" not in found:
        if rate_hz is None:
            raise ValueError("has neither a column time_s nor a rate: say rate_hz in the YAML beside it")
        return columns, rate_hz, ()
    return _by_times(found["time"], columns, rate_hz, rounding_s)


def _check_columns(found: dict[Quantity, Floats]) -> None:
    # Of taps the speeds may be fewer than samples.
    lengths = {NAMES[quantity]: len(values) for quantity, values in found.items() if quantity != "speed"}
    if len(set(lengths.values())) != 1:
        counts = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise ValueError(f"the columns are of different length: {counts}")
    samples = next(iter(lengths.values()))
    if not LEAST_SAMPLES <= samples <= MAX_SAMPLES:
        raise ValueError(f"{samples} samples are no recording: it has {LEAST_SAMPLES} to {MAX_SAMPLES}")
    for quantity, values in found.items():
        broken = np.flatnonzero(~np.isfinite(values))
        if len(broken):
            raise ValueError(
                f"{NAMES[quantity]} is NaN or infinite in {len(broken)} samples, first in number {broken[0] + 1}"
            )
        large = float(np.abs(values).max(initial=0.0))
        if large > LARGEST[quantity]:
            raise ValueError(
                f"{NAMES[quantity]} reaches {large:.3g}, and nothing that a stylus records is over "
                f"{LARGEST[quantity]:g}: is it in another unit, or another column?"
            )


def _by_times(
    time_s: Floats, columns: dict[Quantity, Floats], rate_hz: float | None, rounding_s: float
) -> tuple[dict[Quantity, Floats], float, Gaps]:
    samples = len(time_s)
    since_s = time_s - time_s[0]
    at = np.arange(samples) - (samples - 1) / 2
    period_s = float(at @ since_s / (at @ at))
    rounding_s = max(rounding_s, 2 * float(np.spacing(np.abs(time_s).max())), _decimals(time_s))
    if 1.01 * period_s < rounding_s <= float(since_s[-1]) and np.all(np.diff(since_s) >= 0):
        raise ValueError(
            f"the times are rounded to {rounding_s:.3g} s, which is more than from one sample to the next "
            f"({period_s:.3g} s): leave them out and say rate_hz, in the YAML beside it"
        )
    number, period_s = _numbered(time_s, rounding_s)
    if not 1 / HIGHEST_HZ <= 1.001 * period_s <= 1.002 / LOWEST_HZ:
        raise ValueError(
            f"the times say {1 / period_s:.6g} Hz: a recording has {LOWEST_HZ:g} Hz to 1 MHz; which unit is the time "
            "in?"
        )
    if rate_hz is not None and abs(rate_hz * period_s - 1) > RATES_ALIKE:
        raise ValueError(
            f"the times say {1 / period_s:.6g} Hz, rate_hz says {rate_hz:g} Hz: is the time in another unit?"
        )
    jumps = np.flatnonzero(np.diff(number) > 1)
    gaps = tuple((int(number[jump]) + 1, int(number[jump + 1])) for jump in jumps)
    begin_s = float(np.mean(since_s - period_s * number))
    late = np.abs(since_s - begin_s - period_s * number) / period_s
    # Times that are rounded say a rate only so well, and a clock is made for a whole one.
    rate = 1.0 / period_s
    if abs(round(rate) / rate - 1) <= (rounding_s + UNIFORM * period_s) / float(since_s[-1]):
        rate = float(round(rate))
    every = np.arange(int(number[-1]) + 1)
    if late.max() <= max(UNIFORM, 0.5 * rounding_s / period_s * 1.001 + UNIFORM):
        return _each(columns, samples, lambda values: np.interp(every, number, values) if gaps else values), rate, gaps
    # After a gap a clock goes on anywhere between two samples.
    if late.max() > JITTER + (0.5 if gaps else 0.0) and (gaps or not _wanders(since_s, period_s)):
        worst = int(np.argmax(late))
        raise ValueError(
            f"the clock is {late[worst]:.2f} periods off a uniform one at sample {worst + 1} "
            f"({time_s[worst]:.9g} s), {JITTER:g} is the most that is put right: were samples lost, or doubled?"
        )
    even_s: Floats = np.asarray(begin_s + period_s * every, dtype=np.float64)

    def evened(values: Floats) -> Floats:
        found = _resampled(since_s, values, even_s)
        for begin, end in gaps:
            found[begin:end] = np.interp(even_s[begin:end], since_s, values)
        return found

    return _each(columns, samples, evened), 1.0 / period_s, gaps


def _each(columns: dict[Quantity, Floats], samples: int, made: Callable[[Floats], Floats]) -> dict[Quantity, Floats]:
    """What is made of the columns; speeds of taps, which are fewer, stay."""
    return {quantity: made(values) if len(values) == samples else values for quantity, values in columns.items()}


def _numbered(time_s: Floats, rounding_s: float) -> tuple[npt.NDArray[np.int64], float]:
    """(n,) numbers of the samples, which leap where some are missing, and the period in s. Raises ValueError for times
    that do not rise, and where too much is missing."""
    steps = np.diff(time_s)
    back = np.flatnonzero(steps <= 0)
    if len(back):
        raise ValueError(
            f"the time does not rise from sample {back[0] + 1} to {back[0] + 2} ({time_s[back[0]]:.9g} s, then "
            f"{time_s[back[0] + 1]:.9g} s): is it the right column? Times are not needed where the YAML has columns "
            "without them, and rate_hz"
        )
    usual = float(np.median(steps))
    spread = 1.4826 * float(np.median(np.abs(steps - usual)))
    jumps = np.flatnonzero(steps > usual + max(JITTER * usual, OUTSTANDING * spread) + rounding_s)
    # One rate for all stretches, whatever lies between them.
    along = square = 0.0
    for begin, end in zip([0, *(jumps + 1)], [*(jumps + 1), len(time_s)], strict=True):
        at = np.arange(end - begin) - (end - begin - 1) / 2
        along += float(at @ (time_s[begin:end] - time_s[begin]))
        square += float(at @ at)
    period_s = along / square if square > 0 else usual
    missing = np.maximum(np.round(steps[jumps] / period_s) - 1, 0)
    if missing.sum() > MISSING * len(time_s) or len(jumps) > max(FEW_GAPS, len(time_s) / OFTEN):
        raise ValueError(
            f"samples are missing: between {time_s[jumps[0]]:.9g} s and {time_s[jumps[0] + 1]:.9g} s pass "
            f"{steps[jumps[0]] / usual:.1f} periods, in {len(jumps)} places like this, {missing.sum():.0f} samples in "
            f"all beside {len(time_s)}; at most {100 * MISSING:.0f} % may be, and one gap in {OFTEN} samples"
        )
    more = np.ones(len(time_s), dtype=np.int64)
    more[0] = 0
    more[jumps + 1] += missing.astype(np.int64)
    return np.cumsum(more), period_s


def _wanders(since_s: Floats, period_s: float) -> bool:
    """Whether a clock goes evenly from each sample to the next and at one rate throughout, though not for ever."""
    steps = np.diff(since_s) / period_s
    edges = np.linspace(0, len(since_s) - 1, min(PARTS, len(steps) // 50 + 1) + 1).round().astype(int)
    rates = np.diff(since_s[edges]) / np.diff(edges) / period_s
    return bool(np.abs(steps - 1).max() < JITTER and np.abs(rates - 1).max() < WANDER)


def _decimals(time_s: Floats) -> float:
    """The decimal place to which times are rounded; 0 where they have all the places that there are.

    The later half decides: with so many digits a number, the largest have the fewest places.
    """
    later = time_s[len(time_s) // 2 :]
    for place in range(1, 10):
        scaled = later * 10.0**place
        if np.all(np.abs(scaled - np.round(scaled)) <= 1e-6 + 4 * np.spacing(np.abs(scaled))):
            return 10.0**-place
    return 0.0


def _resampled(time_s: Floats, values: Floats, even_s: Floats) -> Floats:
    """By a cubic spline; what stands still at an end of the range, as clipped samples do, goes on to do so."""
    require_scipy()
    from scipy.interpolate import CubicSpline

    found = np.asarray(CubicSpline(time_s, values)(even_s), dtype=np.float64)
    left = np.clip(np.searchsorted(time_s, even_s, side="right") - 1, 0, len(values) - 2)
    for extreme in (values.max(), values.min()):
        held = (values[left] == extreme) & (values[left + 1] == extreme)
        found[held] = extreme
    return found
