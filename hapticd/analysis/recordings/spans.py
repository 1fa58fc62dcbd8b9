"""Where a mask of samples is true: its spans."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

Bools: TypeAlias = npt.NDArray[np.bool_]
Spans: TypeAlias = list[tuple[int, int]]
"""First sample, and first after the last."""


def spans_of(mask: Bools) -> Spans:
    """In order."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
    return [(int(low), int(high)) for low, high in zip(edges[::2], edges[1::2], strict=True)]
