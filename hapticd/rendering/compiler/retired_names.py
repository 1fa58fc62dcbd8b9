"""Names of objects that are gone: the events of their last ticks are read a moment later and speak of them.

An object is meant by its slot and generation. Its name is kept until somebody has read every event up to the revision
that took it away; where nobody reads, until a whole later update and `MOST` names are there.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Collection
from typing import Final, TypeAlias

MOST: Final = 65536

Place: TypeAlias = tuple[int, int]
"""Slot and generation."""


class RetiredNames:
    """`add`, `close` and `take_back` are for one thread at a time, `read` for another one, `name_of` for any."""

    def __init__(self) -> None:
        self._names: dict[Place, str] = {}
        self._closed: deque[tuple[int, Collection[Place]]] = deque()
        """Revisions and what they took away, the oldest first."""
        self._lock = threading.Lock()
        """Of `_closed`, held for a comparison."""

    def name_of(self, slot: int, generation: int) -> str | None:
        return self._names.get((slot, generation))

    def add(self, place: Place, id: str) -> None:
        """The object goes, with a revision that `close` will say."""
        self._names[place] = id

    def close(self, revision: int, places: Collection[Place]) -> None:
        """These, added since the last time, go with this revision."""
        if places:
            with self._lock:
                self._closed.append((revision, tuple(places)))
            while len(self._names) > MOST and (oldest := self._pop(None)):
                self._drop(oldest)

    def take_back(self, revision: int) -> None:
        """The revision closed last was refused: what it took away is there again, until it is added once more."""
        with self._lock:
            if self._closed and self._closed[-1][0] == revision:
                self._closed.pop()

    def read(self, revision: int) -> None:
        """Every event up to the tick that took this revision, and of that tick, was read."""
        while places := self._pop(revision):
            self._drop(places)

    def _pop(self, revision: int | None) -> Collection[Place] | None:
        """What went first, if that was by `revision`; None: if other things went later."""
        with self._lock:
            if revision is None:
                due = len(self._closed) > 1
            else:
                due = bool(self._closed) and (revision - self._closed[0][0]) & 0xFFFFFFFF < 0x80000000
            return self._closed.popleft()[1] if due else None

    def _drop(self, places: Collection[Place]) -> None:
        for place in places:
            del self._names[place]
