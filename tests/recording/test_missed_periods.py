"""Missed periods, counted from samples."""

from __future__ import annotations

import numpy as np
import pytest

from hapticd.base.core import SAMPLE_DTYPE, Flag, records
from hapticd.recording.missed_periods import gaps_of, missed_periods, rates_of, share

RATE_HZ = 3000.0


def samples(periods: list[int], rate_hz: float = RATE_HZ) -> np.ndarray:
    """Successive ticks with these numbers of periods between them; deadlines are integer nanoseconds."""
    made = records(SAMPLE_DTYPE, len(periods))
    made["tick"] = np.arange(len(periods))
    made["time_ns"] = np.rint(np.cumsum(periods) * (1e9 / rate_hz)) + 10**15
    made["flags"] = np.where(np.array(periods) > 1, Flag.SKIPPED, 0)
    return made


def test_each_period_without_a_tick_counts() -> None:
    assert missed_periods(samples([1] * 1000), RATE_HZ) == 0
    made = samples([1, 1, 3, 1, 100, 2, 1])
    assert missed_periods(made, RATE_HZ) == 2 + 99 + 1
    before = int(made["tick"][2]), int(made["time_ns"][2])
    assert missed_periods(made[:3], RATE_HZ) + missed_periods(made[3:], RATE_HZ, before) == 102


def test_periods_missed_before_the_first_sample_do_not_count() -> None:
    assert missed_periods(samples([50, 1, 1]), RATE_HZ) == 0


def test_lost_samples_are_no_missed_periods() -> None:
    made = samples([1] * 10 + [4] + [1] * 10)
    kept = np.delete(made, slice(5, 15))
    assert gaps_of(kept["tick"].astype(np.int64)) == [(5, 10)]
    assert missed_periods(kept, RATE_HZ) == 3, "the three between ticks that are lost"
    assert missed_periods(kept[:5], RATE_HZ) == 0


def test_ticks_that_reports_lead_are_not_missed() -> None:
    made = samples([1] * 10)
    made["time_ns"] += np.arange(10) ** 3 * 10_000
    assert missed_periods(made, RATE_HZ) == 0


def test_rates_are_those_of_the_revisions() -> None:
    made = samples([1] * 6)
    made["revision"] = [1, 1, 2, 2, 3, 3]
    rates = rates_of(made, [{"revision": 1}, {"tick": 3, "reset": {}}, {"revision": 2, "rate_hz": 1500.0}], RATE_HZ)
    assert rates.tolist() == [3000, 3000, 1500, 1500, 1500, 1500]
    slow = samples([1, 1, 2, 1], 1500.0)
    assert missed_periods(slow, np.full(4, 1500.0)) == 1


def test_the_share_is_relative_to_all_periods() -> None:
    assert share(7562, 32438) == pytest.approx(0.18905)
    assert share(0, 0) == 0.0
