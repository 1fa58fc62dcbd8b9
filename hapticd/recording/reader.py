"""Reader of recordings. Samples are mapped into memory, not copied. The error of a damaged file is one line.

Before memory is allocated for an array, the size in its header is compared with its size in the archive.
"""

from __future__ import annotations

import json
import math
import mmap
import os
import stat
import struct
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, Final, TypeAlias

import numpy as np
import numpy.typing as npt
from numpy.lib.recfunctions import require_fields

from hapticd.base.core import SAMPLE_DTYPE
from hapticd.base.errors import HapticdError
from hapticd.base.yaml_source import printable
from hapticd.config.document_kinds import refuse_documents
from hapticd.recording.event_columns import ROW_BLOCK_BYTES, events_of_rows
from hapticd.recording.writer import Samples

TEXT_MEMBERS: Final[tuple[str, ...]] = ("config", "scene", "materials", "changes", "status", "recording", "flight")
"""Names of the JSON texts in a recording. Members of the archive with unknown names are not read."""

_READ_BLOCK_BYTES: Final = 1 << 20
"""Bytes that are read at once when a checksum is computed."""
_MAX_REASON_CHARACTERS: Final = 200
"""In the error of a damaged file the reason is cut at this length."""
_MAX_UNPACKED_BYTES, _MAX_COMPRESSION_RATIO = 2**30, 32
"""A member of the archive may take 1 GiB, or 32 times its compressed size if this is more."""
_MAP_NORESERVE: Final = 0x4000
"""Flag of Linux that Python 3.11 does not define. With the flag a mapped file may be larger than the memory."""
_LOCAL_HEADER: Final = struct.Struct("<4s22xHH")
"""Header of a member within a zip file: signature, and the lengths of name and extra field."""
READING_ERRORS: Final = (
    ValueError,
    LookupError,
    TypeError,
    AttributeError,
    ArithmeticError,
    EOFError,
    RuntimeError,
    struct.error,
    zipfile.BadZipFile,
    zlib.error,
)
"""Exceptions that numpy and zipfile raise for a damaged file."""


Contents: TypeAlias = tuple[Samples, list[dict[str, Any]], dict[str, Any], npt.NDArray[np.float64] | None]
"""Samples, events, texts and truth of a recording; see `hapticd.Recording`."""


def read(path: str | os.PathLike[str]) -> Contents:
    """Read a .npz of `hapticd record`, `simulate` or the flight recorder. Raises HapticdError for any other file."""
    name = printable(os.fspath(path))
    if Path(path).suffix.lower() != ".npz":
        refuse_documents(path)
        raise HapticdError(f"{name}: must end in .npz; other formats are exports for other programs")
    try:
        if not stat.S_ISREG(os.stat(path).st_mode):  # a pipe may block, and a device has no end
            raise HapticdError(f"{name}: not a regular file")
        with open(path, "rb") as file, zipfile.ZipFile(file) as archive:
            return _read(file, archive)
    except OSError as error:
        raise HapticdError(f"{name}: {error.strerror or error}") from None
    except MemoryError:
        raise HapticdError(f"{name}: not enough memory") from None
    except READING_ERRORS as error:
        why = printable(str(error)[:_MAX_REASON_CHARACTERS]) or type(error).__name__
        raise HapticdError(f"{name}: damaged, or not a recording of hapticd: {why}") from None


def _read(file: IO[bytes], archive: zipfile.ZipFile) -> Contents:
    members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
    if "samples" not in members:
        raise ValueError("no samples")
    samples = _read_samples(file, archive, members["samples"])
    truth = None
    if "truth" in members:
        truth = _read_array(archive, members["truth"])
        if truth.shape != (len(samples), 4) or truth.dtype != np.float64:
            raise ValueError(f"truth has shape {truth.shape} of {truth.dtype}, not {(len(samples), 4)} of float64")
    events = list(_read_events(archive, members["events"])) if "events" in members else []
    texts = {name: json.loads(_read_text(archive, members[name])) for name in TEXT_MEMBERS if name in members}
    return samples, events, texts, truth


def _read_head(member: IO[bytes], info: zipfile.ZipInfo) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Read shape and type from a member's .npy header. Raises ValueError if the member's data have another size."""
    read_header = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }[np.lib.format.read_magic(member)]
    try:
        shape, by_columns, dtype = read_header(member)
    except Exception:  # numpy evaluates the header as a Python literal
        raise ValueError(f"{info.filename} has an invalid header") from None
    size = math.prod(shape) * dtype.itemsize
    if dtype.hasobject or (by_columns and len(shape) > 1) or min(shape, default=0) < 0:
        raise ValueError(f"{info.filename} is not a plain array")
    if member.tell() + size != info.file_size:
        raise ValueError(f"{info.filename} should have {size} bytes of data, has {info.file_size - member.tell()}")
    if size > max(_MAX_UNPACKED_BYTES, _MAX_COMPRESSION_RATIO * info.compress_size):
        raise ValueError(
            f"{info.filename} needs {size} bytes of memory, too many for {info.compress_size} bytes in the file"
        )
    return shape, dtype


def _read_array(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> npt.NDArray[Any]:
    with archive.open(info) as member:
        _read_head(member, info)
    with archive.open(info) as member:
        array: npt.NDArray[Any] = np.lib.format.read_array(member, allow_pickle=False)
        member.read(1)  # at its end the archive's checksum is checked
        return array


def _read_samples(file: IO[bytes], archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> Samples:
    with archive.open(info) as member:
        shape, dtype = _read_head(member, info)
        begins = member.tell()
    if len(shape) != 1 or dtype.names is None:
        raise ValueError(f"{info.filename} is not an array of records")
    if info.compress_type == zipfile.ZIP_STORED and shape[0]:
        samples = _mapped(file, archive, info)[begins:].view(dtype)
    else:
        samples = _read_array(archive, info)
    if dtype == SAMPLE_DTYPE:
        # Files of earlier versions are not aligned; the core needs aligned samples.
        return samples if samples.flags.aligned else samples.copy()
    return _with_current_fields(samples)


def _mapped(file: IO[bytes], archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> npt.NDArray[np.uint8]:
    """Map the bytes of an uncompressed member of an archive into memory, copy-on-write."""
    with archive.open(info) as member:
        while member.read(_READ_BLOCK_BYTES):  # at its end the archive's checksum is checked
            pass
    file.seek(info.header_offset)
    _, name_size, extra_size = _LOCAL_HEADER.unpack(file.read(_LOCAL_HEADER.size))
    at = info.header_offset + _LOCAL_HEADER.size + name_size + extra_size
    begin = at - at % mmap.ALLOCATIONGRANULARITY
    flags = mmap.MAP_PRIVATE | _MAP_NORESERVE
    protection = mmap.PROT_READ | mmap.PROT_WRITE
    mapped = mmap.mmap(file.fileno(), at - begin + info.file_size, flags, protection, offset=begin)
    return np.frombuffer(mapped, np.uint8, info.file_size, at - begin)


def _with_current_fields(samples: Samples) -> Samples:
    """Convert samples of another version to the fields of this one. Raises ValueError if the samples lack a field."""
    missing = [name for name in SAMPLE_DTYPE.names or () if name not in (samples.dtype.names or ())]
    if missing:
        raise ValueError(f"samples.npy lacks {', '.join(missing)}")
    with np.errstate(invalid="ignore"):
        found: Samples = require_fields(samples, SAMPLE_DTYPE)
    return found


def _read_events(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> Iterator[dict[str, Any]]:
    """Yield the events of an archive, read in blocks of about ROW_BLOCK_BYTES."""
    with archive.open(info) as member:
        shape, dtype = _read_head(member, info)
        if len(shape) != 1:
            raise ValueError(f"{info.filename} is not an array of events")
        block_rows = max(1, ROW_BLOCK_BYTES // max(1, dtype.itemsize))
        for first in range(0, shape[0], block_rows):
            count = min(block_rows, shape[0] - first)
            yield from events_of_rows(np.frombuffer(member.read(count * dtype.itemsize), dtype, count))
        member.read(1)  # at its end the archive's checksum is checked


def _read_text(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> str:
    with archive.open(info) as member:
        shape, dtype = _read_head(member, info)
        if shape != () or dtype.kind != "U":
            raise ValueError(f"{info.filename} is not a text")
        # Not decoded by numpy, which accepts invalid text.
        return member.read().decode("utf-32-be" if dtype.str[0] == ">" else "utf-32-le").rstrip("\0")
