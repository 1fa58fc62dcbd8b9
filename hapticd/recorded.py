"""Recordings, read back: samples and events as they were, and what they were rendered with.

A recording may come from anybody. What it claims to hold is compared with what it is before there is memory for it.
"""

from __future__ import annotations

import csv
import io
import json
import math
import os
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from tokenize import TokenError
from typing import IO, TYPE_CHECKING, Any, Final, cast

import numpy as np
import numpy.typing as npt

from hapticd.core import SAMPLE_DTYPE
from hapticd.document_kinds import refuse_documents
from hapticd.errors import HapticdError
from hapticd.event_columns import ROWS_BYTES, event_of_cells, events_of_rows
from hapticd.yaml_source import one_line

if TYPE_CHECKING:
    from mcap.records import Chunk

Samples = npt.NDArray[np.void]


_LEAST_MCAP: Final = 8 + 29 + 8
"""Bytes of magic, footer and magic."""
_LARGEST_CHUNK: Final = 1 << 26
"""Bytes of a chunk of a .mcap; ours have up to a second of samples."""
_WIDEST_ROW: Final = 1 << 20
"""Bytes of an event in a .npz; the longest mark has 37 kB."""
_MOST_EVENTS: Final = 100_000
"""Events that a .npz may hold whatever its size, and one more for each of its compressed bytes."""
_WRONG: Final = (
    ValueError,
    KeyError,
    IndexError,
    TypeError,
    AttributeError,
    EOFError,
    csv.Error,
    RecursionError,
    OverflowError,
    TokenError,
)
"""What reading a file raises that holds something else than it should."""


@dataclass(frozen=True, slots=True)
class Recorded:
    """What a file holds."""

    samples: Samples
    """(n,) records of `hapticd.SAMPLE_DTYPE`."""
    texts: Mapping[str, Any]
    """What stands beside them, by name: `status`, `config`, `scene`, `materials`, `changes`, `recording`."""
    events: list[dict[str, Any]] = field(default_factory=list)
    """As in telemetry, in the order of the file."""
    truth: npt.NDArray[np.float64] | None = None
    """(n, 4): of a simulation, the handle's own x, y (m) and its velocity along x, y (m/s)."""


def load_recorded(path: str | os.PathLike[str]) -> Recorded:
    """Reads a .npz, .csv or .mcap of `hapticd record` or `hapticd simulate`. Raises HapticdError where it is none."""
    forms: dict[str, Callable[[Path], Recorded]] = {".npz": _load_npz, ".csv": _load_csv, ".mcap": _load_mcap}
    name = os.fspath(path)
    load = forms.get(Path(path).suffix.lower())
    if load is None:
        refuse_documents(name)
        raise HapticdError(f"{name}: must end in .npz, .csv or .mcap")
    try:
        return load(Path(path))
    except OSError as error:
        raise HapticdError(f"{error.filename or name}: {error.strerror or error}") from None
    except (*_WRONG, zipfile.BadZipFile, zlib.error, NotImplementedError) as error:
        raise HapticdError(f"{one_line(name)}: is no recording of hapticd: {_reason(error)}") from None


def _reason(error: Exception) -> str:
    """What a library said, as one line that is not too long."""
    told = one_line(str(error) or type(error).__name__)
    return told if len(told) <= 300 else f"{told[:300]}..."


def _texts_of(tree: object) -> dict[str, Any]:
    if not isinstance(tree, dict):
        raise ValueError("what stands beside the samples is no map")
    return tree


def _samples(count: int, columns: Callable[[str], npt.NDArray[Any]]) -> Samples:
    """Records of the names that this version has, from columns; a KeyError or ValueError where one is missing."""
    samples = np.empty(count, SAMPLE_DTYPE)
    for name in SAMPLE_DTYPE.names or ():
        column = columns(name)
        if column.dtype.kind not in "uif" or column.shape != samples[name].shape:
            raise ValueError(f"{name} has another form than in this version")
        samples[name] = column
    return samples


def _load_npz(path: Path) -> Recorded:
    texts: dict[str, Any] = {}
    given: npt.NDArray[Any] | None = None
    truth: npt.NDArray[Any] | None = None
    events: list[dict[str, Any]] = []
    with zipfile.ZipFile(path) as file:
        for info in file.infolist():
            name = info.filename.removesuffix(".npy")
            if name == "samples":
                given = _read_array(file, info)
            elif name == "truth":
                truth = _read_array(file, info)
            elif name == "events":
                events += (event for rows in _read_rows(file, info) for event in events_of_rows(rows))
            else:
                text = _read_array(file, info)
                if text.dtype.kind == "U" and text.ndim == 0:
                    # Not by numpy, which makes strings of whatever numbers stand there.
                    order = "utf-32-be" if text.dtype.str[0] == ">" else "utf-32-le"
                    texts[name] = json.loads(text.tobytes().decode(order).rstrip("\0"))
    if given is None or given.ndim != 1 or given.dtype.names is None:
        raise ValueError("it has no samples")
    if truth is not None and (truth.shape != (len(given), 4) or truth.dtype != np.float64):
        raise ValueError(f"truth has shape {truth.shape} of {truth.dtype}, not ({len(given)}, 4) of float64")
    samples = given if given.dtype == SAMPLE_DTYPE else _samples(len(given), given.__getitem__)
    return Recorded(samples, texts, events, truth)


def _read_head(member: IO[bytes], info: zipfile.ZipInfo) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Shape and type of a member of a .npz."""
    version = np.lib.format.read_magic(member)
    if version == (1, 0):
        shape, by_columns, dtype = np.lib.format.read_array_header_1_0(member)
    elif version == (2, 0):
        shape, by_columns, dtype = np.lib.format.read_array_header_2_0(member)
    else:
        raise ValueError(f"{info.filename}: arrays of version {version[0]}.{version[1]} are not read")
    if dtype.hasobject or (by_columns and len(shape) > 1) or min(shape, default=0) < 0:
        raise ValueError(f"{info.filename}: holds no plain array")
    return shape, dtype


def _open_member(file: zipfile.ZipFile, info: zipfile.ZipInfo) -> IO[bytes]:
    if info.flag_bits & 1 or info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError(f"{info.filename}: is encrypted, or compressed in another way than by deflate")
    return file.open(info)


def _read_rows(file: zipfile.ZipFile, info: zipfile.ZipInfo) -> Iterator[npt.NDArray[np.void]]:
    """The events of a .npz, in stretches: one long mark widens all rows."""
    with _open_member(file, info) as member:
        shape, dtype = _read_head(member, info)
        if len(shape) != 1 or (shape[0] and dtype.names is None) or dtype.itemsize > _WIDEST_ROW:
            raise ValueError(f"{info.filename}: holds no events")
        if shape[0] > _MOST_EVENTS + info.compress_size:
            raise ValueError(f"{info.filename}: says that it has {shape[0]} events, in {info.compress_size} bytes")
        left = shape[0] if dtype.itemsize else 0
        most = max(1, ROWS_BYTES // max(1, dtype.itemsize))
        while left:
            count = min(left, most)
            data = member.read(count * dtype.itemsize)
            if len(data) != count * dtype.itemsize:
                raise ValueError(f"{info.filename}: says that it has {shape[0]} events, and has not")
            yield np.frombuffer(data, dtype)
            left -= count
        member.read(1)  # at its end the archive's checksum is looked at


def _read_array(file: zipfile.ZipFile, info: zipfile.ZipInfo) -> npt.NDArray[Any]:
    """A member of a .npz. numpy.load would make room for what its header says before it looks what there is."""
    with _open_member(file, info) as member:
        shape, dtype = _read_head(member, info)
        size = math.prod(shape) * dtype.itemsize
        # One more byte than there should be has the archive's checksum looked at.
        data = b"" if size > info.file_size else member.read(size + 1)
    if len(data) != size:
        raise ValueError(f"{info.filename}: says that it has {size} bytes, and has not")
    return np.frombuffer(data, dtype).reshape(shape)


def _load_csv(path: Path) -> Recorded:
    about = path.with_name(f"{path.stem}.about.json")
    with open(about, encoding="utf-8") as file:
        texts = _texts_of(json.load(file))
    with open(path, encoding="utf-8") as file:
        names = file.readline().strip().split(",")
        rows = [line for line in file if line.strip()]
    cells = (
        np.loadtxt(rows, dtype="U25", delimiter=",", comments=None, ndmin=2)
        if rows
        else np.empty((0, len(names)), "U25")
    )
    if cells.shape[1] != len(names):
        raise ValueError(f"has {cells.shape[1]} columns under {len(names)} names")

    def column(name: str) -> npt.NDArray[Any]:
        base, shape = SAMPLE_DTYPE[name].base, SAMPLE_DTYPE[name].shape
        wanted = [f"{name}_{axis}" for axis in "xy"] if shape else [name]
        found = np.stack([cells[:, names.index(one)].astype(base) for one in wanted], axis=1)
        return found if shape else found[:, 0]

    return Recorded(_samples(len(cells), column), texts, list(_events_csv(path)))


def _events_csv(path: Path) -> Iterator[dict[str, Any]]:
    with open(path.with_name(f"{path.stem}.events.csv"), encoding="utf-8", newline="") as file:
        names = next(rows := csv.reader(file), [])
        for row in rows:
            yield event_of_cells(dict(zip(names, row, strict=True)))


def _load_mcap(path: Path) -> Recorded:
    try:
        from mcap.exceptions import McapError
        from mcap.reader import make_reader
        from mcap.records import Chunk
        from mcap.stream_reader import StreamReader
        from zstandard import ZstdError
    except ImportError:
        from hapticd.mcap import needed

        raise needed() from None
    from hapticd.mcap import CHANGE, EVENT, MAGIC, SAMPLES, TOPICS, sample_schema

    texts: dict[str, Any] = {}
    found: dict[str, list[bytes]] = {TOPICS[name]: [] for name in (SAMPLES, EVENT, CHANGE)}
    with open(path, "rb") as opened:
        if path.stat().st_size < _LEAST_MCAP or opened.read(len(MAGIC)) != MAGIC:
            raise ValueError("it is no whole MCAP file")
        opened.seek(0)
        file = cast(IO[bytes], _Whole(opened, path.stat().st_size))
        try:
            reader = make_reader(file)
            for attachment in reader.iter_attachments():
                texts[attachment.name.removesuffix(".json")] = json.loads(attachment.data)
            for metadata in reader.iter_metadata():
                texts[metadata.name] = {name: json.loads(value) for name, value in metadata.metadata.items()}
            summary = reader.get_summary()
            if summary is None:
                raise ValueError("it was not finished; `mcap recover` makes a whole one of it")
            wanted = {}
            for channel in summary.channels.values():
                if channel.topic == TOPICS[SAMPLES]:
                    definition = summary.schemas[channel.schema_id].data.decode()
                    if definition != sample_schema(SAMPLE_DTYPE):
                        raise ValueError("its samples have other fields than those of this version")
                if channel.topic in found:
                    wanted[channel.id] = found[channel.topic]
            for place in sorted({index.chunk_start_offset for index in summary.chunk_indexes}):
                file.seek(place)
                chunk = next(StreamReader(file, skip_magic=True, emit_chunks=True).records)
                if not isinstance(chunk, Chunk):
                    raise ValueError("its index names a chunk where there is none")
                _take_messages(_unpacked(chunk), wanted)
        except (McapError, ZstdError, EOFError, struct.error) as error:
            raise ValueError(str(error) or "it ends too early") from None
    if any(len(message) != 4 + SAMPLE_DTYPE.itemsize for message in found[TOPICS[SAMPLES]]):
        raise ValueError("a sample has another size than its fields")
    # Four bytes say how the record after them is encoded.
    samples = np.frombuffer(b"".join(message[4:] for message in found[TOPICS[SAMPLES]]), SAMPLE_DTYPE)
    texts["changes"] = [json.loads(message) for message in found[TOPICS[CHANGE]]]
    events = [json.loads(message) for message in found[TOPICS[EVENT]]]
    if not all(isinstance(event, dict) for event in events):
        raise ValueError("an event is no map")
    return Recorded(samples, texts, events)


class _Whole:
    """A file whose reads end where it ends: a length of gigabytes that stands in it does not become memory first."""

    def __init__(self, file: IO[bytes], size: int) -> None:
        self._file = file
        self._size = size

    def read(self, size: int = -1) -> bytes:
        left = max(self._size - self._file.tell(), 0)
        return self._file.read(left if size < 0 else min(size, left))

    def seek(self, place: int, whence: int = io.SEEK_SET) -> int:
        return self._file.seek(place, whence)

    def tell(self) -> int:
        return self._file.tell()

    def seekable(self) -> bool:
        return True


def _unpacked(chunk: Chunk) -> bytes:
    """What a chunk holds. Raises ValueError, and what the library of its compression raises."""
    from mcap.stream_reader import get_chunk_data_stream
    from zstandard import frame_content_size

    if chunk.uncompressed_size > _LARGEST_CHUNK:
        raise ValueError(f"a chunk says that it holds {chunk.uncompressed_size} bytes")
    # The frame says once more how much it holds, which is what its library makes room for.
    if chunk.compression == "zstd" and frame_content_size(chunk.data) > chunk.uncompressed_size:
        raise ValueError("a chunk holds more than it says")
    stream, size = get_chunk_data_stream(chunk, validate_crc=True)
    return stream.read(size)


def _take_messages(data: bytes, wanted: Mapping[int, list[bytes]]) -> None:
    """Adds the messages of a chunk to those of their channels. A call of the library for each would cost far more."""
    head, rest = struct.Struct("<BQH"), 4 + 8 + 8
    at = 0
    while at < len(data):
        opcode, length, channel = head.unpack_from(data, at)
        end = at + 9 + length
        if opcode == 5 and channel in wanted:
            wanted[channel].append(data[at + head.size + rest : end])
        at = end
