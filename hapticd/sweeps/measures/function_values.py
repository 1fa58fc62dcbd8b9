"""What a user's function returned, checked against the columns that the study declares."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from hapticd.base.errors import HapticdError, shown
from hapticd.sweeps.columns import Kind, Value

_KIND_TEXTS: Final[Mapping[Kind, str]] = {
    "number": "a finite number",
    "integer": "a whole number of 64 bits",
    "boolean": "true or false",
    "text": "a text",
}


def values_of(returned: object, kinds: Mapping[str, Kind]) -> dict[str, Value]:
    """The values by column, none of them numpy's. A single column's value may come without its name; None: it has none.

    Raises HapticdError for columns that are missing or not declared, and for what is not of a column's kind.
    """
    if not isinstance(returned, Mapping):
        if len(kinds) != 1:
            raise HapticdError(f"returned {_type(returned)}: must be a mapping of the columns {', '.join(kinds)}")
        returned = dict.fromkeys(kinds, returned)
    missing = [name for name in kinds if name not in returned]
    if missing:
        raise HapticdError(f"returned no column {missing[0]}: None where there is no value")
    strange = [name for name in returned if name not in kinds]
    if strange:
        raise HapticdError(f"returned a column {shown(strange[0])} that the study does not declare")
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
