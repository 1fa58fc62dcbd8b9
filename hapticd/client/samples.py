"""Batches of samples, as numpy structured arrays, and the account of what was lost on the way."""

from __future__ import annotations

from typing import Any, cast

import numpy as np

from hapticd.client.base import warn
from hapticd.protocol.calls import TelemetryLoss, Topic


class SampleBatch(np.ndarray[tuple[int], np.dtype[np.void]]):
    """One batch: a structured array of shape (n,), one element a tick, read-only; `copy()` gives one to
    write to.

    Fields and units are those of the sample (`tick`, `time_ns`, `position_m`, ...). Slices and copies are
    plain views that keep the attributes of their batch.
    """

    first_tick: int
    """Tick of the first sample."""
    dropped: int
    """Samples that the daemon's ring had no room for since it started."""
    lost: int
    """Samples between the batch before and this one that the daemon sent and this subscriber missed."""

    def __array_finalize__(self, obj: object) -> None:
        self.first_tick = getattr(obj, "first_tick", 0)
        self.dropped = getattr(obj, "dropped", 0)
        self.lost = getattr(obj, "lost", 0)

    def __getitem__(self, key: Any) -> Any:
        item = super().__getitem__(key)
        # A field is ordinary numbers; only what still has fields is a batch.
        return item.view(np.ndarray) if isinstance(item, SampleBatch) and item.dtype.names is None else item


def dtype_of(description: object) -> np.dtype[np.void]:
    """The dtype that a message's `dtype` describes: numpy's descr, with lists in the place of its tuples."""
    fields = [(*field[:2], *map(tuple, field[2:])) for field in cast("list[list[Any]]", description)]
    return cast("np.dtype[np.void]", np.lib.format.descr_to_dtype(cast(Any, fields)))


class SampleStream:
    """Makes batches of messages, in their order, and keeps account of the ticks that are missing.

    Ticks have no gaps in the servo. A tick that is missing here was dropped by the daemon's ring, which
    counts it in `dropped`, or lost between the daemon and us.
    """

    def __init__(self, warn: bool = True) -> None:
        self._warn = warn
        self._description: object = None
        self._dtype: np.dtype[np.void] | None = None
        self._next_tick: int | None = None
        self._dropped_before = 0
        self._early = 0
        """Samples that the ring counted as dropped before their gap arrived."""
        self.received = 0
        """Samples that arrived."""
        self.lost = 0
        """Samples that were lost on the way here."""
        self.dropped = 0
        """Samples that the daemon's ring dropped while we listened."""
        self.restarts = 0
        """How often the daemon began again from tick 0."""

    def convert(self, topic: Topic, message: dict[str, object]) -> SampleBatch:
        """The batch in one `samples` message."""
        if self._dtype is None or message["dtype"] != self._description:
            self._description = message["dtype"]
            self._dtype = dtype_of(self._description)
        batch = np.frombuffer(cast(bytes, message["data"]), self._dtype).view(SampleBatch)
        batch.first_tick, batch.dropped = cast(int, message["first_tick"]), cast(int, message["dropped"])
        if len(batch):
            batch.lost = self._account(batch)
        if batch.lost and self._warn:
            warn(TelemetryLoss(f"{batch.lost} samples before tick {batch.first_tick} were lost: read faster"))
        return batch

    def _account(self, batch: SampleBatch) -> int:
        """How many samples were lost on the way here since the batch before."""
        if self._next_tick is None or batch.first_tick < self._next_tick:
            self.restarts += self._next_tick is not None
            self._next_tick, self._dropped_before, self._early = batch.first_tick, batch.dropped, 0
        end = int(batch["tick"][-1]) + 1
        missing = end - self._next_tick - len(batch)
        dropped = batch.dropped - self._dropped_before
        lost = max(0, missing - dropped - self._early)
        self._early += dropped + lost - missing
        self._next_tick, self._dropped_before = end, batch.dropped
        self.received += len(batch)
        self.lost += lost
        self.dropped += dropped
        return lost
