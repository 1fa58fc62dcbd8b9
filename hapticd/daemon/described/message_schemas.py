"""JSON Schema, draft 7, of what the daemon sends: results, and the maps of telemetry.

Members that this version does not have may come with a later one, so objects are open.
"""

from __future__ import annotations

from types import NoneType, UnionType
from typing import Any, Final, Literal, NotRequired, Union, get_args, get_origin, get_type_hints, is_typeddict

import numpy as np

from hapticd.base.core import EVENT_DTYPE, SAMPLE_DTYPE, EventKind, records
from hapticd.base.yaml_source import Json
from hapticd.protocol.events import event_map
from hapticd.recording.event_columns import EVENT_MEMBERS, MAY_BE_NONE

_PLAIN: Final[dict[object, str]] = {bool: "boolean", int: "integer", float: "number", str: "string", NoneType: "null"}


class _AnyJson:
    """Stands for `Json` in the annotations of results: anything."""


def schema_of(kind: Any) -> dict[str, Json]:
    """JSON Schema of a type of protocol/results, with its docstring as description."""
    if kind is _AnyJson:
        return {}
    if kind in _PLAIN:
        return {"type": _PLAIN[kind]}
    if is_typeddict(kind):
        return _mapping(kind)
    arguments, origin = get_args(kind), get_origin(kind)
    if origin is NotRequired:
        return schema_of(arguments[0])
    if origin is Literal:
        return {"enum": list(arguments)}
    if origin is list:
        return {"type": "array", "items": schema_of(arguments[0])}
    if origin is dict:
        return {"type": "object", "additionalProperties": schema_of(arguments[1])}
    if origin in (Union, UnionType):
        return {"anyOf": [schema_of(each) for each in arguments]}
    raise TypeError(f"no JSON Schema of {kind}: protocol/results has TypedDicts of plain types")


def _mapping(kind: Any) -> dict[str, Json]:
    members = get_type_hints(kind, localns={"Json": _AnyJson}, include_extras=True)
    return {
        "title": kind.__name__,
        "description": " ".join((kind.__doc__ or "").split()),
        "type": "object",
        "required": [name for name, each in members.items() if get_origin(each) is not NotRequired],
        "properties": {name: schema_of(each) for name, each in members.items()},
    }


def event_schema() -> dict[str, Json]:
    """One event: by its kind, with the members that `event_map` gives it."""
    record = records(EVENT_DTYPE, 1)[0]
    kinds: list[Json] = []
    for kind in EventKind:
        record["kind"] = kind
        members = event_map(record, "")
        properties: dict[str, Json] = {name: _event_member(name) for name in members}
        properties["event"] = {"const": members["event"]}  # type: ignore[dict-item]
        kinds.append({"type": "object", "required": list(members), "properties": properties})
    return {"title": "Event", "oneOf": kinds}


def _event_member(name: str) -> Json:
    described: Any = EVENT_MEMBERS[name]
    return {"anyOf": [described, {"type": "null"}]} if described and name in MAY_BE_NONE else described


def samples_schema() -> dict[str, Json]:
    """One batch of samples. JSON has no bytes: `data` is msgpack's bin."""
    return {
        "title": "Samples",
        "type": "object",
        "required": ["first_tick", "dropped", "dtype", "data"],
        "properties": {
            "first_tick": {"type": "integer", "description": "tick of the first sample"},
            "dropped": {
                "type": "integer",
                "description": "samples that found the daemon's ring full, total since the start",
            },
            "dtype": {
                "type": "array",
                "items": {"type": "array", "minItems": 2, "maxItems": 3},
                "description": "numpy's descr of one record: `[name, format]`, or `[name, format, [length]]`",
                "const": _plain(np.lib.format.dtype_to_descr(SAMPLE_DTYPE)),
            },
            "data": {
                "type": "string",
                "format": "binary",
                "description": "the records, little-endian and packed as `dtype` says, "
                f"{SAMPLE_DTYPE.itemsize} bytes each in this version",
            },
        },
    }


def _plain(value: Any) -> Json:
    return [_plain(each) for each in value] if isinstance(value, list | tuple) else value
