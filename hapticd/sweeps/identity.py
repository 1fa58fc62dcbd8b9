"""The identity of a point: 16 bytes, equal for points whose results must be equal, even in different studies.

The identity is the hash of a document: JSON data with everything that the result depends on. A leaf of a document is a
path with the scalar at this path. The hash of a leaf is the BLAKE2b hash of path and value, as two integers modulo
2**64. The hash of a document is the sum of the hashes of its leaves. So only leaves that differ between points are
hashed for each point. (Incremental hashing by sums: Bellare and Micciancio 1997. It does not protect against attacks.)
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
"""Sums of leaf hashes modulo 2**64: (n, 2) for n documents, or (2,) for one."""
_MAX_EXACT_INTEGER: Final = 2**53
"""Integers up to 2**53 in magnitude are represented exactly by a float."""


def sum_of(data: Json, path: Path = ()) -> Sums:
    """Return the hash, (2,), of `data`, the value at `path` in a document: the sum of the hashes of its leaves.

    Leaves are scalars and empty lists; an empty mapping has no leaves.
    """
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
    """Return for each of n scalars the hash of `path` with this scalar, (n, 2)."""
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
    """Return the JSON text of a scalar as bytes; the text is the same for 1000 and 1000.0."""
    if isinstance(value, float) or (
        isinstance(value, int) and not isinstance(value, bool) and abs(value) <= _MAX_EXACT_INTEGER
    ):
        return repr(float(value)).encode()
    return json.dumps(value).encode()
