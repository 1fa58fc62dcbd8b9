"""Conversion of events to columns of a recording, and back.

A member that an event lacks has a reserved value in its column. Events read from a recording have the same members and
types as in telemetry.
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
"""Value of a missing time: numpy's NaT (not a time)."""

ROW_BLOCK_BYTES: Final = 1 << 20
"""Rows are converted in blocks of about 1 MiB, as one long text enlarges every row."""


class Kind(Enum):
    """JSON type of an event's member; it determines the numpy type of the column."""

    TEXT = "string"
    INTEGER = "integer"
    NUMBER = "number"
    TRUTH = "boolean"
    JSON = "anything"


EVENT_MEMBER_KINDS: Final[dict[str, Kind]] = {
    **dict.fromkeys(("event", "object", "problem", "text"), Kind.TEXT),
    **dict.fromkeys(("tick", "time_ns", "onset_time_ns", "count", "grooves", "missed", "revision"), Kind.INTEGER),
    "started_tick": Kind.INTEGER,
    **dict.fromkeys(("before_tick_s", "speed_m_per_s", "true_speed_m_per_s", "amplitude_m_per_s2"), Kind.NUMBER),
    **dict.fromkeys(("scale", "depth_m", "wanted_n", "missed_share", "rate_hz", "suspended_s"), Kind.NUMBER),
    **dict.fromkeys(("appeared", "completed"), Kind.TRUTH),
    **dict.fromkeys(("faults", "data"), Kind.JSON),
}
"""Types of the members of events, which docs/reference/events.md describes."""

COMMON_EVENT_MEMBERS: Final = ("event", "tick", "time_ns")

EVENT_MEMBER_SCHEMAS: Final[dict[str, object]] = {
    **{name: {"type": kind.value} for name, kind in EVENT_MEMBER_KINDS.items()},
    "faults": {"type": "array", "items": {"type": "string"}},
    "data": {},
}
"""JSON Schema of each member of events, for exports."""

NULLABLE_MEMBERS: Final = frozenset(("object", "true_speed_m_per_s", "data"))
"""Members of events whose value may be None."""


class Column(NamedTuple):
    """A column of the array of events in a recording: the values of one member."""

    name: str
    kind: Kind
    form: str
    """numpy type, such as <f8."""
    absent: object
    """Value in the row of an event without the member, or with None."""

    def cell(self, event: Mapping[str, Any]) -> object:
        """Return the value of this column for an event; `absent` if the event lacks the member or has None."""
        value = event.get(self.name)
        if value is None:
            return self.absent
        return _text(self.kind, value) if self.form[1] == "U" else value


def _text(kind: Kind, value: object) -> str:
    return value if kind is Kind.TEXT and isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def columns_of(events: Iterable[Mapping[str, Any]]) -> tuple[int, list[Column]]:
    """Return the number of events, and a column for each member that occurs in them.

    Without events, the columns are those of COMMON_EVENT_MEMBERS. Types, and values of missing members:

    - booleans: i1; missing: -1
    - integers: i8; missing: 0, or NO_TIME if the name ends in `_ns`
    - numbers, and unknown members that are always None: f8; missing: NaN
    - texts, and other values as JSON texts: U; missing: ""
    """
    found: dict[str, set[type]] = {}
    widths: dict[str, int] = {}
    total = 0
    for event in events:
        total += 1
        for name, value in event.items():
            found.setdefault(name, set()).add(type(value))
            kind = EVENT_MEMBER_KINDS.get(name)
            if value is not None and (kind in (Kind.TEXT, Kind.JSON) or not isinstance(value, int | float)):
                widths[name] = max(widths.get(name, 1), len(_text(kind or Kind.TEXT, value)))
    columns = []
    for name, types in (found or {name: set() for name in COMMON_EVENT_MEMBERS}).items():
        kind = EVENT_MEMBER_KINDS.get(name) or _guessed(types - {type(None)})
        forms: dict[Kind, tuple[str, object]] = {
            Kind.TRUTH: ("|i1", -1),
            Kind.INTEGER: ("<i8", NO_TIME if name.endswith("_ns") else 0),
            Kind.NUMBER: ("<f8", math.nan),
        }
        columns.append(Column(name, kind, *forms.get(kind, (f"<U{widths.get(name, 1)}", ""))))
    return total, columns


def _guessed(types: set[type]) -> Kind:
    """Return the kind of a member that is not in EVENT_MEMBER_KINDS, from the types of its values."""
    if types == {bool}:
        return Kind.TRUTH
    if types == {int}:
        return Kind.INTEGER
    return Kind.NUMBER if types <= {int, float} else Kind.TEXT


def dtype_of(columns: Iterable[Column]) -> np.dtype[np.void]:
    """Return the numpy dtype of the array of events with these columns."""
    return np.dtype([(column.name, column.form) for column in columns])


def rows_of(events: Iterable[Mapping[str, Any]], columns: list[Column]) -> Iterator[npt.NDArray[np.void]]:
    """Yield blocks of rows of the array of events, each of about ROW_BLOCK_BYTES."""
    dtype = dtype_of(columns)
    block_rows = max(1, ROW_BLOCK_BYTES // max(1, dtype.itemsize))
    rows: list[tuple[object, ...]] = []
    for event in events:
        rows.append(tuple(column.cell(event) for column in columns))
        if len(rows) == block_rows:
            yield np.array(rows, dtype)
            rows = []
    if rows:
        yield np.array(rows, dtype)


# ---- Reading -------------------------------------------------------------------------------------------------------


@lru_cache
def members_of(event: str) -> frozenset[str] | None:
    """Return the names of the members of an event, given its kind such as "contact"; None for an unknown kind."""
    from hapticd.base.core import EVENT_DTYPE, EventKind, records
    from hapticd.protocol.events import event_map

    kind = EventKind.__members__.get(event.upper())
    if kind is None:
        return None
    record = records(EVENT_DTYPE, 1)[0]
    record["kind"] = kind
    return frozenset(event_map(record, None))


def events_of_rows(rows: npt.NDArray[np.void]) -> Iterator[dict[str, Any]]:
    """Yield the events in rows of the array of events of a recording.

    An event of an unknown kind has the members whose cells differ from the reserved value for a missing member.
    """
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
    """Return the values of a column. Raises UnicodeDecodeError for invalid text, which numpy would accept."""
    if column.dtype.kind != "U":
        return list(column.tolist())
    order = "utf-32-be" if column.dtype.str[0] == ">" else "utf-32-le"
    data, width = column.tobytes(), column.dtype.itemsize
    return [data[at : at + width].decode(order).rstrip("\0") for at in range(0, len(data), width or 1)]


def _is_absent(name: str, form: str, value: Any) -> bool:
    """Return whether a cell has the reserved value of a missing member; 0 may also be a value of the member."""
    match form[0]:
        case "U":
            return bool(value == "")
        case "f":
            return math.isnan(value)
        case _:
            return value == -1 if form == "i1" else value in (0, NO_TIME) and name not in ("tick", "time_ns")


def _restored(name: str, form: str, value: Any, absent: bool) -> object:
    if absent and name in NULLABLE_MEMBERS:
        return None
    if form == "i1":
        return bool(value)
    return json.loads(value) if EVENT_MEMBER_KINDS.get(name) is Kind.JSON else cast(object, value)


def cell_of(name: str, value: object) -> object:
    """Return the cell of a .csv for a member's value; lists, maps, truth values and None become JSON."""
    if EVENT_MEMBER_KINDS.get(name) is Kind.JSON or isinstance(value, list | dict | bool) or value is None:
        return json.dumps(value)
    return value
