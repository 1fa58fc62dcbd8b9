"""Checks the return value of a user's function against the columns that the study declares."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from hapticd.base.errors import HapticdError, shown
from hapticd.sweeps.columns import Kind, Value

_KIND_TEXTS: Final[Mapping[Kind, str]] = {
    "number": "a finite number",
    "integer": "an integer of 64 bits",
    "boolean": "true or false",
    "text": "a string",
}
"""The valid values of each kind of column, as text for errors."""


def values_of(returned: object, kinds: Mapping[str, Kind]) -> dict[str, Value]:
    """Return the value of each column from the return value of a user's function, as plain Python objects.

    A function with a single column may return its value instead of a mapping. None stands for a missing value. Raises
    HapticdError for columns that are missing or not declared, and for values of a wrong kind.
    """
    if not isinstance(returned, Mapping):
        if len(kinds) != 1:
            raise HapticdError(f"must return a mapping of the columns {', '.join(kinds)}, returned {_type(returned)}")
        returned = dict.fromkeys(kinds, returned)
    missing = [name for name in kinds if name not in returned]
    if missing:
        raise HapticdError(f"returned no column {missing[0]}; return None if it has no value")
    strange = [name for name in returned if name not in kinds]
    if strange:
        raise HapticdError(f"returned unknown column {shown(strange[0])}; declared: {', '.join(kinds)}")
    return {name: _value(name, returned[name], kind) for name, kind in kinds.items()}


def _value(name: str, given: Any, kind: Kind) -> Value:
    if isinstance(given, np.generic) or (isinstance(given, np.ndarray) and given.ndim == 0):
        given = given.item()
    if given is None:
        return None
    match kind:
        case "number" if isinstance(given, int | float) and not isinstance(given, bool) and math.isfinite(given):
            return float(given)
        case "integer" if isinstance(given, int) and not isinstance(given, bool) and -(2**63) <= given < 2**63:
            return int(given)
        case "boolean" if isinstance(given, bool):
            return given
        case "text" if isinstance(given, str):
            return given.encode(errors="replace").decode()
    known = given is None or isinstance(given, bool | int | float | str)
    raise HapticdError(f"column {name} must be {_KIND_TEXTS[kind]}, is {shown(given) if known else _type(given)}")


def _type(value: object) -> str:
    return f"a {type(value).__name__}"
