"""Published results in the form in which an analysis shows them: quartiles, percentages of pairs, a difference."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from hapticd.analysis.statistics import Floats
from hapticd.base.yaml_source import Json
from hapticd.experiment.published import published


@dataclass(frozen=True, slots=True)
class PublishedMatrix:
    """Published percent correct of each pair of k items."""

    items: tuple[str, ...]
    percent: Floats
    """Percent correct (k, k), a lower triangle with its diagonal; NaN where nothing is published."""


@dataclass(frozen=True, slots=True)
class PublishedResults:
    """Results of a publication. Results that were not published are empty or None."""

    quartiles: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    """Median, first and third quartile of percent correct, by condition."""
    matrices: Mapping[str, PublishedMatrix] = field(default_factory=dict)
    """Percent correct of each pair of items, by condition."""
    difference: tuple[str, float, float] | None = None
    """Difference of a measure, with vibration minus without: name of the measure, mean, standard deviation."""


def published_results(name: str) -> PublishedResults:
    """Return the published results with the name FILE.SECTION. Raises HapticdError for an unknown name."""
    data = published(name)
    return PublishedResults(_quartiles(data), _matrices(data), _difference(data))


def _quartiles(data: Mapping[str, Json]) -> dict[str, tuple[float, float, float]]:
    found = {}
    listed = data.get("median_and_quartiles")
    for condition, each in (listed if isinstance(listed, dict) else {}).items():
        if isinstance(each, list):
            found[condition] = (_number(each[0]), _number(each[1]), _number(each[2]))
    for condition, own in data.items():
        if isinstance(own, dict) and "median" in own and isinstance(ends := own.get("quartiles"), list):
            found[condition] = (_number(own["median"]), _number(ends[0]), _number(ends[1]))
    return found


def _matrices(data: Mapping[str, Json]) -> dict[str, PublishedMatrix]:
    found = {}
    order, diagonals = data.get("order_of_stiffness"), data.get("table_2_diagonal")
    if isinstance(order, list) and isinstance(diagonals, dict):
        items = tuple(map(str, order))
        for condition, diagonal in diagonals.items():
            assert isinstance(diagonal, list)
            found[condition] = PublishedMatrix(items, _of_names(items, data[f"table_2_{condition}"], diagonal))
    spacings, tables = data.get("spacings_m"), data.get("table_3")
    if isinstance(spacings, list) and isinstance(tables, dict):
        names = tuple(f"{_number(each):g}" for each in spacings)
        for condition, rows in tables.items():
            percent = np.full((len(names), len(names)), np.nan)
            for row, cells in enumerate(rows if isinstance(rows, list) else []):
                assert isinstance(cells, list)
                percent[row, : len(cells)] = [_number(each) for each in cells]
            found[condition] = PublishedMatrix(names, percent)
    return found


def _of_names(items: Sequence[str], table: Json, diagonal: Sequence[Json]) -> Floats:
    """Return the lower triangle of a published table by pairs of items, whose cells have two names in either order."""
    percent = np.diag(np.array([_number(each) for each in diagonal]))
    percent[~np.eye(len(items), dtype=bool)] = np.nan
    assert isinstance(table, dict)
    for one, cells in table.items():
        assert isinstance(cells, dict)
        for other, value in cells.items():
            row, column = sorted((items.index(one), items.index(other)), reverse=True)
            percent[row, column] = _number(value)
    return percent


def _difference(data: Mapping[str, Json]) -> tuple[str, float, float] | None:
    found = data.get("with_vibration_less_by_m")
    if not isinstance(found, dict):
        return None
    return "overtravel_m", -_number(found["mean"]), _number(found["standard_deviation"])


def _number(value: Json) -> float:
    assert isinstance(value, int | float)
    return float(value)
