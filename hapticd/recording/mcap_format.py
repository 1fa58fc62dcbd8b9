"""What a recording in .mcap holds, for its writer and its reader.

    hapticd/samples    one message a tick: CDR by a ros2msg schema. Its bytes are those of the record, after the four
                       that say so
    hapticd/event      JSON: events
    hapticd/status     JSON: the status, once a second
    hapticd/change     JSON: what commands changed

`log_time` and `publish_time` are the tick's `time_ns`, CLOCK_MONOTONIC of the daemon's machine. Texts known at the
start are attachments (`scene.json`, ...), those known at the end metadata.

Format: https://mcap.dev/spec (records, indices, checksums); data is CDR as ROS 2 has it, little-endian.
"""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from hapticd.base.errors import HapticdError
from hapticd.recording.event_columns import MEMBERS, Kind
from hapticd.recording.reading_limits import BadRecordingError

if TYPE_CHECKING:
    from mcap.records import McapRecord

MAGIC: Final = b"\x89MCAP0\r\n"
SAMPLES, EVENT, STATUS, CHANGE = range(1, 5)
"""Channels, and the schemas of their messages."""

TOPICS: Final = {
    SAMPLES: "hapticd/samples",
    EVENT: "hapticd/event",
    STATUS: "hapticd/status",
    CHANGE: "hapticd/change",
}
SAMPLE_TYPE: Final = "hapticd_msgs/msg/Sample"

_ROS_TYPES: Final = {"u8": "uint64", "i8": "int64", "f8": "float64", "u4": "uint32", "i4": "int32", "f4": "float32"}
_TEXT: Final[dict[str, object]] = {"type": "string"}
_NUMBER: Final[dict[str, object]] = {"type": "number"}
_INTEGER: Final[dict[str, object]] = {"type": "integer"}
_TRUTH: Final[dict[str, object]] = {"type": "boolean"}
_TYPES: Final[dict[Kind, dict[str, object]]] = {
    Kind.TEXT: _TEXT,
    Kind.INTEGER: _INTEGER,
    Kind.NUMBER: _NUMBER,
    Kind.TRUTH: _TRUTH,
    Kind.JSON: {},
}
EVENT_MEMBERS: Final[dict[str, object]] = {
    **{name: _TYPES[kind] for name, kind in MEMBERS.items()},
    "faults": {"type": "array", "items": _TEXT},
}
JSON_SCHEMAS: Final[dict[int, tuple[str, dict[str, object]]]] = {
    EVENT: ("hapticd.Event", EVENT_MEMBERS),
    STATUS: ("hapticd.Status", {"tick": _INTEGER, "rate_hz": _NUMBER, "revision": _INTEGER, "forces": _TEXT}),
    CHANGE: ("hapticd.Change", {"revision": _INTEGER}),
}


def needed() -> HapticdError:
    """What to say where the packages of the extra are missing."""
    return HapticdError(".mcap needs the packages of the extra `mcap`: pip install 'hapticd[mcap]'")


def sample_schema(dtype: np.dtype[Any]) -> str:
    """The ros2msg definition of a record."""
    lines = []
    for name in dtype.names or ():
        base, shape = dtype[name].base, dtype[name].shape
        length = f"[{shape[0]}]" if shape else ""
        lines.append(f"{_ROS_TYPES[base.str[1:]]}{length} {name}\n")
    return "".join(lines)


def message_dtype(record_size: int) -> np.dtype[np.void]:
    """Messages of samples, as they lie in a chunk."""
    return np.dtype(
        [
            ("opcode", "u1"),
            ("length", "<u8"),
            ("channel", "<u2"),
            ("sequence", "<u4"),
            ("log_time", "<u8"),
            ("publish_time", "<u8"),
            ("encapsulation", "S4"),
            ("record", f"V{record_size}"),
        ]
    )


def packed(*records: McapRecord) -> bytes:
    """Records of the mcap package, as they stand in a file."""
    from mcap.data_stream import RecordBuilder

    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data


def unpacked(kind: str, body: bytes) -> Any:
    """A record of the mcap package, of what stands after its length. Raises ValueError."""
    import mcap.records
    from mcap.data_stream import ReadDataStream
    from mcap.exceptions import McapError

    try:
        return getattr(mcap.records, kind).read(ReadDataStream(io.BytesIO(body)))
    except McapError:
        raise BadRecordingError("a record of it is damaged") from None
