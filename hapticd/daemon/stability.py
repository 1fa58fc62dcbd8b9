"""The stability of the scene in force, evaluated again when the scene changed. For any thread."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np

from hapticd.config.scene import Scene, field_ids
from hapticd.rendering.scene_stability import Stability, evaluate
from hapticd.rendering.stability import Loop
from hapticd.rendering.surface_table import SurfaceTable

EVALUATED_AT_ONCE: Final = 512
"""Larger scenes are evaluated by a thread: nobody waits for it."""


class Snapshot(NamedTuple):
    """What the stability of a scene follows from."""

    revision: int
    scene: Scene
    surfaces: SurfaceTable
    names: Sequence[str]
    """Ids by slot."""
    loop: Loop

    def evaluated(self) -> Stability:
        names, fields = self.names.__getitem__, lambda: field_ids(self.scene.objects)
        return evaluate(self.surfaces, names, fields, self.loop, unsafe=False)

    @property
    def size(self) -> int:
        """Objects and patches."""
        return int(np.count_nonzero(self.surfaces.objects["shape"])) + len(self.surfaces.pieces)


class StabilityEvaluation:
    """Keeps what was found last, until the scene changes."""

    def __init__(self, compiling: threading.Lock, take: Callable[[int | None], Snapshot | None]) -> None:
        """`take`: what there is to evaluate, called with `compiling` held; None: the revision that it is given is still
        in force."""
        self._compiling, self._take = compiling, take
        self._known: tuple[int, Stability] | None = None
        self.under_way = threading.Lock()
        """Held by the thread that evaluates a large scene."""

    def find(self) -> Stability:
        """That of the scene in force. While another thread changes the scene, that of the scene before; of a scene of
        more than EVALUATED_AT_ONCE objects and patches, until a thread has found it, which takes seconds at most."""
        known = self._known
        # Nobody waits here for the filters of many textures; but the first one is always evaluated.
        if not self._compiling.acquire(blocking=known is None):
            assert known is not None
            return known[1]
        try:
            snapshot = self._take(None if known is None else known[0])
        finally:
            self._compiling.release()
        if snapshot is None:
            assert known is not None
            return known[1]
        if known is None or snapshot.size <= EVALUATED_AT_ONCE:
            return self._evaluate(snapshot)
        if self.under_way.acquire(blocking=False):
            try:
                threading.Thread(target=self._run, args=(snapshot,), name="stability", daemon=True).start()
            except RuntimeError:  # there may be no more threads: whoever asks finds it
                self.under_way.release()
                return self._evaluate(snapshot)
        return known[1]

    def _evaluate(self, snapshot: Snapshot) -> Stability:
        found = snapshot.evaluated()
        self._known = snapshot.revision, found
        return found

    def _run(self, snapshot: Snapshot) -> None:
        try:
            self._evaluate(snapshot)
        finally:
            self.under_way.release()
