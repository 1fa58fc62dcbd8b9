"""The spans in which a mask of samples is true."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

Bools: TypeAlias = npt.NDArray[np.bool_]
Spans: TypeAlias = list[tuple[int, int]]
"""Pairs of the first sample of a span and the first sample after it."""


def spans_of(mask: Bools) -> Spans:
    """Return the spans of true samples in a mask (n,), in order."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
    return [(int(low), int(high)) for low, high in zip(edges[::2], edges[1::2], strict=True)]
