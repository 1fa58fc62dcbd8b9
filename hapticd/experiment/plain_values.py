"""Pydantic types of values in YAML: a finite scalar, a mapping of plain data, a path of keys."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, TypeAlias

from pydantic import PlainValidator, StringConstraints

from hapticd.base.errors import shown
from hapticd.base.model import plain
from hapticd.base.yaml_source import Json

Scalar: TypeAlias = bool | int | float | str


def scalar_of(value: object) -> Scalar:
    """Return `value` if it is a boolean, a finite number or a string. Raises ValueError otherwise."""
    if not isinstance(value, bool | int | float | str):
        raise ValueError(f"must be a number, a string, true or false, is {shown(value)}")
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"must be finite, is {shown(value)}")
    return value


def mapping_of(value: object) -> dict[str, Json]:
    """Return `value`, a mapping, as plain data (JSON).

    Raises ValueError if `value` is not a mapping, InvalidError if its content is not plain data.
    """
    if not isinstance(value, dict):
        raise ValueError(f"must be a mapping, is {shown(value)}")
    found = plain(value)
    assert isinstance(found, dict)
    return found


def as_list(value: object) -> object:
    """Return a list with `value` if `value` is a string, otherwise `value`: one item may stand for its list."""
    return [value] if isinstance(value, str) else value


KeyPath: TypeAlias = Annotated[str, StringConstraints(min_length=1, max_length=512)]
"""A path of keys, such as materials.wood.tap.frequency_hz."""
PlainScalar: TypeAlias = Annotated[Scalar, PlainValidator(scalar_of)]
if TYPE_CHECKING:
    PlainMapping: TypeAlias = dict[str, Json]
else:  # pydantic cannot make a schema of Json, which is recursive; mapping_of does the validation
    PlainMapping = Annotated[dict, PlainValidator(mapping_of)]
