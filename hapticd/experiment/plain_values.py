"""Values of YAML that a model takes as they are: a finite scalar, a mapping of plain data."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, TypeAlias

from pydantic import PlainValidator

from hapticd.base.errors import shown
from hapticd.base.model import plain
from hapticd.base.yaml_source import Json

Scalar: TypeAlias = bool | int | float | str


def scalar_of(value: object) -> Scalar:
    """The value itself. Raises ValueError for anything but a finite scalar."""
    if not isinstance(value, bool | int | float | str):
        raise ValueError(f"must be a number, a string, true or false, is {shown(value)}")
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"must be finite, is {shown(value)}")
    return value


def mapping_of(value: object) -> dict[str, Json]:
    """A mapping as plain data. Raises ValueError for anything else, InvalidError for what in it is no plain data."""
    if not isinstance(value, dict):
        raise ValueError(f"must be a mapping, is {shown(value)}")
    found = plain(value)
    assert isinstance(found, dict)
    return found


PlainScalar: TypeAlias = Annotated[Scalar, PlainValidator(scalar_of)]
if TYPE_CHECKING:
    PlainMapping: TypeAlias = dict[str, Json]
else:  # pydantic cannot make a schema of Json, which holds itself; mapping_of is all of the validation
    PlainMapping = Annotated[dict, PlainValidator(mapping_of)]
