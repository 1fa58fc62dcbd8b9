"""Results of fits: values with intervals, warnings and a verdict, and their conversion to plain data for JSON."""

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
    """Result of a fit: fitted values with intervals (Estimate), warnings and verdict.

    A field with `repr=False` is for the report's pictures only, and not part of the JSON.
    """

    warnings: tuple[str, ...]
    judged: Verdict
    left_out: tuple[Exclusion, ...] = ()

    @property
    def verdict(self) -> str:
        """The verdict as text."""
        return str(self.judged)

    @abstractmethod
    def material(self) -> Mapping[str, object]:
        """Return the keys of a YAML material."""

    def to_dict(self) -> dict[str, Json]:
        """Return the fit as plain data for JSON."""
        return {**fields_of(self), "verdict": self.verdict}


def estimates(fit: Fit) -> dict[str, Estimate]:
    """Return the fitted values that have an interval, by name; those in a nested dataclass are named `field.name`."""
    found: dict[str, Estimate] = {}
    for name, value in _fields(fit).items():
        if isinstance(value, Estimate):
            found[name] = value
        elif dataclasses.is_dataclass(value):
            parts = _fields(value).items()
            found |= {f"{name}.{part}": inner for part, inner in parts if isinstance(inner, Estimate)}
    return found


def plain_figures(fit: Fit) -> dict[str, float]:
    """Return the fitted values that have no interval and are finite, by name."""
    return {name: value for name, value in _fields(fit).items() if isinstance(value, float) and math.isfinite(value)}


def _fields(made: object) -> dict[str, object]:
    assert dataclasses.is_dataclass(made)
    return {field.name: getattr(made, field.name) for field in dataclasses.fields(made) if field.repr}


def fields_of(made: object, *names: str) -> dict[str, Json]:
    """Return the fields with these names, by default all, as plain data; fields with `repr=False` are left out."""
    return {name: cast(Json, plain(value)) for name, value in _fields(made).items() if not names or name in names}


def plain(value: object) -> object:
    """Return a value of dataclasses, tuples, maps and arrays as plain data for JSON."""
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
    """Return plain data with None instead of NaN and infinity, which JSON does not have."""
    if isinstance(value, Mapping):
        return {str(key): finite(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [finite(inner) for inner in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
