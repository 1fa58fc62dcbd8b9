"""The values of what is varied, and which of them make a point: crossed, zipped, or drawn at random."""

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
    """What is varied under one name."""

    name: str
    """The key's path, or what a person calls the levels."""
    values: tuple[Value, ...] | Floats
    """The different values; the names of levels."""
    of_point: Indices
    """(n,) which of the values each point has."""
    kind: Kind

    @property
    def plain_values(self) -> Sequence[Value]:
        """The different values, none of them numpy's."""
        return self.values.tolist() if isinstance(self.values, np.ndarray) else self.values


def axes_of(study: SweepStudy) -> tuple[Axis, ...]:
    """What each point has of everything that is varied; without an axis there is one point.

    Draws depend on the seed and on the axis' name alone, not on other axes. Raises InvalidError where there would be
    too many points, or where axes that are zipped are not of one length.
    """
    if study.combine in DRAWING_COMBINES:
        assert study.count is not None
        return tuple(_drawn(study, name, axis, study.count) for name, axis in study.vary.items())
    values = {name: _listed(study, name, axis) for name, axis in study.vary.items()}
    counts = [len(each) for each in values.values()]
    if study.combine == "zipped":
        if len(set(counts)) > 1:
            lengths = ", ".join(f"{name} {len(each)}" for name, each in values.items())
            raise InvalidError([Problem("vary", f"zipped keys need equally many values, have: {lengths}")])
        index = np.arange(counts[0] if counts else 1, dtype=np.int32)
        return tuple(Axis(name, each, index, _kind(each)) for name, each in values.items())
    total = math.prod(counts)
    if total > MAX_SWEEP_POINTS:
        product = " x ".join(map(str, counts))
        raise InvalidError([Problem("vary", f"would be {product} = {total} points; the most are {MAX_SWEEP_POINTS}")])
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
    """The values of an axis that has a number of them."""
    if axis.values is not None:
        return _alike(axis.values)
    if axis.levels is not None:
        return tuple(axis.levels)
    if axis.draws is not None:
        return _at(axis, _random(study, name).random(axis.draws))
    assert axis.count is not None and axis.low is not None and axis.high is not None
    if axis.count == 1:
        return np.array([axis.low])
    if axis.spacing == "logarithmic":
        found = np.geomspace(axis.low, axis.high, axis.count)
    else:
        found = np.linspace(axis.low, axis.high, axis.count)
    whole = found.astype(np.int64)
    # Numbers that are counted: seeds, frames.
    return tuple(whole.tolist()) if axis.spacing == "linear" and np.array_equal(whole, found) else found


def _alike(values: tuple[Value, ...]) -> tuple[Value, ...] | Floats:
    kinds = set(map(type, values))
    if float in kinds and kinds <= {int, float}:
        return np.array(values, dtype=np.float64)
    return values


def shown_value(value: Value, kind: Kind) -> Value:
    """A value as its column has it: where values are of several types, all of them are texts."""
    if kind != "text" or isinstance(value, str):
        return value
    return str(value).lower() if isinstance(value, bool) else f"{value}"


def _at(axis: SweepAxis, part: Floats) -> Floats:
    """The quantiles of an axis' distribution, (n,) from (n,) in 0 to 1."""
    if axis.is_normal:
        assert axis.mean is not None and axis.standard_deviation is not None
        inverse = NormalDist(axis.mean, axis.standard_deviation).inv_cdf
        return np.array([inverse(min(max(each, 1e-16), 1.0 - 1e-16)) for each in part.tolist()])
    assert axis.low is not None and axis.high is not None
    if axis.spacing == "logarithmic":
        return cast(Floats, np.exp(np.log(axis.low) + part * (np.log(axis.high) - np.log(axis.low))))
    return axis.low + part * (axis.high - axis.low)


def _drawn(study: SweepStudy, name: str, axis: SweepAxis, count: int) -> Axis:
    """An axis of drawn points. Of a Latin hypercube each of `count` equally probable parts has one point."""
    random = _random(study, name)
    if study.combine == "random":
        part = random.random(count)
    else:
        part = (random.permutation(count) + random.random(count)) / count
    if axis.values is None and axis.levels is None:
        return Axis(name, _at(axis, part), np.arange(count, dtype=np.int32), "number")
    values = tuple(axis.levels) if axis.levels is not None else _alike(axis.values or ())
    return Axis(name, values, np.minimum(part * len(values), len(values) - 1).astype(np.int32), _kind(values))


def settings(study: SweepStudy, name: str, value: Value) -> Mapping[str, Json]:
    """The keys that a value of an axis sets: its own, or those of the level of that name."""
    levels = study.vary[name].levels
    return {name: value} if levels is None else levels[str(value)]
