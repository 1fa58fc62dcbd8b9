"""Two clocks read together: CLOCK_MONOTONIC, the clock of samples and events, and CLOCK_REALTIME, the time of day."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Final

CLOCK_READING_TRIES: Final = 3
"""The clocks are read three times; the fastest reading is used."""


@dataclass(frozen=True, slots=True)
class Moment:
    """One moment on both clocks of a machine, in ns."""

    monotonic_ns: int
    realtime_ns: int

    @property
    def utc(self) -> datetime:
        """The time of day of this moment in UTC, to the microsecond."""
        return datetime.fromtimestamp(self.realtime_ns // 1000 / 1e6, UTC)


def read() -> Moment:
    """Return the present moment: CLOCK_REALTIME, and the mean of CLOCK_MONOTONIC read before and after it."""
    tries = []
    for _ in range(CLOCK_READING_TRIES):
        before = time.monotonic_ns()
        realtime_ns = time.time_ns()
        width_ns = time.monotonic_ns() - before
        tries.append((width_ns, Moment(before + width_ns // 2, realtime_ns)))
    return min(tries, key=lambda each: each[0])[1]


def moment_of(value: object) -> Moment | None:
    """Return the moment in a received map with `monotonic_ns` and `realtime_ns`; None if `value` is not such a map."""
    if not isinstance(value, Mapping):
        return None
    monotonic_ns, realtime_ns = value.get("monotonic_ns"), value.get("realtime_ns")
    if type(monotonic_ns) is not int or type(realtime_ns) is not int:
        return None
    return Moment(monotonic_ns, realtime_ns)
