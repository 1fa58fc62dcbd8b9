"""The axes of a study: the values of each varied key, and their combination into points.

Axes are crossed, zipped, or drawn at random.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import TypeAlias, cast

import numpy as np
import numpy.typing as npt

from hapticd.base.errors import InvalidError, Problem
from hapticd.base.yaml_source import Json
from hapticd.sweeps.columns import Kind, Value
from hapticd.sweeps.keys import DRAWING_COMBINES, MAX_SWEEP_POINTS, SweepAxis, SweepStudy

Indices: TypeAlias = npt.NDArray[np.int32]
Floats: TypeAlias = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Axis:
    """One entry of a study's key `vary`: a varied key, or named levels that each set several keys."""

    name: str
    """Path of the key, or the name that the study gives to the levels."""
    values: tuple[Value, ...] | Floats
    """The values of the key, or the names of the levels."""
    of_point: Indices
    """For each of the n points of the study, the index of its value in `values`, (n,)."""
    kind: Kind

    @property
    def plain_values(self) -> Sequence[Value]:
        """The values of the axis as plain Python objects."""
        return self.values.tolist() if isinstance(self.values, np.ndarray) else self.values


def axes_of(study: SweepStudy) -> tuple[Axis, ...]:
    """Return the axes of a study. A study without axes has one point.

    Random values depend only on the seed and the name of the axis, not on other axes. Raises InvalidError for more than
    MAX_SWEEP_POINTS points, or zipped axes of different lengths.
    """
    if study.combine in DRAWING_COMBINES:
        assert study.count is not None
        return tuple(_drawn(study, name, axis, study.count) for name, axis in study.vary.items())
    values = {name: _listed(study, name, axis) for name, axis in study.vary.items()}
    counts = [len(each) for each in values.values()]
    if study.combine == "zipped":
        if len(set(counts)) > 1:
            lengths = ", ".join(f"{name} {len(each)}" for name, each in values.items())
            raise InvalidError([Problem("vary", f"zipped keys must have the same number of values, have: {lengths}")])
        index = np.arange(counts[0] if counts else 1, dtype=np.int32)
        return tuple(Axis(name, each, index, _kind(each)) for name, each in values.items())
    total = math.prod(counts)
    if total > MAX_SWEEP_POINTS:
        product = " x ".join(map(str, counts))
        raise InvalidError([Problem("vary", f"{product} = {total} points are too many, at most {MAX_SWEEP_POINTS}")])
    found = []
    inner = total
    for name, each in values.items():
        inner //= len(each)
        index = np.tile(np.repeat(np.arange(len(each), dtype=np.int32), inner), total // (len(each) * inner))
        found.append(Axis(name, each, index, _kind(each)))
    return tuple(found)


def _kind(values: tuple[Value, ...] | Floats) -> Kind:
    if isinstance(values, np.ndarray):
        return "number"
    kinds = set(map(type, values))
    if kinds <= {bool}:
        return "boolean"
    if kinds <= {int}:
        return "integer"
    return "number" if kinds <= {int, float} else "text"


def _random(study: SweepStudy, name: str) -> np.random.Generator:
    return np.random.default_rng([study.seed, *name.encode()])


def _listed(study: SweepStudy, name: str, axis: SweepAxis) -> tuple[Value, ...] | Floats:
    """Return the values of an axis with the key `values`, `levels`, `count` or `draws`."""
    if axis.values is not None:
        return _as_floats_if_mixed(axis.values)
    if axis.levels is not None:
        return tuple(axis.levels)
    if axis.draws is not None:
        return _quantiles(axis, _random(study, name).random(axis.draws))
    assert axis.count is not None and axis.low is not None and axis.high is not None
    if axis.count == 1:
        return np.array([axis.low])
    if axis.spacing == "logarithmic":
        found = np.geomspace(axis.low, axis.high, axis.count)
    else:
        found = np.linspace(axis.low, axis.high, axis.count)
    integers = found.astype(np.int64)
    # Integer values such as seeds and frame counts stay integers.
    return tuple(integers.tolist()) if axis.spacing == "linear" and np.array_equal(integers, found) else found


def _as_floats_if_mixed(values: tuple[Value, ...]) -> tuple[Value, ...] | Floats:
    """Return the values as an array of floats if all are numbers and any is a float, otherwise unchanged."""
    kinds = set(map(type, values))
    if float in kinds and kinds <= {int, float}:
        return np.array(values, dtype=np.float64)
    return values


def shown_value(value: Value, kind: Kind) -> Value:
    """Return a value as a column of kind `kind` stores it; a text column stores numbers and booleans as text."""
    if kind != "text" or isinstance(value, str):
        return value
    return str(value).lower() if isinstance(value, bool) else f"{value}"


def _quantiles(axis: SweepAxis, probabilities: Floats) -> Floats:
    """Return the quantiles of an axis with a distribution at n probabilities from 0 to 1, (n,)."""
    if axis.is_normal:
        assert axis.mean is not None and axis.standard_deviation is not None
        inverse = NormalDist(axis.mean, axis.standard_deviation).inv_cdf
        return np.array([inverse(min(max(each, 1e-16), 1.0 - 1e-16)) for each in probabilities.tolist()])
    assert axis.low is not None and axis.high is not None
    if axis.spacing == "logarithmic":
        return cast(Floats, np.exp(np.log(axis.low) + probabilities * (np.log(axis.high) - np.log(axis.low))))
    return axis.low + probabilities * (axis.high - axis.low)


def _drawn(study: SweepStudy, name: str, axis: SweepAxis, count: int) -> Axis:
    """Return an axis with a random value for each of `count` points; a Latin hypercube draws one from each stratum."""
    random = _random(study, name)
    if study.combine == "random":
        probabilities = random.random(count)
    else:
        probabilities = (random.permutation(count) + random.random(count)) / count
    if axis.values is None and axis.levels is None:
        return Axis(name, _quantiles(axis, probabilities), np.arange(count, dtype=np.int32), "number")
    values = tuple(axis.levels) if axis.levels is not None else _as_floats_if_mixed(axis.values or ())
    return Axis(name, values, np.minimum(probabilities * len(values), len(values) - 1).astype(np.int32), _kind(values))


def settings(study: SweepStudy, name: str, value: Value) -> Mapping[str, Json]:
    """Return the keys that a value of an axis sets: the varied key, or the keys of the level with this name."""
    levels = study.vary[name].levels
    return {name: value} if levels is None else levels[str(value)]
