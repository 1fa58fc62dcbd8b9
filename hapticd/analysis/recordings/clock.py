"""Quantities of a recording, and resampling of its columns to a uniform clock.

Resampling corrects jitter of the times. Gaps are bridged by straight lines. Worse times are refused.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt

from hapticd.analysis.statistics import Floats, require_scipy
from hapticd.base.units import Quantity

Columns: TypeAlias = dict[Quantity, Floats]
Gaps: TypeAlias = tuple[tuple[int, int], ...]

COLUMN_OF: Final[dict[Quantity, str]] = {
    "time": "time_s",
    "acceleration": "acceleration_m_per_s2",
    "force": "force_n",
    "position": "position_m",
    "tangential_position": "tangential_position_m",
    "speed": "speed_m_per_s",
}
"""Name of the column of each quantity in SI units."""
MIN_RECORDING_SAMPLES: Final = 16
"""A shorter recording holds no tap or stroke."""
MAX_RECORDING_SAMPLES: Final = 20_000_000
"""Larger recordings would take more than 160 MB of memory per column."""
MIN_RECORDING_RATE_HZ: Final = 100.0
"""A lower rate usually means that the times are in the wrong unit."""
MAX_RECORDING_RATE_HZ: Final = 1e6
"""A higher rate usually means that the times are in the wrong unit."""
MAX_UNIFORM_DEVIATION_PERIODS: Final = 1e-3
"""Times count as uniform if they deviate by at most this fraction of a period from a uniform clock."""
MAX_JITTER_PERIODS: Final = 0.5
"""A larger deviation from a uniform clock, in periods, means lost or doubled samples."""
MAX_RATE_MISMATCH: Final = 0.02
"""Largest relative difference between a given and a measured rate that count as equal."""
MIN_SAMPLES_PER_GAP: Final = 50
"""A recording may have one gap per this many samples; a short one may have three."""


def uniform(found: Columns, rate_hz: float | None, rounding_s: float) -> tuple[Columns, float, Gaps]:
    """Return the columns on a uniform clock, its rate in Hz, and the gaps, in which samples are interpolated linearly.

    `rounding_s` is the known rounding of the times, 0 if unknown; coarser rounding is detected. Raises ValueError for
    columns or times that are not usable.
    """
    check_columns(found)
    columns: Columns = {quantity: values for quantity, values in found.items() if quantity != "time"}
    if rate_hz is not None and not MIN_RECORDING_RATE_HZ <= rate_hz <= MAX_RECORDING_RATE_HZ:
        raise ValueError(f"the rate must be between {MIN_RECORDING_RATE_HZ:g} Hz and 1 MHz, is {rate_hz:g} Hz")
    if "time" not in found:
        if rate_hz is None:
            raise ValueError("has neither a column time_s nor a rate: set rate_hz in its YAML file")
        return columns, rate_hz, ()
    to_uniform, rate_hz, gaps = _clock_from_times(found["time"], rate_hz, rounding_s)
    if to_uniform is not None:
        # A column of speeds with one value per tap has no times.
        samples = len(found["time"])
        columns = {key: to_uniform(values) if len(values) == samples else values for key, values in columns.items()}
    return columns, rate_hz, gaps


def check_columns(found: Columns) -> None:
    """Raise ValueError if columns differ in length, or hold numbers that are not finite or absurdly large."""
    # A column of speeds may have one value per tap.
    lengths = {COLUMN_OF[quantity]: len(values) for quantity, values in found.items() if quantity != "speed"}
    samples = next(iter(lengths.values()))
    if set(lengths.values()) != {samples}:
        counts = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise ValueError(f"the columns differ in length: {counts}")
    if not MIN_RECORDING_SAMPLES <= samples <= MAX_RECORDING_SAMPLES:
        raise ValueError(
            f"must have between {MIN_RECORDING_SAMPLES} and {MAX_RECORDING_SAMPLES} samples, has {samples}"
        )
    for quantity, values in found.items():
        broken = np.flatnonzero(~np.isfinite(values))
        if len(broken):
            raise ValueError(
                f"{COLUMN_OF[quantity]} is NaN or infinite in {len(broken)} samples, first in sample {broken[0] + 1}"
            )
        # Far above physical values, but small enough that a fit does not overflow. Times may be Unix times.
        limit = 1e12 if quantity == "time" else 1e9
        if (large := float(np.abs(values).max(initial=0.0))) > limit:
            raise ValueError(
                f"{COLUMN_OF[quantity]} must be at most {limit:g} in magnitude, reaches {large:.3g}: "
                "is it in another unit, or another column?"
            )


def _clock_from_times(
    time_s: Floats, rate_hz: float | None, rounding_s: float
) -> tuple[Callable[[Floats], Floats] | None, float, Gaps]:
    """Return a function that resamples a column (n,) to a uniform clock, the clock's rate in Hz, and its gaps.

    Returns None in place of the function if the times are already uniform. Raises ValueError for times that are not
    usable.
    """
    since_s = time_s - time_s[0]
    at = np.arange(len(time_s)) - (len(time_s) - 1) / 2
    period_s = float(at @ since_s / (at @ at))
    rounding_s = max(rounding_s, 2 * float(np.spacing(np.abs(time_s).max())), _decimal_rounding_s(time_s))
    if 1.01 * period_s < rounding_s <= float(since_s[-1]) and np.all(np.diff(since_s) >= 0):
        raise ValueError(
            f"the times are rounded to {rounding_s:.3g} s, more than a sample period ({period_s:.3g} s): leave the "
            "column of times out and set rate_hz in its YAML file"
        )
    number, period_s = _sample_numbers(time_s, rounding_s)
    rate = 1.0 / period_s
    if not MIN_RECORDING_RATE_HZ / 1.002 <= rate <= 1.001 * MAX_RECORDING_RATE_HZ:
        raise ValueError(
            f"the rate must be between {MIN_RECORDING_RATE_HZ:g} Hz and 1 MHz, is {rate:.6g} Hz by the times: "
            "are they in another unit?"
        )
    if rate_hz is not None and abs(rate_hz * period_s - 1) > MAX_RATE_MISMATCH:
        raise ValueError(f"the times give {rate:.6g} Hz, but rate_hz is {rate_hz:g} Hz: are they in another unit?")
    jumps = np.flatnonzero(np.diff(number) > 1)
    gaps = tuple((int(number[jump]) + 1, int(number[jump + 1])) for jump in jumps)
    begin_s = float(np.mean(since_s - period_s * number))
    late = np.abs(since_s - begin_s - period_s * number) / period_s
    every = np.arange(int(number[-1]) + 1)
    if late.max() <= max(
        MAX_UNIFORM_DEVIATION_PERIODS, 0.5 * rounding_s / period_s * 1.001 + MAX_UNIFORM_DEVIATION_PERIODS
    ):
        # Rounded times determine the rate with a limited accuracy; within it, an integer rate is the nominal one.
        if abs(round(rate) / rate - 1) <= (rounding_s + MAX_UNIFORM_DEVIATION_PERIODS * period_s) / float(since_s[-1]):
            rate = float(round(rate))
        return (lambda values: np.interp(every, number, values)) if gaps else None, rate, gaps
    # After a gap the clock may continue at any fraction of a period.
    if late.max() > MAX_JITTER_PERIODS + (0.5 if gaps else 0.0) and (
        gaps or not _is_wandering_clock(since_s, period_s)
    ):
        worst = int(np.argmax(late))
        raise ValueError(
            f"the times deviate by {late[worst]:.2f} periods from a uniform clock at sample {worst + 1} "
            f"({time_s[worst]:.9g} s), at most {MAX_JITTER_PERIODS:g} are corrected: were samples lost, or doubled?"
        )
    even_s: Floats = np.asarray(begin_s + period_s * every, dtype=np.float64)
    return lambda values: _resampled(since_s, values, even_s, gaps), rate, gaps


def _sample_numbers(time_s: Floats, rounding_s: float) -> tuple[npt.NDArray[np.int64], float]:
    """Return the number of each sample (n,), which jumps where samples are missing, and the period in s.

    Raises ValueError if the times do not rise, or if too many samples are missing.
    """
    steps = np.diff(time_s)
    back = np.flatnonzero(steps <= 0)
    if len(back):
        raise ValueError(
            f"the time does not rise from sample {back[0] + 1} to {back[0] + 2} ({time_s[back[0]]:.9g} s, then "
            f"{time_s[back[0] + 1]:.9g} s): is it the right column? The YAML file can set rate_hz "
            "and columns without time"
        )
    usual = float(np.median(steps))
    spread = 1.4826 * float(np.median(np.abs(steps - usual)))
    # A gap is an interval that exceeds the median by more than the scatter of all intervals explains.
    jumps = np.flatnonzero(steps > usual + max(MAX_JITTER_PERIODS * usual, 6.0 * spread) + rounding_s)
    # One period for all intervals between the gaps, by least squares.
    along = square = 0.0
    for stretch in np.split(time_s, jumps + 1):
        at = np.arange(len(stretch)) - (len(stretch) - 1) / 2
        along += float(at @ (stretch - stretch[0]))
        square += float(at @ at)
    period_s = along / square if square > 0 else usual
    missing = np.maximum(np.round(steps[jumps] / period_s) - 1, 0)
    if missing.sum() > len(time_s) or len(jumps) > max(3, len(time_s) / MIN_SAMPLES_PER_GAP):
        raise ValueError(
            f"samples are missing: {missing.sum():.0f} in {len(jumps)} gaps, the first between {time_s[jumps[0]]:.9g} "
            f"s and {time_s[jumps[0] + 1]:.9g} s ({steps[jumps[0]] / usual:.1f} periods); at most {len(time_s)} may be "
            f"missing, and one gap per {MIN_SAMPLES_PER_GAP} samples is allowed"
        )
    more = np.ones(len(time_s), dtype=np.int64)
    more[0] = 0
    more[jumps + 1] += missing.astype(np.int64)
    return np.cumsum(more), period_s


def _is_wandering_clock(since_s: Floats, period_s: float) -> bool:
    """Return whether the times are those of a clock that drifts slowly.

    Its steps deviate by less than MAX_JITTER_PERIODS from the period, and the mean rates of up to 20 sections by less
    than 1 %. A column that is not a time, such as a position, changes faster.
    """
    steps = np.diff(since_s) / period_s
    edges = np.linspace(0, len(since_s) - 1, min(20, len(steps) // 50 + 1) + 1).round().astype(int)
    rates = np.diff(since_s[edges]) / np.diff(edges) / period_s
    return bool(np.abs(steps - 1).max() < MAX_JITTER_PERIODS and np.abs(rates - 1).max() < 0.01)


def _decimal_rounding_s(time_s: Floats) -> float:
    """Return the step to which times are rounded, in s, such as 1e-3; 0 if no rounding is found.

    Only the later half is examined: with a fixed number of digits, late times have the fewest decimal places.
    """
    later = time_s[len(time_s) // 2 :]
    for place in range(1, 10):
        scaled = later * 10.0**place
        if np.all(np.abs(scaled - np.round(scaled)) <= 1e-6 + 4 * np.spacing(np.abs(scaled))):
            return 10.0**-place
    return 0.0


def _resampled(time_s: Floats, values: Floats, even_s: Floats, gaps: Gaps) -> Floats:
    """Resample values (n,) to the times `even_s` by a cubic spline, in gaps by straight lines.

    Between two samples at the same end of the range, the result is at that end, so that clipping remains detectable.
    """
    require_scipy()
    from scipy.interpolate import CubicSpline

    found = np.asarray(CubicSpline(time_s, values)(even_s), dtype=np.float64)
    left = np.clip(np.searchsorted(time_s, even_s, side="right") - 1, 0, len(values) - 2)
    for extreme in (values.max(), values.min()):
        found[(values[left] == extreme) & (values[left + 1] == extreme)] = extreme
    for begin, end in gaps:
        found[begin:end] = np.interp(even_s[begin:end], time_s, values)
    return found
