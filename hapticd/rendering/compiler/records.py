"""Arrays of C records that grow in place, and which of their places are free."""

from __future__ import annotations

import heapq

import numpy as np
import numpy.typing as npt

from hapticd.base.core import CData, pointer, records


def next_version(version: int) -> int:
    """Of 32 bits, and never 0."""
    return version % 0xFFFFFFFF + 1


class Places:
    """Places in an array, the lowest free one first."""

    def __init__(self) -> None:
        self.count = 0
        """The array is so long."""
        self._free: list[int] = []

    def take(self, wanted: int | None = None) -> int:
        """A free place; `wanted`, which is free, where that is given."""
        if wanted is not None:
            self._free.remove(wanted)
            heapq.heapify(self._free)
            return wanted
        if self._free:
            return heapq.heappop(self._free)
        self.count += 1
        return self.count - 1

    def give(self, place: int) -> None:
        heapq.heappush(self._free, place)


class Records:
    """C records in memory that C reads in place; it grows by doubling."""

    def __init__(self, ctype: str, dtype: np.dtype[np.void]) -> None:
        self._ctype = ctype
        self._hold(records(dtype, 16))

    def _hold(self, array: npt.NDArray[np.void]) -> None:
        self.array = array
        self.memory = array.view(np.uint8).data
        self.pointer: CData = pointer(self._ctype + "[]", array)

    def reserve(self, count: int) -> None:
        if count > len(self.array):
            before = self.memory
            self._hold(records(self.array.dtype, max(count, 2 * len(self.array))))
            self.memory[: len(before)] = before
