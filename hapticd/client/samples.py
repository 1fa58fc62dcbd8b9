"""Batches of samples as numpy structured arrays, and counts of lost samples."""

from __future__ import annotations

from typing import Any, cast

import numpy as np

from hapticd.client.base import warn
from hapticd.protocol.calls import TelemetryLoss, Topic


class SampleBatch(np.ndarray[tuple[int], np.dtype[np.void]]):
    """A batch of samples: a read-only structured array of shape (n,), with an element for each tick.

    Fields and units are those of the sample (`tick`, `time_ns`, `position_m`, ...). Slices and copies keep the
    attributes of their batch; `copy()` can be written to.
    """

    first_tick: int
    """Tick of the first sample."""
    dropped: int
    """Number of samples that the daemon has dropped since its start, because its ring was full."""
    lost: int
    """Number of samples since the previous batch that were sent and not received."""

    def __array_finalize__(self, obj: object) -> None:
        self.first_tick = getattr(obj, "first_tick", 0)
        self.dropped = getattr(obj, "dropped", 0)
        self.lost = getattr(obj, "lost", 0)

    def __getitem__(self, key: Any) -> Any:
        item = super().__getitem__(key)
        # A single field becomes an ordinary array; only arrays with fields are batches.
        return item.view(np.ndarray) if isinstance(item, SampleBatch) and item.dtype.names is None else item


def dtype_of(description: object) -> np.dtype[np.void]:
    """Return the dtype that the member `dtype` of a message describes: numpy's descr, with lists instead of tuples."""
    fields = [(*field[:2], *map(tuple, field[2:])) for field in cast("list[list[Any]]", description)]
    return cast("np.dtype[np.void]", np.lib.format.descr_to_dtype(cast(Any, fields)))


class SampleStream:
    """Converts messages of samples to batches, in their order, and counts missing ticks.

    Ticks of the servo have no gaps. A missing tick was dropped by the ring of the daemon, which counts it in `dropped`,
    or was lost between daemon and subscriber.
    """

    def __init__(self, warn: bool = True) -> None:
        self._warn = warn
        self._description: object = None
        self._dtype: np.dtype[np.void] | None = None
        self._next_tick: int | None = None
        self._dropped_before = 0
        self._early = 0
        """Number of samples that `dropped` counts before their gap has arrived."""
        self.received = 0
        """Number of received samples."""
        self.lost = 0
        """Number of samples lost between daemon and subscriber."""
        self.dropped = 0
        """Number of samples that the ring of the daemon has dropped since the first batch."""
        self.restarts = 0
        """Number of restarts of the daemon, after which ticks begin at 0."""

    def convert(self, topic: Topic, message: dict[str, object]) -> SampleBatch:
        """Return the batch in a `samples` message."""
        if self._dtype is None or message["dtype"] != self._description:
            self._description = message["dtype"]
            self._dtype = dtype_of(self._description)
        batch = np.frombuffer(cast(bytes, message["data"]), self._dtype).view(SampleBatch)
        batch.first_tick, batch.dropped = cast(int, message["first_tick"]), cast(int, message["dropped"])
        if len(batch):
            batch.lost = self._account(batch)
        if batch.lost and self._warn:
            lost = f"{batch.lost} samples before tick {batch.first_tick} were lost"
            warn(TelemetryLoss(f"{lost}: the subscriber reads too slowly"))
        return batch

    def _account(self, batch: SampleBatch) -> int:
        """Return the number of samples lost between daemon and subscriber since the previous batch."""
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
