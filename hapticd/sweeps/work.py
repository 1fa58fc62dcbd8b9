"""The interface of a study to the engine: its points, their identities, and pieces, which are groups of points."""

from __future__ import annotations

from typing import Final, Protocol

import numpy as np
import numpy.typing as npt

from hapticd.base.yaml_source import Json
from hapticd.sweeps.columns import Column, Row

ID_DTYPE: Final = np.dtype("V16")
"""Data type of the identity of a point: a hash of 16 bytes of everything that the point's result depends on."""


class Piece(Protocol):
    """A group of points with all data that their computation needs. Pieces are pickled and sent to workers."""

    def __len__(self) -> int:
        """Return the number of points."""

    def rows(self) -> list[Row]:
        """Compute one row for each point, in order.

        The row of a point that cannot be computed has the reason in its column `error`.
        """


class Work(Protocol):
    """All points of a study."""

    @property
    def title(self) -> str:
        """Title of the study."""

    @property
    def columns(self) -> tuple[Column, ...]:
        """The columns of each point's row, in order."""

    @property
    def ids(self) -> npt.NDArray[np.void]:
        """The identities of the points, (n,) ID_DTYPE, all different."""

    def piece(self, indices: npt.NDArray[np.int64]) -> Piece:
        """Return the points whose indices in `ids` are `indices`."""

    def manifest(self) -> dict[str, Json]:
        """Return further members of study.json (see `sweeps/store.py`): at least `kind`, `study` and `seed`."""
