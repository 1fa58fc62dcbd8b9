"""What the engine is given: points, each known by its identity, in pieces that a worker computes."""

from __future__ import annotations

from typing import Final, Protocol

import numpy as np
import numpy.typing as npt

from hapticd.base.yaml_source import Json
from hapticd.sweeps.columns import Column, Row

ID_DTYPE: Final = np.dtype("V16")
"""The identity of a point: 16 bytes of a hash of everything that it computes."""


class Piece(Protocol):
    """Some points, with everything that computing them needs but the code; a worker gets it by pickle."""

    def __len__(self) -> int:
        """How many points."""

    def rows(self) -> list[Row]:
        """One row a point, in their order. A point that cannot be computed has the reason in its column `error`."""


class Work(Protocol):
    """All points of a study."""

    @property
    def title(self) -> str:
        """What a person calls it."""

    @property
    def columns(self) -> tuple[Column, ...]:
        """Of every row, in order."""

    @property
    def ids(self) -> npt.NDArray[np.void]:
        """(n,) ID_DTYPE, each different."""

    def piece(self, indices: npt.NDArray[np.int64]) -> Piece:
        """The points with these indices."""

    def manifest(self) -> dict[str, Json]:
        """What study.json says of it besides title and columns: at least `kind`, `study` and `seed`."""
