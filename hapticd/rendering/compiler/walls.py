"""Walls with patches: the pieces of each wall, intervals of one material, one wall after the other."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hapticd.base.core import PIECE_DTYPE, CData, pointer, records
from hapticd.config.scene import Patch, Wall
from hapticd.rendering.compiler.materials import Materials


class _Pieces(NamedTuple):
    """The pieces of a wall with patches."""

    of: tuple[Sequence[Patch], str, float]
    """The wall's patches, the material between them, and the width of the ramp between materials."""
    rows: npt.NDArray[np.void]
    """Records of PIECE_DTYPE."""
    materials: frozenset[int]
    """Indices of the wall's materials; the wall counts as one use of each."""


class PatchedWalls:
    """The pieces of walls with patches, by the slot of the wall."""

    def __init__(self, materials: Materials) -> None:
        self._materials = materials
        self._pieces: dict[int, _Pieces] = {}
        """Pieces by the slot of their wall, in the order of `records`."""
        self.records = records(PIECE_DTYPE, 0)
        """Records of all pieces, as of the last `write`."""
        self.changed = False
        """Whether pieces changed since the last `write`."""

    def count(self, slot: int) -> int:
        """Return the number of pieces of the wall at a slot of the table; 0 without patches."""
        pieces = self._pieces.get(slot)
        return 0 if pieces is None else len(pieces.rows)

    def made_of(self, materials: Iterable[int]) -> list[int]:
        """Return the slots of walls that have any of these materials in their pieces."""
        sought = set(materials)
        return [slot for slot, pieces in self._pieces.items() if not sought.isdisjoint(pieces.materials)]

    def put(self, slot: int, wall: Wall | None) -> bool:
        """Set the wall at a slot, None for a wall without patches; return whether the pieces changed."""
        held = self._pieces.get(slot)
        if wall is None and held is None:
            return False
        of = None if wall is None else (wall.patches, wall.material, wall.patch_ramp_m)
        if held is not None and held.of == of:
            return False
        pieces = None if wall is None else self._new_pieces(wall)
        for material in () if held is None else held.materials:
            self._materials.release(material)
        if pieces is None:
            del self._pieces[slot]
        else:
            self._pieces[slot] = pieces
        changed = held is None or pieces is None or not np.array_equal(held.rows, pieces.rows)
        self.changed |= changed
        return changed

    def _new_pieces(self, wall: Wall) -> _Pieces:
        """Return the pieces of a wall, and count a use of each of its materials.

        At a boundary, the ramp is at most as wide as the shorter of the two pieces.
        """
        begins, names = wall.stretches()
        indices = {name: self._materials.use(name) for name in dict.fromkeys(names)}
        rows = records(PIECE_DTYPE, len(begins))
        lengths = np.diff(begins, append=math.inf)
        rows["from_m"] = begins
        rows["from_m"][0] = 0.0
        rows["half_ramp_m"][1:] = np.minimum(np.minimum(lengths[:-1], lengths[1:]), wall.patch_ramp_m) / 2.0
        rows["material"] = np.fromiter(map(indices.__getitem__, names), np.uint32, len(names))
        return _Pieces((wall.patches, wall.material, wall.patch_ramp_m), rows, frozenset(indices.values()))

    def write(self, table: CData, objects: npt.NDArray[np.void]) -> Iterator[int]:
        """Put all pieces into a table, and the index of each wall's first piece into its object's record.

        Yields the slots of walls whose first piece has another index than before.
        """
        if self.changed:
            self.records = records(PIECE_DTYPE, sum(len(pieces.rows) for pieces in self._pieces.values()))
            first = 0
            for slot, pieces in self._pieces.items():
                if objects["piece_first"][slot] != first:
                    objects["piece_first"][slot] = first
                    yield slot
                self.records[first : first + len(pieces.rows)] = pieces.rows
                first += len(pieces.rows)
            self.changed = False
        table.piece_count = len(self.records)
        table.pieces = pointer("struct hd_piece[]", self.records)
