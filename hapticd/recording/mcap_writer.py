"""Recordings as MCAP files, for the tools of robotics.

    hapticd/samples    one message a tick: CDR by a ros2msg schema. Its bytes are those of the record, after the four
                       that say so
    hapticd/event      JSON: events
    hapticd/status     JSON: the status, once a second
    hapticd/change     JSON: what commands changed

`log_time` and `publish_time` are the tick's `time_ns`, CLOCK_MONOTONIC of the daemon's machine. Texts known at the
start are attachments (`scene.json`, ...), those known at the end metadata. Samples are put into messages a whole batch
at a time, because a call for each, 10,000 times a second, costs more than all the rest.

Format: https://mcap.dev/spec (records, indices, checksums); data is CDR as ROS 2 has it, little-endian.
"""

from __future__ import annotations

import json
import os
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import IO, TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from hapticd._version import __version__
from hapticd.base.errors import HapticdError
from hapticd.recording.event_columns import MEMBERS, Kind
from hapticd.recording.writer import Samples, Sink, last_of

if TYPE_CHECKING:
    from zstandard import ZstdCompressor

MAGIC: Final = b"\x89MCAP0\r\n"
CHUNK_BYTES: Final = 1 << 20
"""A chunk is written when it holds this much, or a second of samples."""

_BATCH: Final = 5000
"""Samples that are put into messages at once; a chunk holds whole batches."""
_LONGEST: Final = 1 << 26
"""Bytes of a record of ours at most; a second of samples has 15 MB at 100 kHz."""
_CHUNK_NS: Final = 1_000_000_000
_CDR_LITTLE_ENDIAN: Final = b"\x00\x01\x00\x00"
_HEADER, _FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _MESSAGE_INDEX, _CHUNK_INDEX = range(1, 9)
_ATTACHMENT, _ATTACHMENT_INDEX, _STATISTICS, _METADATA, _METADATA_INDEX, _SUMMARY_OFFSET, _DATA_END = range(9, 16)

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
_JSON_SCHEMAS: Final[dict[int, tuple[str, dict[str, object]]]] = {
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


# ---- Records -----------------------------------------------------------------------------------------------------


def _record(opcode: int, *content: bytes) -> bytes:
    body = b"".join(content)
    return struct.pack("<BQ", opcode, len(body)) + body


def _text(value: str) -> bytes:
    data = value.encode()
    return struct.pack("<I", len(data)) + data


def _texts(values: Mapping[str, str]) -> bytes:
    data = b"".join(_text(name) + _text(value) for name, value in values.items())
    return struct.pack("<I", len(data)) + data


def _numbers(values: Mapping[int, int]) -> bytes:
    """A map from channels to numbers."""
    data = b"".join(struct.pack("<HQ", channel, value) for channel, value in values.items())
    return struct.pack("<I", len(data)) + data


def _message_dtype(record_size: int) -> np.dtype[np.void]:
    """Messages of one size, as they lie in a chunk."""
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


class _Entry(NamedTuple):
    """A chunk of the file, as the summary tells of it."""

    first_ns: int
    last_ns: int
    offset: int
    size: int
    indices: dict[int, int]
    indices_size: int
    compressed: int
    uncompressed: int
    messages: dict[int, int]
    last_tick: int
    last_time_ns: int


@dataclass
class _Chunk:
    """Messages that were not written yet."""

    data: list[bytes] = field(default_factory=list)
    size: int = 0
    index: dict[int, list[npt.NDArray[np.uint64]]] = field(default_factory=dict)
    """Of each channel: log times and offsets, (n, 2)."""
    since_ns: int | None = None
    """The time of its first sample."""
    last_tick: int = -1
    last_time_ns: int = 0

    def add(self, channel: int, times: npt.NDArray[np.uint64], data: bytes) -> None:
        """Messages of one size."""
        places = np.empty((len(times), 2), "<u8")
        places[:, 0] = times
        places[:, 1] = self.size + np.arange(len(times), dtype=np.uint64) * np.uint64(len(data) // len(times))
        self.index.setdefault(channel, []).append(places)
        self.data.append(data)
        self.size += len(data)

    @property
    def span_ns(self) -> tuple[int, int]:
        times = [places[:, 0] for parts in self.index.values() for places in parts]
        return int(min(part.min() for part in times)), int(max(part.max() for part in times))


class McapSink(Sink):
    """The .mcap form; arrays have no place in it."""

    def __init__(self, target: str | os.PathLike[str], *, overwrite: bool = False, left: str | None = None) -> None:
        try:
            from zstandard import ZstdCompressor
        except ImportError:
            raise needed() from None
        self._compressor: ZstdCompressor = ZstdCompressor(level=1)
        self._chunk = _Chunk()
        self._chunks: list[_Entry] = []
        self._attachments: list[bytes] = []
        self._messages: np.dtype[np.void] | None = None
        self._schemas = b""
        self._early: list[tuple[int, Mapping[str, object]]] = []
        """What came before the first sample, and has its time."""
        super().__init__(target, overwrite=overwrite, left=left)
        if left is None:
            try:
                self._part.append(MAGIC + _record(_HEADER, _text(""), _text(f"hapticd {__version__}")))
            except OSError as error:
                self._fail(error)  # nothing was recorded that could be kept

    def begin(self, texts: Mapping[str, object], about: Mapping[str, object] | None = None) -> None:
        super().begin(texts, about)
        for name, value in texts.items():
            data = json.dumps(value).encode()
            content = struct.pack("<QQ", 0, 0) + _text(f"{name}.json") + _text("application/json")
            content += struct.pack("<Q", len(data)) + data
            record = _record(_ATTACHMENT, content, struct.pack("<I", zlib.crc32(content)))
            self._attachments.append(_attachment_index(self._part.size, record[9:]))
            with self._telling():
                self._part.append(record)

    # ---- Messages --------------------------------------------------------------------------------------------------

    def _write(self, samples: Samples) -> None:
        if self._messages is None:
            self._declare(samples.dtype)
        for first in range(0, len(samples), _BATCH):
            self._write_batch(samples[first : first + _BATCH])

    def _write_batch(self, samples: Samples) -> None:
        assert self._messages is not None
        times = samples["time_ns"].astype(np.uint64)
        messages = np.empty(len(samples), self._messages)
        messages["opcode"] = _MESSAGE
        messages["length"] = self._messages.itemsize - 9
        messages["channel"] = SAMPLES
        messages["sequence"] = samples["tick"] & np.uint64(0xFFFFFFFF)
        messages["log_time"] = messages["publish_time"] = times
        messages["encapsulation"] = _CDR_LITTLE_ENDIAN
        messages["record"] = np.ascontiguousarray(samples).view(messages.dtype["record"])
        chunk = self._chunk
        if chunk.since_ns is None:
            chunk.since_ns = int(times[0])
        early, self._early = self._early, []
        for channel, value in early:
            self._add_json(channel, int(times[0]), value)
        chunk.add(SAMPLES, times, messages.tobytes())
        chunk.last_tick, chunk.last_time_ns = last_of(samples)
        if chunk.size >= CHUNK_BYTES or chunk.last_time_ns - chunk.since_ns >= _CHUNK_NS:
            self._write_chunk()

    def write_event(self, event: Mapping[str, object]) -> None:
        self._add_json(EVENT, int(event["time_ns"]), event)  # type: ignore[call-overload]
        self.event_count += 1

    def write_change(self, change: Mapping[str, object]) -> None:
        self._add_latest(CHANGE, change)

    def write_status(self, status: Mapping[str, object]) -> None:
        self._add_latest(STATUS, status)

    def _add_latest(self, channel: int, value: Mapping[str, object]) -> None:
        """A message that has the time of the newest sample."""
        if self.count == 0:
            self._early.append((channel, value))
        else:
            self._add_json(channel, self.last_time_ns, value)

    def _add_json(self, channel: int, time_ns: int, value: Mapping[str, object]) -> None:
        head = struct.pack("<HIQQ", channel, 0, time_ns, time_ns)
        message = _record(_MESSAGE, head, json.dumps(value).encode())
        self._chunk.add(channel, np.array([time_ns], np.uint64), message)

    def _declare(self, dtype: np.dtype[np.void]) -> None:
        """Schemas and channels, before the first message."""
        if np.dtype([(name, dtype[name]) for name in dtype.names or ()], align=True) != dtype:
            raise HapticdError("the daemon's samples are not laid out as CDR is: record into .npz")
        self._messages = _message_dtype(dtype.itemsize)
        self._schemas = self._declarations(dtype)
        self._part.append(self._schemas)

    def _declarations(self, dtype: np.dtype[np.void]) -> bytes:
        definition = sample_schema(dtype).encode()
        schemas = [_schema(SAMPLES, SAMPLE_TYPE, "ros2msg", definition)]
        for channel, (name, members) in _JSON_SCHEMAS.items():
            shape = {"$schema": "http://json-schema.org/draft-07/schema#", "type": "object", "properties": members}
            schemas.append(_schema(channel, name, "jsonschema", json.dumps(shape).encode()))
        channels = [
            _record(
                _CHANNEL,
                struct.pack("<HH", channel, channel),
                _text(topic),
                _text("cdr" if channel == SAMPLES else "json"),
                _texts({}),
            )
            for channel, topic in TOPICS.items()
        ]
        self._schemas_size = sum(map(len, schemas))
        return b"".join(schemas + channels)

    def _write_chunk(self) -> None:
        """The messages so far, and where each of them is, as one stretch of the file."""
        chunk = self._chunk
        data = b"".join(chunk.data)
        compressed = self._compressor.compress(data)
        first_ns, last_ns = chunk.span_ns
        head = struct.pack("<QQQI", first_ns, last_ns, len(data), zlib.crc32(data)) + _text("zstd")
        records = [_record(_CHUNK, head, struct.pack("<Q", len(compressed)), compressed)]
        offset, size = self._part.size, len(records[0])
        at, indices = offset + size, {}
        # Samples last: what was cut short has no index of them.
        for channel, parts in sorted(chunk.index.items(), reverse=True):
            places = np.concatenate(parts).tobytes()
            records.append(_record(_MESSAGE_INDEX, struct.pack("<HI", channel, len(places)), places))
            indices[channel] = at
            at += len(records[-1])
        self._part.append(b"".join(records))
        self._chunks.append(
            _Entry(
                first_ns,
                last_ns,
                offset,
                size,
                indices,
                at - offset - size,
                len(compressed),
                len(data),
                {channel: sum(map(len, parts)) for channel, parts in chunk.index.items()},
                chunk.last_tick,
                chunk.last_time_ns,
            )
        )
        self._chunk = _Chunk()

    # ---- The end ---------------------------------------------------------------------------------------------------

    def _finish(self, texts: Mapping[str, object], arrays: Mapping[str, npt.NDArray[Any]]) -> None:
        if self._messages is None:
            self._declare(self._dtype or np.dtype([("tick", "<u8"), ("time_ns", "<i8")]))
        if self._chunk.size:
            self._write_chunk()
        self._recount()
        size = self._part.size
        try:
            metadata = {name: value for name, value in texts.items() if name not in self.texts}
            self._part.append(self._ending(metadata))
            self._put({self.target: self._part})
        except OSError:
            self._part.cut(size)
            raise

    def _ending(self, metadata: Mapping[str, object]) -> bytes:
        at = self._part.size
        data, metadata_indices = [], []
        for name, value in metadata.items():
            members = value if isinstance(value, dict) else {name: value}
            record = _record(
                _METADATA, _text(name), _texts({key: json.dumps(member) for key, member in members.items()})
            )
            metadata_indices.append(_record(_METADATA_INDEX, struct.pack("<QQ", at, len(record)), _text(name)))
            data.append(record)
            at += len(record)
        data.append(_record(_DATA_END, struct.pack("<I", 0)))
        start = at + len(data[-1])
        totals: dict[int, int] = {}
        for chunk in self._chunks:
            for channel, count in chunk.messages.items():
                totals[channel] = totals.get(channel, 0) + count
        statistics = _record(
            _STATISTICS,
            struct.pack(
                "<QHIIIIQQ",
                sum(totals.values()),
                len(TOPICS),
                len(TOPICS),
                len(self._attachments),
                len(metadata),
                len(self._chunks),
                min((chunk.first_ns for chunk in self._chunks), default=0),
                max((chunk.last_ns for chunk in self._chunks), default=0),
            ),
            _numbers(totals),
        )
        groups = {
            _SCHEMA: self._schemas[: self._schemas_size],
            _CHANNEL: self._schemas[self._schemas_size :],
            _STATISTICS: statistics,
            _CHUNK_INDEX: b"".join(map(_chunk_index, self._chunks)),
            _ATTACHMENT_INDEX: b"".join(self._attachments),
            _METADATA_INDEX: b"".join(metadata_indices),
        }
        summary, offsets = b"", b""
        for opcode, group in groups.items():
            if group:
                place = struct.pack("<BQQ", opcode, start + len(summary), len(group))
                offsets += _record(_SUMMARY_OFFSET, place)
                summary += group
        footer = struct.pack("<BQQQ", _FOOTER, 20, start, start + len(summary))
        checksum = zlib.crc32(summary + offsets + footer)
        return b"".join((*data, summary, offsets, footer, struct.pack("<I", checksum), MAGIC))

    def _shorten(self) -> bool:
        if self._chunk.size:
            self._chunk = _Chunk()
        elif self._chunks:
            self._part.cut(self._chunks.pop().offset)
        self._recount()
        if self.count:
            self.last_tick, self.last_time_ns = self._chunks[-1].last_tick, self._chunks[-1].last_time_ns
        return self.count > 0

    def _recount(self) -> None:
        self.count = sum(chunk.messages.get(SAMPLES, 0) for chunk in self._chunks)
        self.event_count = sum(chunk.messages.get(EVENT, 0) for chunk in self._chunks)

    # ---- What a killed process left --------------------------------------------------------------------------------

    def _resume(self) -> int:
        assert self._dtype is not None
        self._messages = _message_dtype(self._dtype.itemsize)
        schemas = self._declarations(self._dtype)
        with open(self._part.descriptor(), "rb") as file:
            end = len(file.read(len(MAGIC)))
            begun: _Entry | None = None
            for opcode, at, body in _records(file):
                size = 9 + len(body)
                if opcode == _CHUNK:
                    first_ns, last_ns, uncompressed = struct.unpack_from("<QQQ", body)
                    begun = _Entry(first_ns, last_ns, at, size, {}, 0, len(body) - 44, uncompressed, {}, -1, last_ns)
                elif opcode == _MESSAGE_INDEX and begun is not None:
                    channel, length = struct.unpack_from("<HI", body)
                    begun.indices[channel], begun.messages[channel] = at, length // 16
                    begun = begun._replace(indices_size=begun.indices_size + size)
                    if channel == SAMPLES:
                        self._chunks.append(begun)
                        begun, end = None, at + size
                else:
                    if opcode == _ATTACHMENT:
                        self._attachments.append(_attachment_index(at, body))
                    self._schemas = schemas if opcode == _CHANNEL else self._schemas
                    end = at + size
        if self._chunks:
            self.last_time_ns = self._chunks[-1].last_ns
        return end


def _records(file: IO[bytes]) -> Iterator[tuple[int, int, bytes]]:
    """The whole records that come: what each is, where it begins, what it holds."""
    while True:
        at = file.tell()
        head = file.read(9)
        if len(head) < 9:
            return
        opcode, length = struct.unpack("<BQ", head)
        if length > _LONGEST:
            return
        body = file.read(length)
        if len(body) < length:
            return
        yield opcode, at, body


def _schema(channel: int, name: str, encoding: str, definition: bytes) -> bytes:
    length = struct.pack("<I", len(definition))
    return _record(_SCHEMA, struct.pack("<H", channel), _text(name), _text(encoding), length, definition)


def _chunk_index(chunk: _Entry) -> bytes:
    return _record(
        _CHUNK_INDEX,
        struct.pack("<QQQQ", chunk.first_ns, chunk.last_ns, chunk.offset, chunk.size),
        _numbers(chunk.indices),
        struct.pack("<Q", chunk.indices_size),
        _text("zstd"),
        struct.pack("<QQ", chunk.compressed, chunk.uncompressed),
    )


def _attachment_index(at: int, body: bytes) -> bytes:
    texts, end = [], 16
    for _ in range(2):
        (length,) = struct.unpack_from("<I", body, end)
        texts.append(body[end : end + 4 + length])
        end += 4 + length
    return _record(_ATTACHMENT_INDEX, struct.pack("<QQ", at, 9 + len(body)), body[:16], body[end : end + 8], *texts)
