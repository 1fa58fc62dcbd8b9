"""Recordings in .npz, read. numpy.load would make room for what a header says before it looks what there is."""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Iterator
from typing import IO, Any, Final

import numpy as np
import numpy.typing as npt

from hapticd.base.core import SAMPLE_DTYPE
from hapticd.recording.event_columns import ROWS_BYTES, events_of_rows
from hapticd.recording.reading_limits import (
    TEXTS,
    BadRecordingError,
    Bounded,
    Memory,
    Recorded,
    Samples,
    fill,
    samples_of,
)

_MOST_READ: Final = 1 << 20
"""Bytes that are read at once, the archive's directory among them; ours has about 80 a member."""
_LONGEST_HEADER: Final = 10_000
"""Bytes of a .npy member's header; numpy takes no more either."""
_WIDEST_ROW: Final = 1 << 20
"""Bytes of an event; the longest mark has 37 kB."""
_MOST_EVENTS: Final = 100_000
"""Events that there may be whatever the size, and one more for each compressed byte."""


def load_npz(file: IO[bytes], memory: Memory) -> Recorded:
    """Raises HapticdError, and what reading archives raises."""
    texts: dict[str, Any] = {}
    samples: Samples | None = None
    truth: npt.NDArray[np.float64] | None = None
    events: list[dict[str, Any]] = []
    seen = set()
    bounded = Bounded(file, _MOST_READ, "the directory of its archive is too long")
    with zipfile.ZipFile(bounded) as archive:
        for info in archive.infolist():
            name = info.filename.removesuffix(".npy")
            if name not in TEXTS and name not in ("samples", "truth", "events"):
                continue
            if name in seen:
                raise BadRecordingError(f"{info.filename}: is there twice")
            seen.add(name)
            if name == "samples":
                samples = _read_samples(archive, info, memory)
            elif name == "truth":
                truth = _read_truth(archive, info, memory)
            elif name == "events":
                for rows in _read_rows(archive, info):
                    memory.check(_rows_take(rows), "its events")
                    events += map(memory.event, events_of_rows(rows))
            else:
                text = _read_text(archive, info, memory)
                if text is not None:
                    texts[name] = memory.json(text, name)
    if samples is None:
        raise BadRecordingError("it has no samples")
    if truth is not None and len(truth) != len(samples):
        raise BadRecordingError(f"truth has {len(truth)} rows, not {len(samples)}")
    return Recorded(samples, texts, events, truth)


def _rows_take(rows: npt.NDArray[np.void]) -> int:
    """Bytes that events may take, before they are made, without their texts."""
    return len(rows) * (240 + 104 * len(rows.dtype.names or ()))


def _read_head(member: IO[bytes], info: zipfile.ZipInfo) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Shape and type of a member."""
    begin = member.read(8)
    sizes = {b"\x93NUMPY\x01\x00": 2, b"\x93NUMPY\x02\x00": 4}
    if begin not in sizes:
        raise BadRecordingError(f"{info.filename}: is no array of numpy's version 1.0 or 2.0")
    length = member.read(sizes[begin])
    size = int.from_bytes(length, "little")
    if size > _LONGEST_HEADER:
        raise BadRecordingError(f"{info.filename}: says that its header has {size} bytes")
    header = io.BytesIO(length + member.read(size))
    try:
        if sizes[begin] == 2:
            shape, by_columns, dtype = np.lib.format.read_array_header_1_0(header)
        else:
            shape, by_columns, dtype = np.lib.format.read_array_header_2_0(header)
    except Exception:  # a parser of Python, on whatever stands there
        raise BadRecordingError(f"{info.filename}: has a header that numpy does not write") from None
    if dtype.hasobject or (by_columns and len(shape) > 1) or min(shape, default=0) < 0:
        raise BadRecordingError(f"{info.filename}: holds no plain array")
    return shape, dtype


def _open_member(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> IO[bytes]:
    if info.flag_bits & 1 or info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise BadRecordingError(f"{info.filename}: is encrypted, or compressed in another way than by deflate")
    return archive.open(info)


def _has(info: zipfile.ZipInfo, size: int) -> None:
    if size > info.file_size:
        raise _has_not(info, size)


def _has_not(info: zipfile.ZipInfo, size: int) -> BadRecordingError:
    return BadRecordingError(f"{info.filename}: says that it has {size} bytes, and has not")


def _read_into(member: IO[bytes], info: zipfile.ZipInfo, array: npt.NDArray[Any]) -> None:
    if array.nbytes and fill(member, array.reshape(-1).view(np.uint8).data) != array.nbytes:
        raise _has_not(info, array.nbytes)
    member.read(1)  # at its end the archive's checksum is checked


def _read_samples(archive: zipfile.ZipFile, info: zipfile.ZipInfo, memory: Memory) -> Samples:
    with _open_member(archive, info) as member:
        shape, dtype = _read_head(member, info)
        if len(shape) != 1 or dtype.names is None or not dtype.itemsize:
            raise BadRecordingError("it has no samples")
        _has(info, shape[0] * dtype.itemsize)
        memory.take(shape[0] * memory.sample_bytes, "its samples")
        samples = np.empty(shape, SAMPLE_DTYPE)
        if dtype == SAMPLE_DTYPE:
            _read_into(member, info, samples)
            return samples
        if dtype.itemsize > _WIDEST_ROW:
            raise BadRecordingError(f"a sample has {dtype.itemsize} bytes")
        at = 0
        for rows in _stretches(member, info, shape[0], dtype):
            samples[at : at + len(rows)] = samples_of(len(rows), rows.__getitem__)
            at += len(rows)
        return samples


def _stretches(
    member: IO[bytes], info: zipfile.ZipInfo, count: int, dtype: np.dtype[Any]
) -> Iterator[npt.NDArray[np.void]]:
    """The records of a member, some at a time."""
    left, most = count, max(1, ROWS_BYTES // dtype.itemsize)
    while left:
        rows = np.empty(min(left, most), dtype)
        if fill(member, rows.view(np.uint8).data) != rows.nbytes:
            raise _has_not(info, count * dtype.itemsize)
        yield rows
        left -= len(rows)
    member.read(1)  # at its end the archive's checksum is checked


def _read_rows(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> Iterator[npt.NDArray[np.void]]:
    """The events, in stretches: one long mark widens all rows."""
    with _open_member(archive, info) as member:
        shape, dtype = _read_head(member, info)
        if len(shape) != 1 or (shape[0] and dtype.names is None) or dtype.itemsize > _WIDEST_ROW:
            raise BadRecordingError(f"{info.filename}: holds no events")
        if shape[0] > _MOST_EVENTS + info.compress_size:
            raise BadRecordingError(
                f"{info.filename}: says that it has {shape[0]} events, in {info.compress_size} bytes"
            )
        if dtype.itemsize:
            yield from _stretches(member, info, shape[0], dtype)


def _read_truth(archive: zipfile.ZipFile, info: zipfile.ZipInfo, memory: Memory) -> npt.NDArray[np.float64]:
    with _open_member(archive, info) as member:
        shape, dtype = _read_head(member, info)
        if len(shape) != 2 or shape[1] != 4 or dtype != np.float64:
            raise BadRecordingError(f"truth has shape {shape} of {dtype}, not (n, 4) of float64")
        size = math.prod(shape) * dtype.itemsize
        _has(info, size)
        memory.take(size, "its truth")
        truth = np.empty(shape, np.float64)
        _read_into(member, info, truth)
        return truth


def _read_text(archive: zipfile.ZipFile, info: zipfile.ZipInfo, memory: Memory) -> str | None:
    """One string; None of a member that is none."""
    with _open_member(archive, info) as member:
        shape, dtype = _read_head(member, info)
        if shape != () or dtype.kind != "U":
            return None
        _has(info, dtype.itemsize)
        memory.check(12 * dtype.itemsize, info.filename)
        data = np.empty(dtype.itemsize, np.uint8)
        _read_into(member, info, data)
        # Not by numpy, which makes strings of whatever numbers stand there.
        return data.tobytes().decode("utf-32-be" if dtype.str[0] == ">" else "utf-32-le").rstrip("\0")
