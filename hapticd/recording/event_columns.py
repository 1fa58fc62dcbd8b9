"""Events as columns of a recording, and back: what each member is, and what stands for one that an event has not.

An event that comes back has the members and types that it had in telemetry, whatever the form of the file.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping
from enum import Enum
from functools import lru_cache
from typing import Any, Final, NamedTuple, cast

import numpy as np
import numpy.typing as npt

NO_TIME: Final = -(2**63)
"""What a time of an event that has none is; numpy's own NaT."""

ROWS_BYTES: Final = 1 << 20
"""Rows are made in stretches of about so many bytes: one long mark widens them all."""


class Kind(Enum):
    """What a member is in JSON, and with it the form of its column."""

    TEXT = "string"
    INTEGER = "integer"
    NUMBER = "number"
    TRUTH = "boolean"
    JSON = "anything"


MEMBERS: Final[dict[str, Kind]] = {
    **dict.fromkeys(("event", "object", "problem", "text"), Kind.TEXT),
    **dict.fromkeys(("tick", "time_ns", "onset_time_ns", "count", "grooves", "missed", "revision"), Kind.INTEGER),
    "started_tick": Kind.INTEGER,
    **dict.fromkeys(("before_tick_s", "speed_m_per_s", "true_speed_m_per_s", "amplitude_m_per_s2"), Kind.NUMBER),
    **dict.fromkeys(("scale", "depth_m", "wanted_n", "missed_share", "rate_hz", "suspended_s"), Kind.NUMBER),
    **dict.fromkeys(("appeared", "completed"), Kind.TRUTH),
    **dict.fromkeys(("faults", "data"), Kind.JSON),
}
"""Members of events as docs/protocol.md lists them."""

MEMBERS_OF_ALL: Final = ("event", "tick", "time_ns")
"""Members that every event has."""

EVENT_MEMBERS: Final[dict[str, object]] = {
    **{name: {"type": kind.value} for name, kind in MEMBERS.items()},
    "faults": {"type": "array", "items": {"type": "string"}},
    "data": {},
}
"""JSON Schema of each member."""

MAY_BE_NONE: Final = frozenset(("object", "true_speed_m_per_s", "data"))


class Column(NamedTuple):
    """A column of the array of events."""

    name: str
    kind: Kind
    form: str
    """numpy's."""
    absent: object
    """What stands in the row of an event that has no such member, or None."""

    def cell(self, event: Mapping[str, Any]) -> object:
        value = event.get(self.name)
        if value is None:
            return self.absent
        return _text(self.kind, value) if self.form[1] == "U" else value


def _text(kind: Kind, value: object) -> str:
    return value if kind is Kind.TEXT and isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def columns_of(events: Iterable[Mapping[str, Any]]) -> tuple[int, list[Column]]:
    """How many events there are, and the columns that hold them: one for each member that occurs. Without events there
    are the columns of `MEMBERS_OF_ALL`, so that a file in which nothing happened is read like any other.

    - truth values: i1, 0 or 1; -1
    - whole numbers: i8; 0, or NO_TIME where the name ends in `_ns`
    - numbers, and of a member that nobody knows nothing but None: f8; NaN
    - texts, and as JSON whatever else there is: text; ""
    """
    found: dict[str, set[type]] = {}
    widths: dict[str, int] = {}
    total = 0
    for event in events:
        total += 1
        for name, value in event.items():
            found.setdefault(name, set()).add(type(value))
            kind = MEMBERS.get(name)
            if value is not None and (kind in (Kind.TEXT, Kind.JSON) or not isinstance(value, int | float)):
                widths[name] = max(widths.get(name, 1), len(_text(kind or Kind.TEXT, value)))
    columns = []
    for name, types in (found or {name: set() for name in MEMBERS_OF_ALL}).items():
        kind = MEMBERS.get(name) or _guessed(types - {type(None)})
        forms: dict[Kind, tuple[str, object]] = {
            Kind.TRUTH: ("|i1", -1),
            Kind.INTEGER: ("<i8", NO_TIME if name.endswith("_ns") else 0),
            Kind.NUMBER: ("<f8", math.nan),
        }
        columns.append(Column(name, kind, *forms.get(kind, (f"<U{widths.get(name, 1)}", ""))))
    return total, columns


def _guessed(types: set[type]) -> Kind:
    """Of a member that this version does not know."""
    if types == {bool}:
        return Kind.TRUTH
    if types == {int}:
        return Kind.INTEGER
    return Kind.NUMBER if types <= {int, float} else Kind.TEXT


def dtype_of(columns: Iterable[Column]) -> np.dtype[np.void]:
    """Of the array of events."""
    return np.dtype([(column.name, column.form) for column in columns])


def rows_of(events: Iterable[Mapping[str, Any]], columns: list[Column]) -> Iterator[npt.NDArray[np.void]]:
    """The rows of the array, in stretches."""
    dtype = dtype_of(columns)
    most = max(1, ROWS_BYTES // max(1, dtype.itemsize))
    rows: list[tuple[object, ...]] = []
    for event in events:
        rows.append(tuple(column.cell(event) for column in columns))
        if len(rows) == most:
            yield np.array(rows, dtype)
            rows = []
    if rows:
        yield np.array(rows, dtype)


# ---- Back ----------------------------------------------------------------------------------------------------------


@lru_cache
def members_of(event: str) -> frozenset[str] | None:
    """The members of an event of this kind; None for one that this version does not know."""
    from hapticd.base.core import EVENT_DTYPE, EventKind, records
    from hapticd.protocol.events import event_map

    kind = EventKind.__members__.get(event.upper())
    if kind is None:
        return None
    record = records(EVENT_DTYPE, 1)[0]
    record["kind"] = kind
    return frozenset(event_map(record, None))


def events_of_rows(rows: npt.NDArray[np.void]) -> Iterator[dict[str, Any]]:
    """The events in rows of a .npz. One of a kind that this version does not know has the members that are not 0."""
    names = rows.dtype.names or ()
    forms = [rows.dtype[name].str[1:] for name in names]
    for row in zip(*(_values(rows[name]) for name in names), strict=True):
        members = members_of(str(row[names.index("event")]))
        event = {}
        for name, form, value in zip(names, forms, row, strict=True):
            absent = _is_absent(name, form, value)
            if name in members if members is not None else not absent:
                event[name] = _restored(name, form, value, absent)
        yield event


def _values(column: npt.NDArray[Any]) -> list[Any]:
    """What is in a column. Raises UnicodeDecodeError; numpy would make texts of whatever numbers stand there."""
    if column.dtype.kind != "U":
        return list(column.tolist())
    order = "utf-32-be" if column.dtype.str[0] == ">" else "utf-32-le"
    data, width = column.tobytes(), column.dtype.itemsize
    return [data[at : at + width].decode(order).rstrip("\0") for at in range(0, len(data), width or 1)]


def _is_absent(name: str, form: str, value: Any) -> bool:
    """Whether a cell holds what stands for nothing; of a whole number it may be 0 all the same."""
    match form[0]:
        case "U":
            return bool(value == "")
        case "f":
            return math.isnan(value)
        case _:
            return value == -1 if form == "i1" else value in (0, NO_TIME) and name not in ("tick", "time_ns")


def _restored(name: str, form: str, value: Any, absent: bool) -> object:
    if absent and name in MAY_BE_NONE:
        return None
    if form == "i1":
        return bool(value)
    return json.loads(value) if MEMBERS.get(name) is Kind.JSON else cast(object, value)


def cell_of(name: str, value: object) -> object:
    """A value as it stands in a .csv."""
    if MEMBERS.get(name) is Kind.JSON or isinstance(value, list | dict | bool) or value is None:
        return json.dumps(value)
    return value
