"""Marks on their way through the servo: their text and data wait here, by number, for the events that bear the numbers.

The thread that serves commands adds, the one that reads events takes.
"""

from __future__ import annotations

import json
from typing import Annotated, Final, NamedTuple

from pydantic import Field

from hapticd.base.core import MARKS
from hapticd.base.errors import InvalidError, Problem
from hapticd.base.model import DescribedAs, Model
from hapticd.base.yaml_source import Json

MAX_MARK_DATA_BYTES: Final = 8192
"""Of a mark's data, as JSON."""


class MarkParams(Model):
    """Params of `mark`."""

    text: Annotated[str, Field(min_length=1, max_length=1000)] = Field(description="what the mark says")
    data: Annotated[object, DescribedAs(None | bool | float | str | list[object] | dict[str, object])] = Field(
        default=None, description=f"stored with the mark; at most {MAX_MARK_DATA_BYTES} bytes as JSON"
    )


class Mark(NamedTuple):
    """What a mark says."""

    text: str
    data: Json


class MarksFullError(Exception):
    """No further mark before the events of earlier ones were read."""


def checked_data(data: object) -> Json:
    """Data of a mark, which a recording can keep as JSON. Raises InvalidError."""
    try:
        size = len(json.dumps(data, ensure_ascii=False, allow_nan=False).encode("utf-8", "surrogatepass"))
    except (TypeError, ValueError) as error:
        raise InvalidError([Problem("data", f"must be what JSON can hold: {error}")]) from None
    if size > MAX_MARK_DATA_BYTES:
        raise InvalidError([Problem("data", f"must have at most {MAX_MARK_DATA_BYTES} bytes as JSON, has {size}")])
    return data  # type: ignore[return-value]


class Marks:
    """Marks under way."""

    def __init__(self) -> None:
        self._under_way: dict[int, Mark] = {}
        self._last = 0

    def add(self, mark: Mark) -> int:
        """The number that the servo gives back. Raises MarksFullError."""
        if len(self._under_way) >= MARKS:
            raise MarksFullError
        self._last = self._last % 0xFFFFFFFF + 1
        self._under_way[self._last] = mark
        return self._last

    def take(self, number: int) -> Mark:
        """The mark of a number, which is not under way any more."""
        return self._under_way.pop(number)
