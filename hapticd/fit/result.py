"""What every fit gives: figures with intervals, warnings and a verdict; and fits as plain data for JSON."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, cast

import numpy as np

from hapticd.analysis.statistics import Estimate
from hapticd.base.yaml_source import Json
from hapticd.fit.verdict import Exclusion, Verdict


class Fit(Protocol):
    """A frozen dataclass whose figures are Estimates."""

    @property
    def warnings(self) -> tuple[str, ...]: ...

    @property
    def verdict(self) -> str: ...

    @property
    def judged(self) -> Verdict: ...

    @property
    def left_out(self) -> tuple[Exclusion, ...]: ...

    def material(self) -> Mapping[str, object]: ...

    def to_dict(self) -> Mapping[str, object]: ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Judged:
    """What all fits end with."""

    warnings: tuple[str, ...]
    judged: Verdict
    left_out: tuple[Exclusion, ...] = ()

    @property
    def verdict(self) -> str:
        return str(self.judged)

    def to_dict(self) -> Mapping[str, object]:
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
    return {field.name: getattr(made, field.name) for field in dataclasses.fields(made)}


def plain(value: object) -> object:
    """Dataclasses, tuples and arrays as plain data for JSON."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {name: plain(inner) for name, inner in _fields(value).items()}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, tuple | list):
        return [plain(each) for each in value]
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


def fields_of(made: object, *names: str) -> dict[str, Json]:
    """The fields of a dataclass with these names, without any of all, as plain data."""
    return {name: cast(Json, plain(value)) for name, value in _fields(made).items() if not names or name in names}


def end_of(fit: Judged) -> dict[str, Json]:
    """What fits of taps end with: what was left out, warnings and verdict."""
    judged = {"quality": fit.judged.quality, "reasons": list(fit.judged.reasons)}
    return {**fields_of(fit, "left_out", "warnings"), "verdict": fit.verdict, "judged": cast(Json, judged)}
