"""Fits as plain data for JSON."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, cast

import numpy as np

from hapticd.base.yaml_source import Json

if TYPE_CHECKING:
    from hapticd.fit.provenance import Fit


def plain(value: object) -> object:
    """Dataclasses, tuples and arrays as plain data for JSON."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, tuple | list):
        return [plain(each) for each in value]
    if isinstance(value, np.generic):
        return value.item()
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
    assert dataclasses.is_dataclass(made)
    wanted = names or [field.name for field in dataclasses.fields(made)]
    return {name: cast(Json, plain(getattr(made, name))) for name in wanted}


def end_of(fit: Fit) -> dict[str, Json]:
    """What fits of taps end with: what was left out, warnings and verdict."""
    return {
        **fields_of(fit, "left_out", "warnings"),
        "verdict": fit.verdict,
        "judged": {"quality": fit.judged.quality, "reasons": list(fit.judged.reasons)},
    }
