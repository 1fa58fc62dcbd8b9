"""Missed periods (periods of the servo without a tick), counted from samples."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from hapticd.base import wording
from hapticd.base.core import Flag

MAX_LISTED_GAPS: Final = 1000
"""Maximum number of gaps that a recording lists; the ticks of the samples show all gaps."""


def missed_periods(
    samples: npt.NDArray[np.void],
    rate_hz: float | npt.NDArray[np.float64],
    before: tuple[int, int] | None = None,
) -> int:
    """Return the number of missed periods between the first and the last of these samples.

    `rate_hz` is the servo rate, or an array (n,) with the rate at each sample. `before` is (tick, time_ns) of the
    sample before the first one. Ticks whose samples telemetry lost are not missed periods.
    """
    if len(samples) == 0:
        return 0
    ticks, times = samples["tick"].astype(np.int64), samples["time_ns"].astype(np.int64)
    first = (int(ticks[0]) - 1, int(times[0])) if before is None else before
    steps = np.diff(ticks, prepend=first[0])
    elapsed = np.rint(np.diff(times, prepend=first[1]) * (np.asarray(rate_hz) * 1e-9))
    # Ticks that a device's reports start are not exactly one period long: only those with a gap are counted.
    counted = (samples["flags"] & Flag.SKIPPED != 0) | (steps > 1)
    if before is None:
        counted[0] = False
    return int(np.maximum(elapsed - steps, 0.0)[counted].sum())


def rates_of(
    samples: npt.NDArray[np.void], changes: Iterable[Mapping[str, Any]], rate_hz: float
) -> npt.NDArray[np.float64]:
    """Return the servo rate at each sample, shape (n,), from the rate at the start and a recording's `changes`."""
    rates = np.full(len(samples), float(rate_hz))
    for change in changes:
        if "rate_hz" in change:
            since = samples["revision"] - np.uint32(change["revision"])
            rates[since.astype(np.int32) >= 0] = float(change["rate_hz"])
    return rates


def gaps_of(ticks: npt.NDArray[np.int64], before: int | None = None) -> list[tuple[int, int]]:
    """Return the first tick and the length of each gap in `ticks`. `before` is the tick before the first of `ticks`."""
    steps = np.diff(ticks, prepend=ticks[:1] - 1 if before is None else before)
    return [(int(ticks[place] - steps[place] + 1), int(steps[place]) - 1) for place in np.flatnonzero(steps > 1)]


def share(missed: int, rendered: int) -> float:
    """Return the fraction of missed periods among all periods, missed and rendered."""
    return missed / (missed + rendered) if missed else 0.0


def missed_text(missed: int, rendered: int) -> str:
    """Return the number and the fraction of missed periods as text."""
    if not missed:
        return "no period missed"
    return f"{wording.count(missed, 'period')} missed ({wording.percent(share(missed, rendered))})"
