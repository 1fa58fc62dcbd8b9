"""Arrays of C records that grow when full, and their free indices."""

from __future__ import annotations

import heapq

import numpy as np
import numpy.typing as npt

from hapticd.base.core import CData, pointer, records


def next_version(version: int) -> int:
    """Return the version number that follows `version`: 32 bits, never 0."""
    return version % 0xFFFFFFFF + 1


class Places:
    """Allocates indices of an array, the lowest free one first."""

    def __init__(self) -> None:
        self.count = 0
        """Length of the array."""
        self._free: list[int] = []

    def take(self, wanted: int | None = None) -> int:
        """Allocate the lowest free index of the array, or `wanted`, which must be free, and return it."""
        if wanted is not None:
            self._free.remove(wanted)
            heapq.heapify(self._free)
            return wanted
        if self._free:
            return heapq.heappop(self._free)
        self.count += 1
        return self.count - 1

    def give(self, index: int) -> None:
        """Free an index of the array."""
        heapq.heappush(self._free, index)


class Records:
    """An array of C records, which the core reads in place; a full array is replaced by one of twice the size."""

    def __init__(self, ctype: str, dtype: np.dtype[np.void]) -> None:
        self._ctype = ctype
        self._hold(records(dtype, 16))

    def _hold(self, array: npt.NDArray[np.void]) -> None:
        """Use `array` as the records: set the array, its view as bytes, and its pointer."""
        self.array = array
        self.memory = array.view(np.uint8).data
        self.pointer: CData = pointer(self._ctype + "[]", array)

    def reserve(self, count: int) -> None:
        """Enlarge the array, if necessary, so that it has room for `count` records."""
        if count > len(self.array):
            before = self.memory
            self._hold(records(self.array.dtype, max(count, 2 * len(self.array))))
            self.memory[: len(before)] = before
