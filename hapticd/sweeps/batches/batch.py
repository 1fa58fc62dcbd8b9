"""A batch as a study of the engine: each point is a fit, identified by its recordings, its options and the code.

The column `found` of a row holds the result of the fit as JSON: the keys of the material, provenance and plots. So
materials are made from rows, without reading recordings again. Workers read the recordings at the same paths.
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

from hapticd.base.errors import HapticdError
from hapticd.base.model import plain
from hapticd.base.yaml_source import Json
from hapticd.sweeps.batches.tree import RecordingSet, Tree, fingerprint
from hapticd.sweeps.columns import ERROR_COLUMN, POINT_COLUMN, Column, Row, Value, row_of
from hapticd.sweeps.identity import sum_of
from hapticd.sweeps.work import ID_DTYPE
from hapticd.sweeps.worker_check import code_version

Quality: TypeAlias = Literal["good", "fair", "poor", "refused"]
PICTURE_DIGITS: Final = 6
"""Number of significant digits of the numbers in plots."""
FIT_COLUMNS: Final = (
    POINT_COLUMN,
    Column("material", "text", "varied", description="Name of the material, which is that of its folder."),
    Column("kind", "text", "varied", description="Kind of the fit: tap, grooves, texture, puncture."),
    Column("recordings", "integer", "measured", description="Number of recordings of the fit."),
    Column("left_out", "integer", "measured", description="Number of recordings that were not used."),
    Column("quality", "text", "measured", description="The verdict: good, fair or poor."),
    Column("verdict", "text", "measured", description="The verdict with its reasons."),
    Column("found", "text", "measured", description="Figures, provenance and plots, as JSON."),
    ERROR_COLUMN,
)


@dataclass(frozen=True)
class Fits:
    """Some fits of a batch, which one worker computes as one task: a `Piece` of `sweeps/work.py`."""

    root: str
    """Absolute path of the tree of recordings."""
    ids: tuple[str, ...]
    sets: tuple[RecordingSet, ...]

    def __len__(self) -> int:
        return len(self.sets)

    def rows(self) -> list[Row]:
        """Compute the row of each fit."""
        return [self._row(point, each) for point, each in zip(self.ids, self.sets, strict=True)]

    def _row(self, point: str, recordings: RecordingSet) -> Row:
        given: dict[str, Value] = {
            POINT_COLUMN.name: point,
            "material": recordings.material,
            "kind": recordings.kind,
            "recordings": len(recordings.files),
        }
        return row_of(FIT_COLUMNS, given, lambda: fitted_row(self.root, recordings))


def fitted_row(root: str, recordings: RecordingSet) -> Row:
    """Fit the recordings of one fit and return its measured columns. Raises HapticdError if the fit is impossible."""
    from hapticd.analysis.statistics import require_scipy
    from hapticd.fit.contribution import added, contribution_of
    from hapticd.fit.from_files import fitted_files
    from hapticd.fit.panels import first_row
    from hapticd.fit.result import estimates, finite, plain_figures
    from hapticd.fit.result import plain as plain_data

    require_scipy()
    for file in recordings.files:
        if fingerprint(os.path.join(root, file.name), file.name) != file:
            raise HapticdError(f"{file.name}: changed since the batch began, or differs at the worker")
    names = [file.name for file in recordings.files]
    used, _, fitted = fitted_files(names, recordings.kind, recordings.options, lambda _: None, recordings.strict, root)
    part = contribution_of(recordings.kind, fitted, used)
    # Values that are invalid in a material are refused here, so that the error belongs to this fit.
    added(part, recordings.material, datetime.date.min, onto=None, stiffness_n_per_m=recordings.stiffness_n_per_m)
    found = {
        "figures": plain(dict(part.figures)),
        "origin": plain(dict(part.origin)),
        "notes": list(fitted.notes),
        "warnings": list(fitted.fit.warnings),
        "estimates": {name: [each.value, each.low, each.high] for name, each in estimates(fitted.fit).items()},
        "plain": plain_figures(fitted.fit),
        "panels": [_rounded(finite(plain_data(panel))) for panel in first_row(recordings.kind, fitted.fit, used)],
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
    """All fits of a tree of recordings."""

    tree: Tree

    @property
    def title(self) -> str:
        """Title of the batch, with the path of the tree of recordings."""
        return f"Fits of {self.tree.path}"

    @property
    def columns(self) -> tuple[Column, ...]:
        """The columns of each fit's row."""
        return FIT_COLUMNS

    @cached_property
    def ids(self) -> npt.NDArray[np.void]:
        """The identities of the n fits, (n,) ID_DTYPE, in the order of `tree.sets`."""
        sums = np.array([sum_of(_document(each)) for each in self.tree.sets], np.uint64).reshape(-1, 2)
        return sums.view(ID_DTYPE).reshape(-1)

    def piece(self, indices: npt.NDArray[np.int64]) -> Fits:
        """Return the fits whose indices in `ids` are `indices`."""
        ids = tuple(each.tobytes().hex() for each in self.ids[indices])
        return Fits(os.path.abspath(self.tree.path), ids, tuple(self.tree.sets[index] for index in indices.tolist()))

    def point(self, index: int) -> str:
        """Return the identity of a fit as hexadecimal digits, as in the column `point`."""
        return bytes(self.ids[index].tobytes()).hex()

    def manifest(self) -> dict[str, Json]:
        """Return the members of study.json (see `sweeps/store.py`) other than title, columns and versions."""
        path = os.fsencode(self.tree.path).decode(errors="backslashreplace")
        return {"kind": "batch", "study": {"tree": path}, "seed": 0}


def _document(recordings: RecordingSet) -> dict[str, Json]:
    """Return the document whose hash identifies a fit. `stiffness_n_per_m`, which no fit uses, is omitted."""
    options: Sequence[tuple[str, Json]] = list(dataclasses.asdict(recordings.options).items())
    return {
        "kind": recordings.kind,
        "material": recordings.material,
        "options": dict(options),
        "strict": recordings.strict,
        "files": {file.name: [file.sha256, file.yaml_sha256] for file in recordings.files},
        "code": code_version(),
        "batch": True,
    }
