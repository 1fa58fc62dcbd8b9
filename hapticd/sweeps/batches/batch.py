"""A batch as the engine has it: each fit is a point, known by what its recordings hold, by its options and the code.

A row keeps what the fit gives to its material, and what is reported of it, as JSON in the column `found`: materials are
made of rows, without recordings. Workers read the recordings themselves: they see the same files at the same paths.
"""

from __future__ import annotations

import dataclasses
import datetime
import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from hapticd.base.errors import HapticdError, on_one_line
from hapticd.base.model import plain
from hapticd.base.yaml_source import Json
from hapticd.sweeps.batches.tree import RecordingSet, Tree, fingerprint
from hapticd.sweeps.columns import ERROR_COLUMN, POINT_COLUMN, Column, Row
from hapticd.sweeps.identity import sum_of
from hapticd.sweeps.work import ID_DTYPE
from hapticd.sweeps.worker_check import code_version

Quality: TypeAlias = Literal["good", "fair", "poor", "refused"]
PICTURE_DIGITS: Final = 6
"""Of what is drawn."""

FIT_COLUMNS: Final = (
    POINT_COLUMN,
    Column("material", "text", "varied", description="Name of the material: its folder's."),
    Column("kind", "text", "varied", description="Kind of the fit: tap, grooves, texture, puncture."),
    Column("recordings", "integer", "measured", description="Recordings of the fit."),
    Column("left_out", "integer", "measured", description="Recordings of which nothing was used."),
    Column("quality", "text", "measured", description="The verdict: good, fair or poor."),
    Column("verdict", "text", "measured", description="The verdict with its reasons."),
    Column("found", "text", "measured", description="Figures, provenance and pictures, as JSON."),
    ERROR_COLUMN,
)


@dataclass(frozen=True)
class Fits:
    """Some fits: a piece of a batch."""

    root: str
    """The tree, by its absolute path."""
    ids: tuple[str, ...]
    sets: tuple[RecordingSet, ...]

    def __len__(self) -> int:
        return len(self.sets)

    def rows(self) -> list[Row]:
        """One row a fit."""
        return [self._row(point, each) for point, each in zip(self.ids, self.sets, strict=True)]

    def _row(self, point: str, asked: RecordingSet) -> Row:
        row: Row = dict.fromkeys(column.name for column in FIT_COLUMNS)
        row |= {
            POINT_COLUMN.name: point,
            "material": asked.material,
            "kind": asked.kind,
            "recordings": len(asked.files),
        }
        try:
            row |= fitted_row(self.root, asked)
        except (HapticdError, MemoryError, ArithmeticError) as error:
            row[ERROR_COLUMN.name] = on_one_line(str(error)) or type(error).__name__
        return row


def fitted_row(root: str, asked: RecordingSet) -> Row:
    """Fits the recordings of a set. Raises HapticdError where they do not support it."""
    from hapticd.analysis.statistics import require_scipy
    from hapticd.fit.contribution import added, contribution_of
    from hapticd.fit.from_files import fitted_files
    from hapticd.fit.panels import first_row
    from hapticd.fit.result import estimates, finite, plain_figures
    from hapticd.fit.result import plain as plain_data

    require_scipy()
    for file in asked.files:
        if fingerprint(os.path.join(root, file.name), file.name) != file:
            raise HapticdError(f"{file.name}: was changed since the batch began, or is another file at the worker")
    names = [file.name for file in asked.files]
    used, _, fitted = fitted_files(names, asked.kind, asked.options, lambda _: None, asked.strict, root)
    part = contribution_of(asked.kind, fitted, used)
    # What no material may have is refused here, where it is a fault of this fit.
    added(part, asked.material, datetime.date.min, onto=None, stiffness_n_per_m=asked.stiffness_n_per_m)
    found = {
        "figures": plain(dict(part.figures)),
        "origin": plain(dict(part.origin)),
        "notes": list(fitted.notes),
        "warnings": list(fitted.fit.warnings),
        "estimates": {name: [each.value, each.low, each.high] for name, each in estimates(fitted.fit).items()},
        "plain": plain_figures(fitted.fit),
        "panels": [_rounded(finite(plain_data(panel))) for panel in first_row(asked.kind, fitted.fit, used)],
    }
    return {
        "left_out": len(names) - len(used),
        "quality": fitted.fit.judged.quality,
        "verdict": fitted.fit.verdict,
        "found": json.dumps(finite(found)),
    }


def _rounded(value: object) -> object:
    if isinstance(value, float):
        return float(f"{value:.{PICTURE_DIGITS}g}")
    if isinstance(value, dict):
        return {key: _rounded(inner) for key, inner in value.items()}
    return [_rounded(inner) for inner in value] if isinstance(value, list) else value


@dataclass(frozen=True)
class Batch:
    """All fits of a tree."""

    tree: Tree

    @property
    def title(self) -> str:
        """The tree's name."""
        return f"Fits of {self.tree.path}"

    @property
    def columns(self) -> tuple[Column, ...]:
        """Of every row."""
        return FIT_COLUMNS

    @cached_property
    def ids(self) -> npt.NDArray[np.void]:
        """(n,) of ID_DTYPE, in the order of the tree's sets."""
        sums = np.array([sum_of(_document(each)) for each in self.tree.sets], np.uint64).reshape(-1, 2)
        return sums.view(ID_DTYPE).reshape(-1)

    def piece(self, indices: npt.NDArray[np.int64]) -> Fits:
        """The fits with these indices."""
        ids = tuple(each.tobytes().hex() for each in self.ids[indices])
        return Fits(os.path.abspath(self.tree.path), ids, tuple(self.tree.sets[index] for index in indices.tolist()))

    def point(self, index: int) -> str:
        """The identity of a set as a row has it."""
        return bytes(self.ids[index].tobytes()).hex()

    def manifest(self) -> dict[str, Json]:
        """What study.json says besides title and columns."""
        path = os.fsencode(self.tree.path).decode(errors="backslashreplace")
        return {"kind": "batch", "study": {"tree": path}, "seed": 0}


def _document(asked: RecordingSet) -> dict[str, Json]:
    """What a row depends on. The stiffness is not among it: no fit reads it."""
    options: Sequence[tuple[str, Json]] = list(dataclasses.asdict(asked.options).items())
    return {
        "kind": asked.kind,
        "material": asked.material,
        "options": dict(options),
        "strict": asked.strict,
        "files": {file.name: [file.sha256, file.beside] for file in asked.files},
        "code": code_version(),
        "batch": True,
    }
