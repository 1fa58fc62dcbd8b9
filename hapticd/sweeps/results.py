"""The results of a sweep for figures and pages: rows in the order of the varied keys, columns with labels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from pydantic import ValidationError

from hapticd.base.errors import HapticdError
from hapticd.config.schema import unit_suffix_of
from hapticd.sweeps.axes import axes_of, shown_value
from hapticd.sweeps.columns import Column, Row, Value
from hapticd.sweeps.keys import SweepStudy
from hapticd.sweeps.refine import BOUNDARY_COLUMN
from hapticd.sweeps.store import STUDY_FILE, Store


@dataclass(frozen=True)
class Results:
    """The results of a study in a folder."""

    study: SweepStudy
    source: str | None
    """Text of the study's file; None if the study was not read from a file."""
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    points: int
    """Number of points of the study, computed or not."""
    versions: Mapping[str, str]
    """Versions of hapticd, Python and numpy."""

    def column(self, name: str) -> Column:
        """Return the column with this name."""
        return next(column for column in self.columns if column.name == name)

    def named(self, role: str) -> list[str]:
        """Return the names of the columns with a role, such as `varied`, in order."""
        return [column.name for column in self.columns if column.role == role]

    @cached_property
    def _words(self) -> dict[str, str]:
        refine, labels = self.study.refine, dict(self.study.labels)
        if refine is not None:
            labels.setdefault(BOUNDARY_COLUMN, f"{_plain(refine.key.rpartition('.')[2])} at the boundary")
        return words_of(self.columns, labels)

    def words(self, name: str) -> str:
        """Return the label of a column in a figure, without its unit: `handle mass`."""
        return self._words[name]

    @cached_property
    def _planned(self) -> dict[str, list[Value]]:
        """The distinct values of each axis of the study, also at points that are not computed yet."""
        return {
            axis.name: list(dict.fromkeys(shown_value(value, axis.kind) for value in axis.plain_values))
            for axis in axes_of(self.study)
        }

    def values(self, name: str) -> list[Value]:
        """Return the distinct values of a varied column, also at points that are not computed yet.

        Numbers are sorted; texts are in the order of the study.
        """
        found = self._planned[name]
        if self.column(name).kind == "text":
            return list(found)
        return sorted(found, key=lambda value: (value is None, value))


def words_of(columns: Sequence[Column], labels: Mapping[str, str]) -> dict[str, str]:
    """Return the label of each column: that of `labels`, otherwise the last part of its dotted name without the unit.

    Preceding parts of the name are added until the label is unique.
    """
    parts = {column.name: [_plain(part) for part in column.name.split(".")] for column in columns}
    found: dict[str, str] = {}
    for name, own in parts.items():
        unique = (
            count
            for count in range(1, len(own))
            if sum(other[-count:] == own[-count:] for other in parts.values()) == 1
        )
        found[name] = labels.get(name, " ".join(own[-next(unique, len(own)) :]))
    return found


def _plain(part: str) -> str:
    return part.removesuffix(unit_suffix_of(part)).replace("_", " ")


def load_results(store: Store) -> Results:
    """Read the results of a sweep from a folder. Raises HapticdError if they cannot be read."""
    manifest: dict[str, Any] = store.manifest()
    if manifest.get("kind") != "sweep":
        raise HapticdError(f"{store.folder}: holds no results of a sweep; only results of sweeps can be drawn")
    try:
        study = SweepStudy.parsed(manifest["study"])
    except ValidationError:
        raise HapticdError(
            f"{store.folder}/{STUDY_FILE}: written by another version of hapticd; run the study again"
        ) from None
    columns = store.columns()
    rows: list[Row] = store.table().to_pylist()
    if not rows:
        raise HapticdError(f"{store.folder}: no point has been computed yet; run hapticd sweep run again to continue")
    return Results(
        study,
        manifest.get("source"),
        columns,
        tuple(in_order(rows, columns)),
        len(store.points()),
        manifest["versions"],
    )


def in_order(rows: Sequence[Row], columns: Sequence[Column]) -> list[Row]:
    """Return the rows sorted by their varied values."""
    varied = [column.name for column in columns if column.role == "varied"]
    return sorted(rows, key=lambda row: [(row[name] is None, row[name]) for name in varied])


def with_values(rows: Sequence[Row], where: Mapping[str, Value]) -> list[Row]:
    """Return the rows whose columns have the values in `where`."""
    return [row for row in rows if all(row[name] == value for name, value in where.items())]


def best_of(rows: Sequence[Row], better: Mapping[str, str]) -> list[Row]:
    """Return the Pareto-optimal rows: no other row is as good in all columns of `better`, and better in at least one.

    For each column, `better` says whether the `least` or the `most` is best. Rows without a value there are left out.
    """
    known = [row for row in rows if all(row[name] is not None for name in better)]
    if not known:
        return []
    signs = [1.0 if way == "least" else -1.0 for way in better.values()]
    values = np.array(
        [[sign * float(row[name] or 0) for name, sign in zip(better, signs, strict=True)] for row in known]
    )
    beaten = [((values <= own).all(axis=1) & (values < own).any(axis=1)).any() for own in values]
    return [row for row, is_beaten in zip(known, beaten, strict=True) if not is_beaten]
