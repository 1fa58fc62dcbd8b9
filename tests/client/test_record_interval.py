"""The recorded interval, and its end on a machine where samples arrive late."""

from __future__ import annotations

import numpy as np
import pytest

from hapticd.client import record
from hapticd.client.samples import SampleBatch

FIELDS = np.dtype([("tick", "<u8"), ("time_ns", "<i8")])


def batch(first: int, count: int = 10) -> SampleBatch:
    samples = np.zeros(count, FIELDS)
    samples["tick"] = np.arange(first, first + count)
    samples["time_ns"] = 100_000 * samples["tick"]
    return samples.view(SampleBatch)


def test_what_comes_late_is_waited_for_as_long_as_something_comes(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = [0.0]
    monkeypatch.setattr(record.time, "monotonic", lambda: now_s[0])
    interval = record._Interval(None)
    interval.clip(batch(0))
    interval.end_at(59)
    for first in range(10, 60, 10):
        assert not interval.over
        now_s[0] += 0.9 * record.FINAL_CHANGE_TIMEOUT_S
        interval.clip(batch(first))
    assert interval.over  # tick 59 arrived 4.5 s after the end was requested
    interval = record._Interval(None)
    interval.clip(batch(0))
    interval.end_at(59)
    now_s[0] += 1.1 * record.FINAL_CHANGE_TIMEOUT_S
    assert interval.over  # no sample arrived
