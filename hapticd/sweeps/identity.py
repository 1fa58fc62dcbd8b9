"""The identity of a point: 16 bytes by which two studies, or two runs of one, know that they compute the same.

A document of plain data is the set of its leaves, each a path and a value. A leaf's number is the BLAKE2b hash of both,
as two integers modulo 2**64; a document's identity is the sum over its leaves. So the identities of a million points
that differ in a few keys need the hashes of those keys alone, and two studies that reach the same document by other
axes agree. (Incremental hashing by sums: Bellare and Micciancio 1997; here against accidents, not against attacks.)
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from hashlib import blake2b
from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt

from hapticd.base.errors import Path
from hapticd.base.yaml_source import Json

Sums: TypeAlias = npt.NDArray[np.uint64]
"""(n, 2), or (2,) of one document; sums are modulo 2**64."""
_MAX_EXACT_INTEGER: Final = 2**53
"""Integers up to here are the same numbers as floats."""


def sum_of(data: Json, path: Path = ()) -> Sums:
    """The sum over the leaves of a part of a document that stands at `path`, (2,). An empty mapping has none."""
    total = np.zeros(2, np.uint64)
    pending: list[tuple[Path, Json]] = [(path, data)]
    while pending:
        here, value = pending.pop()
        if isinstance(value, dict):
            pending += [((*here, key), inner) for key, inner in value.items()]
        elif isinstance(value, list) and value:
            pending += [((*here, index), inner) for index, inner in enumerate(value)]
        else:
            total += _leaf(_path_bytes(here), value)
    return total


def sums_at(path: Path, values: Iterable[Json]) -> Sums:
    """Of each scalar at a path, (n, 2)."""
    prefix = blake2b(_path_bytes(path), digest_size=16)
    found = bytearray()
    for value in values:
        leaf = prefix.copy()
        leaf.update(_scalar_bytes(value))
        found += leaf.digest()
    return np.frombuffer(bytes(found), np.uint64).reshape(-1, 2)


def _leaf(path: bytes, value: Json) -> Sums:
    return np.frombuffer(blake2b(path + _scalar_bytes(value), digest_size=16).digest(), np.uint64)


def _path_bytes(path: Path) -> bytes:
    return json.dumps(path, separators=(",", ":")).encode() + b"="


def _scalar_bytes(value: Json) -> bytes:
    """A number is the same whether it is written 1000 or 1000.0."""
    if isinstance(value, float) or (
        isinstance(value, int) and not isinstance(value, bool) and abs(value) <= _MAX_EXACT_INTEGER
    ):
        return repr(float(value)).encode()
    return json.dumps(value).encode()
