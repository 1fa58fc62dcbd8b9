"""Walls with patches: the pieces that each is made of, wall after wall."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hapticd.base.core import PIECE_DTYPE, CData, pointer, records
from hapticd.config.scene import Patch, Wall
from hapticd.rendering.compiler.materials import Materials


class Pieces(NamedTuple):
    """What a wall with patches is made of."""

    patches: Sequence[Patch]
    of: tuple[str, float]
    """The material between them, and the ramp."""
    rows: npt.NDArray[np.void]
    """PIECE_DTYPE."""
    materials: frozenset[int]
    """Used once each."""


def same(one: Pieces | None, other: Pieces | None) -> bool:
    """Whether two walls are made of the same."""
    if one is None or other is None:
        return one is other
    return one is other or np.array_equal(one.rows, other.rows)


class PatchedWalls:
    """The pieces of walls, by slot."""

    def __init__(self, materials: Materials) -> None:
        self._materials = materials
        self._pieces: dict[int, Pieces] = {}
        """In order of the slots' first pieces."""
        self.records = records(PIECE_DTYPE, 0)
        """All of them, as of the last `write`."""
        self.changed = False
        """Since `write` was called."""

    def of(self, slot: int) -> Pieces | None:
        """What the wall at a slot is made of; None without patches."""
        return self._pieces.get(slot)

    def made_of(self, materials: Iterable[int]) -> list[int]:
        """The slots of walls that have any of these materials in their pieces."""
        sought = set(materials)
        return [slot for slot, pieces in self._pieces.items() if not sought.isdisjoint(pieces.materials)]

    def use(self, wall: Wall, held: Pieces | None) -> Pieces:
        """The pieces of a wall, whose materials are used from now on; those that its slot holds, if they are the same.

        Where two meet, they share the shorter of the ramp and the stretches beside it.
        """
        if held is not None and held.patches == wall.patches and held.of == (wall.material, wall.patch_ramp_m):
            return held
        begins, names = wall.stretches()
        indices = {name: self._materials.use(name) for name in dict.fromkeys(names)}
        rows = records(PIECE_DTYPE, len(begins))
        lengths = np.diff(begins, append=math.inf)
        rows["from_m"] = begins
        rows["from_m"][0] = 0.0
        rows["half_ramp_m"][1:] = np.minimum(np.minimum(lengths[:-1], lengths[1:]), wall.patch_ramp_m) / 2.0
        rows["material"] = np.fromiter(map(indices.__getitem__, names), np.uint32, len(names))
        return Pieces(wall.patches, (wall.material, wall.patch_ramp_m), rows, frozenset(indices.values()))

    def put(self, slot: int, pieces: Pieces | None) -> None:
        """The wall at a slot is made of these from now on, or of none; those that stay lie where they are."""
        held = self._pieces.get(slot)
        if held is not None:
            for material in held.materials:
                self._materials.release(material)
        self.changed |= not same(held, pieces)
        if pieces is None:
            self._pieces.pop(slot, None)
        else:
            self._pieces[slot] = pieces

    def write(self, table: CData, objects: npt.NDArray[np.void]) -> Iterator[int]:
        """Puts all pieces into a table, and where those of each wall begin into its object; the slots of those that
        moved."""
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
