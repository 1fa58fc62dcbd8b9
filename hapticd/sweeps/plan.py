"""The plan of a sweep: its points, their identities, and the pieces that workers compute."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

from hapticd.base.errors import Path
from hapticd.base.yaml_source import Json
from hapticd.config.schema import unit_of
from hapticd.experiment.key_paths import path_of, with_value
from hapticd.sweeps.axes import Axis, axes_of, settings, shown_value
from hapticd.sweeps.columns import ERROR_COLUMN, POINT_COLUMN, Column, Kind, Row, Value, row_of
from hapticd.sweeps.identity import sum_of, sums_at
from hapticd.sweeps.keys import Run, SweepStudy
from hapticd.sweeps.point import DURATION_KEY, OPERATOR_KEY, PARAMETERS_KEY, Point
from hapticd.sweeps.refine import boundary_columns, boundary_of, boundary_row, holds
from hapticd.sweeps.work import ID_DTYPE
from hapticd.sweeps.worker_check import code_version

if TYPE_CHECKING:
    from hapticd.sweeps.measures.measure import Measure

_MATERIALS_KEY: Final = "materials"
"""Key of the materials in a configuration; a material may be given by the name of a shipped one."""


@dataclass(frozen=True)
class Job:
    """The data that all points of a study share; a worker gets these data with each group of points."""

    study: SweepStudy
    root: Mapping[str, Json]
    """The input data that all points share, before the varied keys are set."""
    run: Run
    names: tuple[str, ...]
    """Names of the axes, which are the varied keys or named levels."""
    kinds: tuple[Kind, ...]
    """For each axis, the kind of its column in the result table: number, integer, boolean or text."""

    def document(self, values: Sequence[Value]) -> dict[str, Json]:
        """Return the document (all input data) of the point with one value for each axis. Raises InvalidError."""
        document = dict(self.root)
        for name, value in zip(self.names, values, strict=True):
            for path, each in self.settings(name, value):
                document = with_value(document, path, each, make=True)
        return document

    def settings(self, name: str, value: Value) -> Iterator[tuple[Path, Json]]:
        """Yield path and value of each key that the axis `name` sets at its value `value`."""
        for key, each in settings(self.study, name, value).items():
            yield path_of(key), each

    @cached_property
    def measures(self) -> tuple[Measure, ...]:
        """The measures of the study. Raises InvalidError."""
        from hapticd.sweeps.measures.registry import parse_measure

        return tuple(parse_measure(each) for each in self.study.measure)

    @cached_property
    def columns(self) -> tuple[Column, ...]:
        """The columns of a point's row, in order."""
        levels = {name for name, axis in self.study.vary.items() if axis.levels is not None}
        varied = [
            Column(name, kind, "varied", "" if name in levels else unit_of(name) or "")
            for name, kind in zip(self.names, self.kinds, strict=True)
        ]
        refine = self.study.refine
        searched = () if refine is None else boundary_columns(refine, unit_of(refine.key) or "")
        measured = (column for measure in self.measures for column in measure.columns)
        return (POINT_COLUMN, *varied, *searched, *measured, ERROR_COLUMN)

    def row(self, point: str, values: Sequence[Value]) -> Row:
        """Compute the row of a point. After an error, measured columns are None and `error` has the reason."""
        shown = {
            name: shown_value(value, kind) for name, kind, value in zip(self.names, self.kinds, values, strict=True)
        }
        measured = self._measured if self.study.refine is None else self._refined
        given = {POINT_COLUMN.name: point, **shown}
        return row_of(self.columns, given, lambda: measured(self.document(values)))

    def _measured(self, document: Mapping[str, Json]) -> Row:
        point = Point(document, self.run)
        found: Row = {}
        for measure in self.measures:
            found |= measure.of(point)
        return found

    def _refined(self, document: dict[str, Json]) -> Row:
        """Search for the boundary of `refine`; measure at the last value that meets its condition, else at `start`."""
        refine = self.study.refine
        assert refine is not None
        path = path_of(refine.key)
        known: dict[float, Row] = {}

        def at(value: float) -> bool:
            known[value] = self._measured(with_value(document, path, value, make=True))
            return holds(refine, known[value])

        boundary = boundary_of(refine, at)
        measured = known[refine.start if boundary.holds_at is None else boundary.holds_at]
        return boundary_row(boundary) | measured


@dataclass(frozen=True)
class Points:
    """Some points of a sweep, which one worker computes as one task."""

    job: Job
    ids: tuple[str, ...]
    values: tuple[tuple[Value, ...], ...]
    """For each point, its value on each axis."""

    def __len__(self) -> int:
        return len(self.ids)

    def rows(self) -> list[Row]:
        """Compute one row for each point."""
        return [self.job.row(point, values) for point, values in zip(self.ids, self.values, strict=True)]


@dataclass(frozen=True)
class Plan:
    """All points of a sweep."""

    job: Job
    axes: tuple[Axis, ...]
    ids: npt.NDArray[np.void] = field(repr=False)
    """Identities of the points, (n,) ID_DTYPE."""
    places: npt.NDArray[np.int64] = field(repr=False)
    """For each of n points, the index of the first combination of axis values that has its input data, (n,)."""
    source: str | None = field(default=None, repr=False)
    """Text of the study's file; None if the study was not read from a file."""

    @property
    def title(self) -> str:
        """Title of the study."""
        return self.job.study.title

    @property
    def columns(self) -> tuple[Column, ...]:
        """The columns of every row, in order."""
        return self.job.columns

    def piece(self, indices: npt.NDArray[np.int64]) -> Points:
        """Return the points with these indices, with all data that computing them needs."""
        places = self.places[indices]
        columns = [_values_at(axis, places) for axis in self.axes]
        values = tuple(zip(*columns, strict=True)) if columns else ((),) * len(indices)
        return Points(self.job, tuple(each.tobytes().hex() for each in self.ids[indices]), values)

    def manifest(self) -> dict[str, Json]:
        """Return the members of study.json other than title, columns and versions."""
        study = self.job.study
        found: dict[str, Json] = {"kind": "sweep", "study": study.to_dict(), "seed": study.seed}
        return found if self.source is None else {**found, "source": self.source}


def _values_at(axis: Axis, places: npt.NDArray[np.int64]) -> Sequence[Value]:
    index = axis.of_point[places]
    if isinstance(axis.values, np.ndarray):
        found: list[Value] = axis.values[index].tolist()
        return found
    return [axis.values[each] for each in index.tolist()]


def plan(study: SweepStudy) -> Plan:
    """Return the plan of a validated study. Combinations of values with the same input data are one point.

    Raises InvalidError, with paths of the study's keys. A fault of a single point is not raised: its row reports it.
    """
    axes = axes_of(study)
    root: dict[str, Json] = dict(study.base)
    if study.operator is not None:
        root[OPERATOR_KEY] = study.operator
    if study.parameters:
        root[PARAMETERS_KEY] = study.parameters
    if study.duration_s is not None:
        root[DURATION_KEY] = study.duration_s
    run: Run = study.run or ("none" if study.operator is None else "simulate")
    job = Job(study, root, run, tuple(axis.name for axis in axes), tuple(axis.kind for axis in axes))
    total = len(axes[0].of_point) if axes else 1
    sums = _document_hashes(job, axes, total) + _shared_hash(job)
    ids, places = np.unique(sums.view(ID_DTYPE).reshape(-1), return_index=True)
    order = np.argsort(places, kind="stable")  # in the order of the axes, not of the hashes
    return Plan(job, axes, ids[order], places[order])


def _shared_hash(job: Job) -> npt.NDArray[np.uint64]:
    """Return the hash, (2,), of the data that all results depend on: measures, code version and names of columns."""
    from hapticd.sweeps.measures.registry import identity_of

    study = job.study
    refine = None if study.refine is None else study.refine.to_dict()
    context: dict[str, Json] = {
        "run": job.run,
        "measure": [identity_of(each) for each in study.measure],
        "refine": refine,
        "code": code_version(),
        # A row has the varied values in columns of these names.
        "names": list(job.names),
        "levels": {name: list(axis.levels) for name, axis in study.vary.items() if axis.levels is not None},
    }
    return sum_of(context, ("",))


def _document_hashes(job: Job, axes: Sequence[Axis], total: int) -> npt.NDArray[np.uint64]:
    """Return the hashes of the documents (all input data) of n = `total` points, (n, 2).

    If the axes are independent, each value of an axis is hashed only once. Otherwise each document is hashed.
    """
    if not _are_independent(job, axes):
        return np.array([sum_of(job.document(_combination(axes, index))) for index in range(total)])
    found = np.broadcast_to(sum_of(job.document(_combination(axes, 0))), (total, 2)).copy()
    for axis in axes:
        sums = _axis_hashes(job, axis)
        index = axis.of_point
        begin = int(index[0])
        found += (sums - sums[begin])[index]
    return found


def _combination(axes: Sequence[Axis], index: int) -> list[Value]:
    return [_values_at(axis, np.array([index]))[0] for axis in axes]


def _axis_hashes(job: Job, axis: Axis) -> npt.NDArray[np.uint64]:
    """Return for each of the m values of an axis the hash of all keys that the axis sets, (m, 2)."""
    values = axis.plain_values
    if job.study.vary[axis.name].levels is None and not _names_material(path_of(axis.name), values):
        return sums_at(path_of(axis.name), values)
    paths = _paths(job, axis)
    found = []
    for value in values:
        document: dict[str, Json] = dict(job.root)
        for path, each in job.settings(axis.name, value):
            document = with_value(document, path, each, make=True)
        found.append(sum((sum_of(_part_at(document, path), path) for path in paths), np.zeros(2, np.uint64)))
    return np.array(found)


def _part_at(document: Json, path: Path) -> Json:
    """Return the part of a document at a path; if there is none, an empty mapping, which does not change a hash."""
    for key in path:
        inside = key in document if isinstance(document, dict) else isinstance(key, int)
        if not isinstance(document, dict | list) or not inside:
            return {}
        document = document[key]  # type: ignore[index]
    return document


def _paths(job: Job, axis: Axis) -> set[Path]:
    """Return the paths of the keys that an axis sets for any of its values."""
    if job.study.vary[axis.name].levels is None:
        return {path_of(axis.name)}
    return {path for value in axis.values for path, _ in job.settings(axis.name, value)}


def _names_material(path: Path, values: Sequence[Value]) -> bool:
    """Return whether `path` is that of a material, and `values` has names of shipped materials that replace it."""
    return len(path) == 2 and path[0] == _MATERIALS_KEY and any(isinstance(value, str) for value in values)


def _are_independent(job: Job, axes: Sequence[Axis]) -> bool:
    """Return whether no axis changes a key that another axis sets. Then the hashes of the axes may be added."""
    paths = [_paths(job, axis) for axis in axes]
    for index, own in enumerate(paths):
        others = set().union(*(other for place, other in enumerate(paths) if place != index))
        for path in own:
            if any(path[: len(other)] == other or other[: len(path)] == path for other in others):
                return False
            # A material given by its name may be one that another axis changes.
            if len(path) == 2 and path[0] == _MATERIALS_KEY and any(other[0] == _MATERIALS_KEY for other in others):
                return False
    return True
