"""A study with a known result, for tests of the engine; workers import this module."""

from __future__ import annotations

import os
import signal
from dataclasses import dataclass
from pathlib import Path
from time import process_time, sleep
from typing import Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from hapticd.base.yaml_source import Json
from hapticd.sweeps.columns import ERROR_COLUMN, POINT_COLUMN, Column, Row
from hapticd.sweeps.work import ID_DTYPE

COLUMNS = (
    POINT_COLUMN,
    Column("n", "integer", "varied"),
    Column("root", "number", "measured", "m", "Root of n."),
    ERROR_COLUMN,
)
Fault: TypeAlias = Literal["none", "exits", "raises", "eats", "is killed", "has no memory"]
BAD = 13
"""The point with a fault."""
_ALLOCATED_BYTES, _MAX_ALLOCATED_BYTES = 1 << 25, 1 << 32
"""Memory that the fault `eats` allocates at a time, and in total."""


@dataclass(frozen=True)
class RootsPiece:
    """The roots of some numbers."""

    numbers: tuple[int, ...]
    fault: Fault
    log: str | None
    """File that gets a line with the numbers of each piece."""
    busy_s: float
    """Additional processor time of each number."""

    def __len__(self) -> int:
        return len(self.numbers)

    def rows(self) -> list[Row]:
        """Return a row for each number. The number BAD ends its process or raises an exception."""
        if self.log is not None:
            with Path(self.log).open("a") as file:
                file.write(" ".join(map(str, self.numbers)) + "\n")
        if BAD in self.numbers:
            _fail(self.fault)
        until = process_time() + self.busy_s * len(self.numbers)
        while process_time() < until:
            pass
        return [{"point": id_of(n).hex(), "n": n, "root": float(np.sqrt(n)), "error": None} for n in self.numbers]


def _fail(fault: Fault) -> None:
    match fault:
        case "exits":
            os._exit(7)
        case "raises":
            raise LookupError("nobody\nexpects this")
        case "is killed":
            os.kill(os.getpid(), signal.SIGKILL)  # as the kernel does when memory is exhausted
        case "has no memory":
            raise MemoryError("Unable to allocate 8.00 TiB")
        case "eats":
            # Slowly, so that dask notices the growing memory.
            allocated = []
            while len(allocated) * _ALLOCATED_BYTES < _MAX_ALLOCATED_BYTES:
                allocated.append(b"x" * _ALLOCATED_BYTES)
                sleep(0.05)


def id_of(number: int) -> bytes:
    """Return the identity of a number. The order of identities differs from that of numbers."""
    return (number * 0x9E3779B97F4A7C15 % 2**128).to_bytes(16, "big")


@dataclass(frozen=True)
class Roots:
    """The roots of the first numbers."""

    count: int
    fault: Fault = "none"
    log: str | None = None
    busy_s: float = 0.0
    title: str = "Roots"
    columns: tuple[Column, ...] = COLUMNS

    @property
    def ids(self) -> npt.NDArray[np.void]:
        """The identities of the numbers, (count,) ID_DTYPE."""
        return np.frombuffer(b"".join(map(id_of, range(self.count))), ID_DTYPE)

    def piece(self, indices: npt.NDArray[np.int64]) -> RootsPiece:
        """Return the piece with the numbers at these indices."""
        return RootsPiece(tuple(indices.tolist()), self.fault, self.log, self.busy_s)

    def manifest(self) -> dict[str, Json]:
        """Return the members of study.json for a study without keys."""
        return {"kind": "sweep", "study": {}, "seed": 0}
