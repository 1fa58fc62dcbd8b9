"""Recordings in .mcap, written: for the tools of robotics. mcap_format.py says what stands in them.

The mcap package writes each record, but for messages. Its own writer takes one message a call: 3.6 us a sample, ten
times of what a whole batch at a time takes here. It cannot finish a file that another process began, nor fall back
where the disk is full (docs/adr/0046). The summary at the end is made of what stands in the file, so that what a killed
process left is finished in the same way.
"""

from __future__ import annotations

import json
import os
import struct
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import IO, TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt
from mcap import records as mcap
from mcap.opcode import Opcode

from hapticd._version import __version__
from hapticd.base.errors import HapticdError
from hapticd.recording.mcap_format import (
    CHANGE,
    EVENT,
    JSON_SCHEMAS,
    MAGIC,
    SAMPLE_TYPE,
    SAMPLES,
    STATUS,
    TOPICS,
    message_dtype,
    needed,
    packed,
    sample_schema,
    unpacked,
)
from hapticd.recording.writer import Checkpoint, RecordingWriter, Samples, last_of

if TYPE_CHECKING:
    from zstandard import ZstdCompressor

CHUNK_BYTES: Final = 1 << 20
"""A chunk is written when it holds this much, or a second of samples."""

_BATCH: Final = 5000
"""Samples that are put into messages at once; a chunk holds whole batches."""
_LONGEST: Final = 1 << 26
"""Bytes of a record of ours at most; a second of samples has 15 MB at 100 kHz."""
_CHUNK_NS: Final = 1_000_000_000
_CHUNK_HEAD: Final = 44
"""Bytes of a chunk before its data: three numbers, its checksum, `zstd` and the size of the data."""
_CDR_LITTLE_ENDIAN: Final = b"\x00\x01\x00\x00"


@dataclass
class _Pending:
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


@dataclass
class _Contents:
    """What the partial file holds, for the summary."""

    end: int
    """Bytes of whole records."""
    chunks: list[mcap.ChunkIndex] = field(default_factory=list)
    messages: Counter[int] = field(default_factory=Counter)
    """How many, by channel."""
    attachments: list[mcap.AttachmentIndex] = field(default_factory=list)


class McapWriter(RecordingWriter):
    """The .mcap format; arrays have no place in it."""

    def __init__(self, target: str | os.PathLike[str], *, overwrite: bool = False, resume: str | None = None) -> None:
        try:
            from zstandard import ZstdCompressor
        except ImportError:
            raise needed() from None
        self._compressor: ZstdCompressor = ZstdCompressor(level=1)
        self._pending = _Pending()
        self._message_dtype: np.dtype[np.void] | None = None
        self._early: list[tuple[int, Mapping[str, object]]] = []
        """What came before the first sample, and has its time."""
        super().__init__(target, overwrite=overwrite, resume=resume)
        if resume is None:
            try:
                self._partial.append(MAGIC + packed(mcap.Header(profile="", library=f"hapticd {__version__}")))
            except OSError as error:
                self._fail(error)  # nothing was recorded that could be kept

    def begin(self, texts: Mapping[str, object], about: Mapping[str, object] | None = None) -> None:
        super().begin(texts, about)
        for name, value in texts.items():
            data = json.dumps(value).encode()
            with self._naming_errors():
                self._partial.append(
                    packed(
                        mcap.Attachment(
                            create_time=0, log_time=0, name=f"{name}.json", media_type="application/json", data=data
                        )
                    )
                )

    # ---- Messages --------------------------------------------------------------------------------------------------

    def _write(self, samples: Samples) -> None:
        if self._message_dtype is None:
            self._declare(samples.dtype)
        for first in range(0, len(samples), _BATCH):
            self._write_batch(samples[first : first + _BATCH])

    def _write_batch(self, samples: Samples) -> None:
        assert self._message_dtype is not None
        times = samples["time_ns"].astype(np.uint64)
        messages = np.empty(len(samples), self._message_dtype)
        messages["opcode"] = Opcode.MESSAGE
        messages["length"] = self._message_dtype.itemsize - 9
        messages["channel"] = SAMPLES
        messages["sequence"] = samples["tick"] & np.uint64(0xFFFFFFFF)
        messages["log_time"] = messages["publish_time"] = times
        messages["encapsulation"] = _CDR_LITTLE_ENDIAN
        messages["record"] = np.ascontiguousarray(samples).view(messages.dtype["record"])
        pending = self._pending
        if pending.since_ns is None:
            pending.since_ns = int(times[0])
        early, self._early = self._early, []
        for channel, value in early:
            self._add_json(channel, int(times[0]), value)
        pending.add(SAMPLES, times, messages.tobytes())
        pending.last_tick, pending.last_time_ns = last_of(samples)
        if pending.size >= CHUNK_BYTES or pending.last_time_ns - pending.since_ns >= _CHUNK_NS:
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
        message = packed(
            mcap.Message(
                channel_id=channel,
                log_time=time_ns,
                publish_time=time_ns,
                sequence=0,
                data=json.dumps(value).encode(),
            )
        )
        self._pending.add(channel, np.array([time_ns], np.uint64), message)

    def _declare(self, dtype: np.dtype[np.void]) -> None:
        """Schemas and channels, before the first message."""
        if np.dtype([(name, dtype[name]) for name in dtype.names or ()], align=True) != dtype:
            raise HapticdError("the daemon's samples are not laid out as CDR is: record into .npz")
        self._message_dtype = message_dtype(dtype.itemsize)
        self._partial.append(_schemas(dtype) + _channels())

    def _write_chunk(self) -> None:
        """The messages so far, and where each of them is, as one stretch of the file."""
        pending = self._pending
        places = {channel: np.concatenate(parts) for channel, parts in pending.index.items()}
        data = b"".join(pending.data)
        chunk = mcap.Chunk(
            compression="zstd",
            data=self._compressor.compress(data),
            message_start_time=min(int(each[:, 0].min()) for each in places.values()),
            message_end_time=max(int(each[:, 0].max()) for each in places.values()),
            uncompressed_crc=zlib.crc32(data),
            uncompressed_size=len(data),
        )
        records = [packed(chunk)]
        # Samples last: what was cut short has no index of them.
        for channel, each in sorted(places.items(), reverse=True):
            # The package would pack number by number.
            head = struct.pack("<BQHI", Opcode.MESSAGE_INDEX, 6 + each.nbytes, channel, each.nbytes)
            records += [head, each.tobytes()]
        self._partial.append(b"".join(records))
        count = self._checkpoints[-1].samples + len(places.get(SAMPLES, ()))
        self._checkpoints.append(Checkpoint(self._partial.size, count, pending.last_tick, pending.last_time_ns))
        self._pending = _Pending()

    def _drop_pending(self) -> None:
        self._pending = _Pending()

    # ---- The end ---------------------------------------------------------------------------------------------------

    def _finish(self, texts: Mapping[str, object], arrays: Mapping[str, npt.NDArray[Any]]) -> None:
        if self._message_dtype is None:
            self._dtype = self._dtype or np.dtype([("tick", "<u8"), ("time_ns", "<i8")])
            self._declare(self._dtype)
        if self._pending.size:
            self._write_chunk()
        contents = self._contents()
        self.count, self.event_count = contents.messages[SAMPLES], contents.messages[EVENT]
        size = self._partial.size
        try:
            metadata = {name: value for name, value in texts.items() if name not in self.texts}
            self._partial.append(self._ending(metadata, contents))
            self._publish({self.target: self._partial})
        except OSError:
            self._partial.cut(size)
            raise

    def _ending(self, metadata: Mapping[str, object], contents: _Contents) -> bytes:
        assert self._dtype is not None
        at, data, indexes = self._partial.size, b"", []
        for name, value in metadata.items():
            members = value if isinstance(value, dict) else {name: value}
            record = packed(
                mcap.Metadata(name=name, metadata={key: json.dumps(member) for key, member in members.items()})
            )
            indexes.append(mcap.MetadataIndex(offset=at + len(data), length=len(record), name=name))
            data += record
        data += packed(mcap.DataEnd(0))
        start = at + len(data)
        chunks, messages = contents.chunks, contents.messages
        statistics = mcap.Statistics(
            attachment_count=len(contents.attachments),
            channel_count=len(TOPICS),
            channel_message_counts=messages,
            chunk_count=len(chunks),
            message_count=messages.total(),
            message_start_time=min((chunk.message_start_time for chunk in chunks), default=0),
            message_end_time=max((chunk.message_end_time for chunk in chunks), default=0),
            metadata_count=len(indexes),
            schema_count=len(TOPICS),
        )
        groups = {
            Opcode.SCHEMA: _schemas(self._dtype),
            Opcode.CHANNEL: _channels(),
            Opcode.STATISTICS: packed(statistics),
            Opcode.CHUNK_INDEX: packed(*chunks),
            Opcode.ATTACHMENT_INDEX: packed(*contents.attachments),
            Opcode.METADATA_INDEX: packed(*indexes),
        }
        summary, places = b"", []
        for opcode, group in groups.items():
            if group:
                places.append(
                    mcap.SummaryOffset(group_opcode=opcode, group_start=start + len(summary), group_length=len(group))
                )
                summary += group
        offsets, footer = (
            packed(*places),
            mcap.Footer(summary_start=start, summary_offset_start=start + len(summary), summary_crc=0),
        )
        # The checksum is of all of the summary, and of the footer up to itself.
        footer.summary_crc = zlib.crc32(summary + offsets + packed(footer)[:-4])
        return b"".join((data, summary, offsets, packed(footer), MAGIC))

    def _contents(self) -> _Contents:
        """Looks what the partial file holds."""
        found, chunk, messages = _Contents(len(MAGIC)), None, Counter[int]()
        with open(self._partial.descriptor(), "rb") as file:
            file.seek(found.end)
            for opcode, at, body in _records(file):
                size = 9 + len(body)
                if opcode == Opcode.CHUNK:
                    first_ns, last_ns, uncompressed = struct.unpack_from("<QQQ", body)
                    chunk = mcap.ChunkIndex(
                        chunk_start_offset=at,
                        chunk_length=size,
                        compression="zstd",
                        compressed_size=len(body) - _CHUNK_HEAD,
                        uncompressed_size=uncompressed,
                        message_start_time=first_ns,
                        message_end_time=last_ns,
                        message_index_length=0,
                        message_index_offsets={},
                    )
                    messages = Counter()
                elif opcode == Opcode.MESSAGE_INDEX and chunk is not None:
                    channel, length = struct.unpack_from("<HI", body)
                    chunk.message_index_offsets[channel], messages[channel] = at, length // 16
                    chunk.message_index_length += size
                    if channel == SAMPLES:
                        found.chunks.append(chunk)
                        found.messages += messages
                        chunk, found.end = None, at + size
                else:
                    if opcode == Opcode.ATTACHMENT:
                        one: mcap.Attachment = unpacked("Attachment", body)
                        found.attachments.append(
                            mcap.AttachmentIndex(
                                offset=at,
                                length=size,
                                create_time=one.create_time,
                                log_time=one.log_time,
                                data_size=len(one.data),
                                name=one.name,
                                media_type=one.media_type,
                            )
                        )
                    found.end = at + size
        return found

    def _count_events(self) -> None:
        self.event_count = self._contents().messages[EVENT]

    def _count_written(self, dtype: np.dtype[np.void]) -> int:
        contents = self._contents()
        self._message_dtype = message_dtype(dtype.itemsize)
        self.count = contents.messages[SAMPLES]
        if contents.chunks:
            self.last_time_ns = contents.chunks[-1].message_end_time
        return contents.end


def _records(file: IO[bytes]) -> Iterator[tuple[int, int, bytes]]:
    """The whole records that come: what each is, where it begins, what it holds."""
    while len(head := file.read(9)) == 9:
        opcode, length = struct.unpack("<BQ", head)
        body = file.read(length) if length <= _LONGEST else b""
        if len(body) < length:
            return
        yield opcode, file.tell() - 9 - length, body


def _schemas(dtype: np.dtype[np.void]) -> bytes:
    """Of each channel the schema of its messages."""
    schemas = [mcap.Schema(id=SAMPLES, name=SAMPLE_TYPE, encoding="ros2msg", data=sample_schema(dtype).encode())]
    for channel, (name, members) in JSON_SCHEMAS.items():
        shape = {"$schema": "http://json-schema.org/draft-07/schema#", "type": "object", "properties": members}
        schemas.append(mcap.Schema(id=channel, name=name, encoding="jsonschema", data=json.dumps(shape).encode()))
    return packed(*schemas)


def _channels() -> bytes:
    channels = []
    for id, topic in TOPICS.items():
        encoding = "cdr" if id == SAMPLES else "json"
        channels.append(mcap.Channel(id=id, topic=topic, message_encoding=encoding, metadata={}, schema_id=id))
    return packed(*channels)
