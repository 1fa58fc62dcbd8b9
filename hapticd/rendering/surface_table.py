"""The part of a compiled table that determines the forces of surfaces and fields, for the analysis of contact sets."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Ints = npt.NDArray[np.int64]


class SurfaceTable(NamedTuple):
    """Arrays of objects, materials and wall pieces in the compiler, valid until its table is updated."""

    objects: npt.NDArray[np.void]
    """OBJECT_DTYPE, by slot."""
    materials: npt.NDArray[np.void]
    """MATERIAL_DTYPE."""
    pieces: npt.NDArray[np.void]
    """PIECE_DTYPE."""
    field_stiffness_n_per_m: float
    field_damping_n_s_per_m: float
    names: Sequence[str] = ()
    """Names of the materials, by index."""

    def of(self, slots: Ints) -> SurfaceTable:
        """Return a table with only the surfaces at these slots, in this order."""
        objects = self.objects[slots]
        count, first = objects["piece_count"].astype(np.int64), objects["piece_first"].astype(np.int64)
        begin = np.cumsum(count) - count
        pieces = self.pieces[np.repeat(first - begin, count) + np.arange(int(count.sum()))]
        objects["piece_first"] = begin
        return self._replace(objects=objects, pieces=pieces)

    def materials_of(self, slots: Ints) -> Ints:
        """Return the indices of the materials of the surfaces at these slots, without duplicates."""
        some = self.of(slots)
        return np.unique(np.concatenate((some.objects["material"], some.pieces["material"]))).astype(np.int64)
