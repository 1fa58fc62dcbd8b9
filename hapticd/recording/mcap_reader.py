"""Recordings in .mcap, read from the first record to the last; their index is not needed for that.

The library reads what stands in a record; the records themselves are walked here, so that none is read, or unpacked,
that nobody needs or that would take more memory than there may be.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator
from typing import IO, TYPE_CHECKING, Any, Final

import numpy as np

from hapticd.base.core import SAMPLE_DTYPE
from hapticd.recording.mcap_format import (
    CHANGE,
    EVENT,
    MAGIC,
    SAMPLES,
    TOPICS,
    message_dtype,
    needed,
    sample_schema,
    unpacked,
)
from hapticd.recording.reading_limits import TEXTS, BadRecordingError, Memory, Recorded, Rows

if TYPE_CHECKING:
    from mcap.records import Channel, Chunk

_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _ATTACHMENT, _METADATA, _DATA_END = 3, 4, 5, 6, 9, 12, 15
_READ: Final = frozenset((_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _ATTACHMENT, _METADATA))
_LARGEST: Final = 1 << 26
"""Bytes of a record and of what a chunk holds; ours have up to a second of samples."""
_MOST_CHANNELS: Final = 10_000
_HEAD: Final = struct.Struct("<BQ")
_MESSAGE_HEAD: Final = struct.Struct("<BQH")
_LEAST: Final = 8 + 29 + 8
"""Bytes of magic, footer and magic."""


def load_mcap(file: IO[bytes], size: int, memory: Memory) -> Recorded:
    """Raises HapticdError, and what reading records raises."""
    try:
        import mcap.records  # noqa: F401
        import zstandard  # noqa: F401
    except ImportError:
        raise needed() from None
    if size < _LEAST or file.read(len(MAGIC)) != MAGIC:
        raise BadRecordingError("it is no MCAP file")
    file.seek(size - len(MAGIC))
    if file.read(len(MAGIC)) != MAGIC:
        raise BadRecordingError("it was not finished; `mcap recover` makes a whole one of it")
    file.seek(len(MAGIC))
    return _Reader(memory).read(file, size)


class _Reader:
    """What was found so far."""

    def __init__(self, memory: Memory) -> None:
        self._memory = memory
        self._texts: dict[str, Any] = {}
        self._events: list[dict[str, Any]] = []
        self._changes: list[Any] = []
        self._rows = Rows(memory)
        self._schemas: dict[int, bytes] = {}
        self._kinds: dict[int, int] = {}
        """Of each channel that is ours, what it holds."""
        self._topics = {TOPICS[kind]: kind for kind in (SAMPLES, EVENT, CHANGE)}
        self._message = message_dtype(SAMPLE_DTYPE.itemsize)

    def read(self, file: IO[bytes], size: int) -> Recorded:
        for opcode, body in _records(file, size, self._memory):
            if opcode == _CHUNK:
                self._take_records(_chunk_data(unpacked("Chunk", body), self._memory))
            elif opcode == _ATTACHMENT:
                self._take_attachment(body)
            elif opcode == _METADATA:
                self._take_metadata(body)
            elif opcode == _MESSAGE:
                self._take_records(_HEAD.pack(opcode, len(body)) + body)
            else:
                self._declare(opcode, body)
        self._texts["changes"] = self._changes
        return Recorded(self._rows.whole(), self._texts, self._events)

    def _take_attachment(self, body: bytes) -> None:
        attachment = unpacked("Attachment", body)
        name = attachment.name.removesuffix(".json")
        if name in TEXTS:
            (checksum,) = struct.unpack("<I", body[-4:])
            if checksum and zlib.crc32(body[:-4]) != checksum:
                raise BadRecordingError(f"{name}.json: its checksum is wrong")
            self._put(name, self._memory.json(attachment.data, f"{name}.json"))

    def _take_metadata(self, body: bytes) -> None:
        self._memory.check(32 * len(body), "its metadata")
        metadata = unpacked("Metadata", body)
        if metadata.name in TEXTS:
            found = {name: self._memory.json(value, metadata.name) for name, value in metadata.metadata.items()}
            self._put(metadata.name, found)

    def _put(self, name: str, value: object) -> None:
        if name in self._texts:
            raise BadRecordingError(f"{name} is there twice")
        self._texts[name] = value

    def _declare(self, opcode: int, body: bytes) -> None:
        """A schema or a channel."""
        if len(self._schemas) + len(self._kinds) > _MOST_CHANNELS:
            raise BadRecordingError("it has too many channels")
        if opcode == _SCHEMA:
            schema = unpacked("Schema", body)
            self._schemas[schema.id] = zlib.adler32(schema.data).to_bytes(4, "little")
            if schema.data == sample_schema(SAMPLE_DTYPE).encode():
                self._schemas[schema.id] = schema.data
            return
        channel: Channel = unpacked("Channel", body)
        kind = self._topics.get(channel.topic)
        if kind is None:
            return
        if kind == SAMPLES and self._schemas.get(channel.schema_id) != sample_schema(SAMPLE_DTYPE).encode():
            raise BadRecordingError("its samples have other fields than those of this version")
        self._kinds[channel.id] = kind

    def _take_records(self, data: bytes) -> None:
        """Takes the messages of a chunk. A call of the library for each would cost far more."""
        at, rest = 0, 4 + 8 + 8
        while at < len(data):
            opcode, length = _HEAD.unpack_from(data, at)
            end = at + 9 + length
            if end > len(data):
                raise BadRecordingError("a record in a chunk is longer than the chunk")
            if opcode in (_SCHEMA, _CHANNEL):
                self._declare(opcode, data[at + 9 : end])
            elif opcode == _MESSAGE:
                kind = self._kinds.get(_MESSAGE_HEAD.unpack_from(data, at)[2]) if length >= 2 else None
                if kind == SAMPLES:
                    if 9 + length != self._message.itemsize:
                        raise BadRecordingError("a sample has another size than its fields")
                    end = self._take_samples(data, at)
                elif kind is not None:
                    value = self._memory.json(data[at + _MESSAGE_HEAD.size + rest : end], "its events and changes")
                    self._take_value(kind, value)
            at = end

    def _take_value(self, kind: int, value: object) -> None:
        if not isinstance(value, dict):
            raise BadRecordingError("an event or a change is no map")
        (self._events if kind == EVENT else self._changes).append(value)

    def _take_samples(self, data: bytes, at: int) -> int:
        """Takes as many messages of samples as follow each other; where they end."""
        size = self._message.itemsize
        most, found, look = (len(data) - at) // size, 0, 16
        first = data[at : at + _MESSAGE_HEAD.size]
        while found < most:
            messages = np.frombuffer(data, self._message, min(look, most - found), at + found * size)
            heads = messages.view([("head", f"V{_MESSAGE_HEAD.size}"), ("rest", f"V{size - _MESSAGE_HEAD.size}")])
            other = np.flatnonzero(heads["head"] != np.void(first))
            count = int(other[0]) if len(other) else len(messages)
            # Four bytes say how the record after them is encoded.
            self._rows.append(np.ascontiguousarray(messages["record"][:count]).view(SAMPLE_DTYPE))
            found += count
            if count < len(messages):
                break
            look *= 2
        return at + found * size


def _records(file: IO[bytes], size: int, memory: Memory) -> Iterator[tuple[int, bytes]]:
    """The records that are read, up to the end of the data. Raises BadRecordingError where that does not come."""
    while len(head := file.read(_HEAD.size)) == _HEAD.size:
        opcode, length = _HEAD.unpack(head)
        if opcode == _DATA_END:
            return
        if length > size - file.tell():
            break
        if opcode not in _READ:
            file.seek(length, os.SEEK_CUR)
            continue
        if length > _LARGEST:
            raise BadRecordingError(f"a record says that it has {length} bytes")
        memory.check(2 * length, "one of its records")
        yield opcode, file.read(length)
    raise BadRecordingError("it was not finished; `mcap recover` makes a whole one of it")


def _chunk_data(chunk: Chunk, memory: Memory) -> bytes:
    """What a chunk holds. Raises BadRecordingError."""
    size = chunk.uncompressed_size
    if size > _LARGEST:
        raise BadRecordingError(f"a chunk says that it holds {size} bytes")
    memory.check(2 * size, "one of its chunks")
    try:
        data = _UNPACK[chunk.compression](chunk.data, size)
    except KeyError:
        raise BadRecordingError("a chunk is compressed in another way than by zstd or lz4") from None
    except (ValueError, RuntimeError, MemoryError, EOFError, ImportError):
        raise BadRecordingError("a chunk cannot be unpacked") from None
    if len(data) != size:
        raise BadRecordingError("a chunk holds another number of bytes than it says")
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise BadRecordingError("the checksum of a chunk is wrong")
    return data


def _zstd(data: bytes, size: int) -> bytes:
    from zstandard import ZstdDecompressor, ZstdError, frame_content_size

    try:
        # The frame says once more how much it holds, which is what its library makes room for.
        if frame_content_size(data) > size:
            raise BadRecordingError("a chunk holds more than it says")
        return ZstdDecompressor().decompress(data, size) if data else b""
    except ZstdError:
        raise BadRecordingError("a chunk cannot be unpacked") from None


def _lz4(data: bytes, size: int) -> bytes:
    from lz4.frame import LZ4FrameDecompressor

    return bytes(LZ4FrameDecompressor().decompress(data, size + 1))


def _as_it_is(data: bytes, size: int) -> bytes:
    return data


_UNPACK: Final = {"zstd": _zstd, "lz4": _lz4, "": _as_it_is}
