"""Columns of a .npz: arrays by name, as numpy.savez writes them. Nothing of what is in it is ever executed."""

from __future__ import annotations

import io
import lzma
import math
import struct
import zipfile
import zlib
from collections.abc import Sequence
from typing import IO, Any, Final

import numpy as np
import numpy.typing as npt

from hapticd.analysis.recordings.table import MAX_BYTES, MAX_CHANNELS, MAX_SAMPLES, Table, short_name, shown_name
from hapticd.analysis.statistics import Floats
from hapticd.base.yaml_source import one_line

_BROKEN: Final = (
    ValueError, EOFError, OSError, RuntimeError, KeyError, IndexError, TypeError, SyntaxError, OverflowError,
    struct.error, zlib.error, lzma.LZMAError, zipfile.BadZipFile,
)  # fmt: skip
"""What a damaged archive makes zipfile and numpy raise."""


def npz_table(content: bytes) -> Table:
    """Columns are arrays of one dimension, and `name[1]`, `name[2]` of those with two. Objects are left alone."""
    if not zipfile.is_zipfile(io.BytesIO(content)):
        raise ValueError("is not an archive as numpy.savez writes it")
    arrays: dict[str, npt.NDArray[Any]] = {}
    names: list[str] = []
    homes: list[tuple[str, int]] = []
    others: dict[str, str] = {}
    try:
        archive = zipfile.ZipFile(io.BytesIO(content))
        found = {entry.filename.removesuffix(".npy"): entry for entry in archive.infolist()}
        shapes = {name: _npy_shape(archive, entry) for name, entry in list(found.items())[:MAX_CHANNELS]}
    except _BROKEN as error:
        raise ValueError(f"is damaged: {_reason(error)}") from None

    def whole(name: str) -> npt.NDArray[Any]:
        if name not in arrays:
            try:
                arrays[name] = _npy(archive, found[name])
            except _BROKEN as error:
                raise ValueError(f"is damaged: {shown_name(name)}: {_reason(error)}") from None
        return arrays[name]

    for name, shape in shapes.items():
        if isinstance(shape, str):
            others[name] = f"holds no numbers in rows or columns, but {shape}"
        elif len(shape) == 2 and 1 not in shape:
            count = min(shape)
            others[name] = f"holds {count} columns, {short_name(name)}[1] and so on"
            if count > MAX_CHANNELS:
                others[name] = f"holds {count} columns, and {MAX_CHANNELS} are the most"
                continue
            names += [f"{name}[{index + 1}]" for index in range(count)]
            homes += [(name, index) for index in range(count)]
        elif name != "rate_hz":
            names.append(name)
            homes.append((name, -1))

    def read(places: Sequence[int]) -> list[Floats]:
        columns = []
        for name, index in (homes[place] for place in places):
            numbers = whole(name)
            if index >= 0:
                numbers = numbers[:, index] if numbers.shape[0] >= numbers.shape[1] else numbers[index]
            columns.append(np.array(numbers.reshape(-1), dtype=np.float64))
        return columns

    def rounded(place: int, values: Floats) -> float:
        kind = whole(homes[place][0]).dtype
        return float(np.spacing(np.abs(values).max(initial=0.0).astype(kind))) if kind.kind == "f" else 1.0

    rate_hz: float | None = None
    if not isinstance(shapes.get("rate_hz", ""), str):
        single = whole("rate_hz")
        if single.size != 1:
            raise ValueError("rate_hz must be one number")
        rate_hz = float(single.reshape(-1)[0])
    return Table(names, read, {}, rate_hz, others, rounded)


def _npy_header(stream: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    version = np.lib.format.read_magic(stream)
    if version == (1, 0):
        return np.lib.format.read_array_header_1_0(stream)
    if version == (2, 0):
        return np.lib.format.read_array_header_2_0(stream)
    raise ValueError(f"an array of version {version[0]}.{version[1]}")


def _npy_shape(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> tuple[int, ...] | str:
    """Of an array of at most two dimensions of numbers; of everything else, what it is."""
    if not entry.filename.endswith(".npy"):
        return "no array"
    with archive.open(entry) as stream:
        shape, _, kind = _npy_header(stream)
    if kind.kind not in "iuf":
        return kind.name
    return shape if len(shape) <= 2 else f"{len(shape)} dimensions"


def _npy(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> npt.NDArray[Any]:
    """The array, as it is stored. Raises one of _BROKEN."""
    with archive.open(entry) as stream:
        shape, by_columns, kind = _npy_header(stream)
        count = math.prod(shape)
        if count > MAX_SAMPLES * MAX_CHANNELS or count * kind.itemsize > 2 * MAX_BYTES:
            raise ValueError(f"{count} numbers are too many: cut it into several files")
        content = stream.read(count * kind.itemsize)
    if len(content) < count * kind.itemsize:
        raise ValueError(f"ends after {len(content)} of {count * kind.itemsize} bytes")
    return np.frombuffer(content, dtype=kind).reshape(shape, order="F" if by_columns else "C")


def _reason(error: BaseException) -> str:
    return one_line(str(error)[:200]) or type(error).__name__
