"""What a recording may hold, and its columns on a uniform clock: what its times say, and what of them can be put
right."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from hapticd.analysis.statistics import Floats, require_scipy

Quantity: TypeAlias = Literal["time", "acceleration", "force", "position", "tangential_position", "speed"]
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
_LENGTHS: Final = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6}
UNITS_OF: Final[dict[Quantity, dict[str, float]]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "acceleration": {"m/s^2": 1.0, "mm/s^2": 1e-3, "g": 9.80665},
    "force": {"N": 1.0, "mN": 1e-3, "kN": 1e3},
    "position": _LENGTHS,
    "tangential_position": _LENGTHS,
    "speed": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3},
}
LEAST_SAMPLES: Final = 16
MAX_SAMPLES: Final = 20_000_000
LOWEST_HZ: Final = 100.0
HIGHEST_HZ: Final = 1e6
UNIFORM_WITHIN: Final = 1e-3
"""A clock whose samples are no more than this part of a period from where they should be is taken as uniform."""
MOST_JITTER: Final = 0.5
"""Samples farther than this from where they should be, in periods, are missing or doubled ones."""
RATES_ALIKE: Final = 0.02
GAP_EVERY: Final = 50
"""At most one gap in so many samples; three of them in a short recording."""


def uniform(found: Columns, rate_hz: float | None, rounding_s: float) -> tuple[Columns, float, Gaps]:
    """The columns at equal distances, the rate, and where samples are missing, which straight lines stand for there;
    times are rounded to `rounding_s`, or more than that. Raises ValueError."""
    check_columns(found)
    columns: Columns = {quantity: values for quantity, values in found.items() if quantity != "time"}
    if rate_hz is not None and not LOWEST_HZ <= rate_hz <= HIGHEST_HZ:
        raise ValueError(f"a rate of {rate_hz:g} Hz is out of range: recordings have {LOWEST_HZ:g} Hz to 1 MHz")
    if "time" not in found:
        if rate_hz is None:
            raise ValueError("has neither a column time_s nor a rate: say rate_hz in the YAML beside it")
        return columns, rate_hz, ()
    evened, rate_hz, gaps = _by_times(found["time"], rate_hz, rounding_s)
    if evened is not None:
        # Speeds of taps, which are fewer, stay.
        samples = len(found["time"])
        columns = {key: evened(values) if len(values) == samples else values for key, values in columns.items()}
    return columns, rate_hz, gaps


def check_columns(found: Columns) -> None:
    """Raises ValueError for columns that differ in length, or hold what no recording holds."""
    # Of taps the speeds may be fewer than samples.
    lengths = {COLUMN_OF[quantity]: len(values) for quantity, values in found.items() if quantity != "speed"}
    samples = next(iter(lengths.values()))
    if set(lengths.values()) != {samples}:
        counts = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise ValueError(f"the columns are of different length: {counts}")
    if not LEAST_SAMPLES <= samples <= MAX_SAMPLES:
        raise ValueError(f"{samples} samples are no recording: it has {LEAST_SAMPLES} to {MAX_SAMPLES}")
    for quantity, values in found.items():
        broken = np.flatnonzero(~np.isfinite(values))
        if len(broken):
            raise ValueError(
                f"{COLUMN_OF[quantity]} is NaN or infinite in {len(broken)} samples, first in number {broken[0] + 1}"
            )
        # Far beyond what can be, so that nothing overflows before a fit says what is wrong; times may be of a calendar.
        largest = 1e12 if quantity == "time" else 1e9
        if (large := float(np.abs(values).max(initial=0.0))) > largest:
            raise ValueError(
                f"{COLUMN_OF[quantity]} reaches {large:.3g}, and nothing that a stylus records is over {largest:g}: "
                "is it in another unit, or another column?"
            )


def _by_times(
    time_s: Floats, rate_hz: float | None, rounding_s: float
) -> tuple[Callable[[Floats], Floats] | None, float, Gaps]:
    """What puts a column (n,) onto a uniform clock (None: it is), the clock's rate, and its gaps. Raises ValueError."""
    since_s = time_s - time_s[0]
    at = np.arange(len(time_s)) - (len(time_s) - 1) / 2
    period_s = float(at @ since_s / (at @ at))
    rounding_s = max(rounding_s, 2 * float(np.spacing(np.abs(time_s).max())), _decimals(time_s))
    if 1.01 * period_s < rounding_s <= float(since_s[-1]) and np.all(np.diff(since_s) >= 0):
        raise ValueError(
            f"the times are rounded to {rounding_s:.3g} s, which is more than from one sample to the next "
            f"({period_s:.3g} s): leave them out and say rate_hz, in the YAML beside it"
        )
    number, period_s = _numbered(time_s, rounding_s)
    rate = 1.0 / period_s
    if not LOWEST_HZ / 1.002 <= rate <= 1.001 * HIGHEST_HZ:
        raise ValueError(
            f"the times say {rate:.6g} Hz: a recording has {LOWEST_HZ:g} Hz to 1 MHz; which unit is the time in?"
        )
    if rate_hz is not None and abs(rate_hz * period_s - 1) > RATES_ALIKE:
        raise ValueError(f"the times say {rate:.6g} Hz, rate_hz says {rate_hz:g} Hz: is the time in another unit?")
    jumps = np.flatnonzero(np.diff(number) > 1)
    gaps = tuple((int(number[jump]) + 1, int(number[jump + 1])) for jump in jumps)
    begin_s = float(np.mean(since_s - period_s * number))
    late = np.abs(since_s - begin_s - period_s * number) / period_s
    every = np.arange(int(number[-1]) + 1)
    if late.max() <= max(UNIFORM_WITHIN, 0.5 * rounding_s / period_s * 1.001 + UNIFORM_WITHIN):
        # Times that are rounded say a rate only so well, and a clock is made for a whole one.
        if abs(round(rate) / rate - 1) <= (rounding_s + UNIFORM_WITHIN * period_s) / float(since_s[-1]):
            rate = float(round(rate))
        return (lambda values: np.interp(every, number, values)) if gaps else None, rate, gaps
    # After a gap a clock goes on anywhere between two samples.
    if late.max() > MOST_JITTER + (0.5 if gaps else 0.0) and (gaps or not _wanders(since_s, period_s)):
        worst = int(np.argmax(late))
        raise ValueError(
            f"the clock is {late[worst]:.2f} periods off a uniform one at sample {worst + 1} "
            f"({time_s[worst]:.9g} s), {MOST_JITTER:g} is the most that is put right: were samples lost, or doubled?"
        )
    even_s: Floats = np.asarray(begin_s + period_s * every, dtype=np.float64)
    return lambda values: _resampled(since_s, values, even_s, gaps), rate, gaps


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
    # A distance far off the usual one, by the scatter of all of them, is a gap.
    jumps = np.flatnonzero(steps > usual + max(MOST_JITTER * usual, 6.0 * spread) + rounding_s)
    # One rate for all stretches, whatever lies between them.
    along = square = 0.0
    for stretch in np.split(time_s, jumps + 1):
        at = np.arange(len(stretch)) - (len(stretch) - 1) / 2
        along += float(at @ (stretch - stretch[0]))
        square += float(at @ at)
    period_s = along / square if square > 0 else usual
    missing = np.maximum(np.round(steps[jumps] / period_s) - 1, 0)
    if missing.sum() > len(time_s) or len(jumps) > max(3, len(time_s) / GAP_EVERY):
        raise ValueError(
            f"samples are missing: between {time_s[jumps[0]]:.9g} s and {time_s[jumps[0] + 1]:.9g} s pass "
            f"{steps[jumps[0]] / usual:.1f} periods, in {len(jumps)} places like this, {missing.sum():.0f} samples in "
            f"all beside {len(time_s)}; at most as many may be, and one gap in {GAP_EVERY} samples"
        )
    more = np.ones(len(time_s), dtype=np.int64)
    more[0] = 0
    more[jumps + 1] += missing.astype(np.int64)
    return np.cumsum(more), period_s


def _wanders(since_s: Floats, period_s: float) -> bool:
    """Whether a clock goes evenly from each sample to the next and at one rate throughout, though not for ever: what is
    no clock at all, a position for one, changes more than 1 % from one part of the recording to another."""
    steps = np.diff(since_s) / period_s
    edges = np.linspace(0, len(since_s) - 1, min(20, len(steps) // 50 + 1) + 1).round().astype(int)
    rates = np.diff(since_s[edges]) / np.diff(edges) / period_s
    return bool(np.abs(steps - 1).max() < MOST_JITTER and np.abs(rates - 1).max() < 0.01)


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


def _resampled(time_s: Floats, values: Floats, even_s: Floats, gaps: Gaps) -> Floats:
    """By a cubic spline, in gaps by straight lines; what stands still at an end of the range, as clipped samples do,
    goes on to do so."""
    require_scipy()
    from scipy.interpolate import CubicSpline

    found = np.asarray(CubicSpline(time_s, values)(even_s), dtype=np.float64)
    left = np.clip(np.searchsorted(time_s, even_s, side="right") - 1, 0, len(values) - 2)
    for extreme in (values.max(), values.min()):
        found[(values[left] == extreme) & (values[left + 1] == extreme)] = extreme
    for begin, end in gaps:
        found[begin:end] = np.interp(even_s[begin:end], time_s, values)
    return found
