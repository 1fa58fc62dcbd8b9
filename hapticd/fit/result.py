"""What every fit gives: figures with intervals, warnings and a verdict; and fits as plain data for JSON."""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import cast

import numpy as np

from hapticd.analysis.statistics import Estimate
from hapticd.base.yaml_source import Json
from hapticd.fit.verdict import Exclusion, Verdict


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit(ABC):
    """The result of a fit: figures (Estimates), warnings, verdict. A field that is for drawing alone has `repr=False`
    and is not in the JSON."""

    warnings: tuple[str, ...]
    judged: Verdict
    left_out: tuple[Exclusion, ...] = ()

    @property
    def verdict(self) -> str:
        return str(self.judged)

    @abstractmethod
    def material(self) -> Mapping[str, object]:
        """Keys of a YAML material."""

    def to_dict(self) -> dict[str, Json]:
        """Plain data for JSON."""
        return {**fields_of(self), "verdict": self.verdict}


def estimates(fit: Fit) -> dict[str, Estimate]:
    """The figures of a fit that have an interval, by name; those of a part of it as `part.name`."""
    found: dict[str, Estimate] = {}
    for name, value in _fields(fit).items():
        if isinstance(value, Estimate):
            found[name] = value
        elif dataclasses.is_dataclass(value):
            parts = _fields(value).items()
            found |= {f"{name}.{part}": inner for part, inner in parts if isinstance(inner, Estimate)}
    return found


def plain_figures(fit: Fit) -> dict[str, float]:
    """The figures of a fit that have no interval, by name."""
    return {name: value for name, value in _fields(fit).items() if isinstance(value, float) and math.isfinite(value)}


def _fields(made: object) -> dict[str, object]:
    assert dataclasses.is_dataclass(made)
    return {field.name: getattr(made, field.name) for field in dataclasses.fields(made) if field.repr}


def fields_of(made: object, *names: str) -> dict[str, Json]:
    """The fields of a dataclass with these names (all if none are given) as plain data, but those of `repr=False`."""
    return {name: cast(Json, plain(value)) for name, value in _fields(made).items() if not names or name in names}


def plain(value: object) -> object:
    """Dataclasses, tuples and arrays as plain data for JSON."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        as_dict = getattr(value, "to_dict", None)
        return fields_of(value) if as_dict is None else as_dict()
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, tuple | list):
        return [plain(each) for each in value]
    if isinstance(value, Mapping):
        return {name: plain(each) for name, each in value.items()}
    return value


def finite(value: object) -> object:
    """Plain data with null for each number that JSON does not have."""
    if isinstance(value, Mapping):
        return {str(key): finite(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [finite(inner) for inner in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
