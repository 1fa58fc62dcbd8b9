"""Text and data of pending marks, by number. The servo returns only the number, in an event.

The command thread adds marks; the thread that reads events takes them.
"""

from __future__ import annotations

import json
from typing import Annotated, Final, NamedTuple

from pydantic import Field

from hapticd.base.core import MAX_PENDING_MARKS
from hapticd.base.errors import InvalidError, Problem
from hapticd.base.model import DescribedAs, Model
from hapticd.base.yaml_source import Json

MAX_MARK_DATA_BYTES: Final = 8192
"""Largest size of the data that a client attaches to a mark, as JSON, in bytes."""


class MarkParams(Model):
    """Params of the method `mark`, which puts a text and data into the event stream."""

    text: Annotated[str, Field(min_length=1, max_length=1000)] = Field(description="text of the mark")
    data: Annotated[object, DescribedAs(None | bool | float | str | list[object] | dict[str, object])] = Field(
        default=None, description=f"stored with the mark; at most {MAX_MARK_DATA_BYTES} bytes as JSON"
    )


class Mark(NamedTuple):
    """Text and data of a mark, a note that a client puts into the event stream."""

    text: str
    data: Json


class MarksFullError(Exception):
    """Too many marks are pending: their events have not been read."""


def checked_data(data: object) -> Json:
    """Return the data of a mark. Raises InvalidError if it cannot be stored as JSON, or is too large."""
    try:
        size = len(json.dumps(data, ensure_ascii=False, allow_nan=False).encode("utf-8", "surrogatepass"))
    except (TypeError, ValueError) as error:
        raise InvalidError([Problem("data", f"must be a JSON value: {error}")]) from None
    if size > MAX_MARK_DATA_BYTES:
        raise InvalidError([Problem("data", f"must have at most {MAX_MARK_DATA_BYTES} bytes as JSON, has {size}")])
    return data  # type: ignore[return-value]


class Marks:
    """Marks that were given to the servo and whose events have not been read."""

    def __init__(self) -> None:
        self._under_way: dict[int, Mark] = {}
        self._last = 0

    def add(self, mark: Mark) -> int:
        """Store a mark and return its number for the servo. Raises MarksFullError."""
        if len(self._under_way) >= MAX_PENDING_MARKS:
            raise MarksFullError
        self._last = self._last % 0xFFFFFFFF + 1
        self._under_way[self._last] = mark
        return self._last

    def take(self, number: int) -> Mark:
        """Remove the mark with this number and return it."""
        return self._under_way.pop(number)
