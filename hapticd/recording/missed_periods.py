"""Periods of the servo that were due and in which no tick was rendered, counted from samples."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from hapticd.base import wording
from hapticd.base.core import Flag

MOST_GAPS: Final = 1000
"""Gaps that a recording lists; the ticks of its samples show all of them."""


def missed_periods(
    samples: npt.NDArray[np.void],
    rate_hz: float | npt.NDArray[np.float64],
    before: tuple[int, int] | None = None,
) -> int:
    """Periods missed between the first and the last of these samples; `rate_hz`: of all, or (n,) of each.

    `before`: tick and time_ns of the sample before the first. Samples that were lost on the way are not missed periods.
    """
    if len(samples) == 0:
        return 0
    ticks, times = samples["tick"].astype(np.int64), samples["time_ns"].astype(np.int64)
    first = (int(ticks[0]) - 1, int(times[0])) if before is None else before
    steps = np.diff(ticks, prepend=first[0])
    elapsed = np.rint(np.diff(times, prepend=first[1]) * (np.asarray(rate_hz) * 1e-9))
    # Ticks that a device's reports lead are not periods apart: where nothing was missed, nothing is counted.
    counted = (samples["flags"] & Flag.SKIPPED != 0) | (steps > 1)
    if before is None:
        counted[0] = False
    return int(np.maximum(elapsed - steps, 0.0)[counted].sum())


def rates_of(
    samples: npt.NDArray[np.void], changes: Iterable[Mapping[str, Any]], rate_hz: float
) -> npt.NDArray[np.float64]:
    """The servo's rate at each sample, (n,), from the one at the start and from the changes after it."""
    rates = np.full(len(samples), float(rate_hz))
    for change in changes:
        if "rate_hz" in change:
            since = samples["revision"] - np.uint32(change["revision"])
            rates[since.astype(np.int32) >= 0] = float(change["rate_hz"])
    return rates


def gaps_of(ticks: npt.NDArray[np.int64], before: int | None = None) -> list[tuple[int, int]]:
    """Stretches of missing ticks: the first tick of each, and how many. `before`: the tick before the first."""
    steps = np.diff(ticks, prepend=ticks[:1] - 1 if before is None else before)
    return [(int(ticks[place] - steps[place] + 1), int(steps[place]) - 1) for place in np.flatnonzero(steps > 1)]


def share(missed: int, rendered: int) -> float:
    """Part of the periods that were due."""
    return missed / (missed + rendered) if missed else 0.0


def missed_text(missed: int, rendered: int) -> str:
    """Missed periods, and their share of those that were due, in words."""
    if not missed:
        return "no period missed"
    return f"{wording.count(missed, 'period')} missed ({wording.percent(share(missed, rendered))})"
