"""Recordings, read: the samples are mapped into memory, not copied; whatever is damaged is one line.

What a member claims to hold is compared with what the archive has of it, before there is memory for it.
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
from hapticd.base.yaml_source import one_line
from hapticd.config.document_kinds import refuse_documents
from hapticd.recording.event_columns import ROWS_BYTES, events_of_rows
from hapticd.recording.writer import Samples

TEXT_MEMBERS: Final[tuple[str, ...]] = ("config", "scene", "materials", "changes", "status", "recording", "flight")
"""What stands beside the samples, by name; whatever else a file holds is not read."""

_READ_BYTES: Final = 1 << 20
_SHOWN_CHARACTERS: Final = 200
"""Of what is wrong in a damaged file."""
_MOST_UNPACKED, _MOST_RATIO = 2**30, 32
"""Bytes that a member may have whatever it takes in the file, and beyond that, so many for each of its bytes there."""
_MAP_NORESERVE: Final = 0x4000
"""Of Linux; Python 3.11 has no name for it. A file may be larger than the memory."""
_LOCAL_HEADER: Final = struct.Struct("<4s22xHH")
"""Of a member of an archive: its mark, and the lengths of name and extra field that follow."""
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
"""What reading a file raises that holds something else than it should."""


Contents: TypeAlias = tuple[Samples, list[dict[str, Any]], dict[str, Any], npt.NDArray[np.float64] | None]
"""Samples, events, texts and truth; see `hapticd.Recording`."""


def read(path: str | os.PathLike[str]) -> Contents:
    """Reads a .npz of `hapticd record`, `simulate` or the flight recorder. Raises HapticdError where it is none."""
    name = one_line(os.fspath(path))
    if Path(path).suffix.lower() != ".npz":
        refuse_documents(path)
        raise HapticdError(f"{name}: must end in .npz; other forms are exports for other programs")
    try:
        if not stat.S_ISREG(os.stat(path).st_mode):  # a pipe would be waited for, and a device has no end
            raise HapticdError(f"{name}: is no regular file")
        with open(path, "rb") as file, zipfile.ZipFile(file) as archive:
            return _read(file, archive)
    except OSError as error:
        raise HapticdError(f"{name}: {error.strerror or error}") from None
    except MemoryError:
        raise HapticdError(f"{name}: takes more memory than there is") from None
    except READING_ERRORS as error:
        why = one_line(str(error)[:_SHOWN_CHARACTERS]) or type(error).__name__
        raise HapticdError(f"{name}: is damaged, or no recording of hapticd: {why}") from None


def _read(file: IO[bytes], archive: zipfile.ZipFile) -> Contents:
    members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
    if "samples" not in members:
        raise ValueError("it has no samples")
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
    """Shape and type of a member; its data follow. Raises ValueError where there are not as many as it says."""
    read_header = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }[np.lib.format.read_magic(member)]
    try:
        shape, by_columns, dtype = read_header(member)
    except Exception:  # a parser of Python, on whatever stands there
        raise ValueError(f"{info.filename} has a header that numpy does not write") from None
    size = math.prod(shape) * dtype.itemsize
    if dtype.hasobject or (by_columns and len(shape) > 1) or min(shape, default=0) < 0:
        raise ValueError(f"{info.filename} holds no plain array")
    if member.tell() + size != info.file_size:
        raise ValueError(f"{info.filename} says that it has {size} bytes, and has not")
    if size > max(_MOST_UNPACKED, _MOST_RATIO * info.compress_size):
        raise ValueError(f"{info.filename} would take {size} bytes of memory, from {info.compress_size} of the file")
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
        raise ValueError("its samples are no records")
    if info.compress_type == zipfile.ZIP_STORED and shape[0]:
        samples = _mapped(file, archive, info)[begins:].view(dtype)
    else:
        samples = _read_array(archive, info)
    if dtype == SAMPLE_DTYPE:
        # Those of earlier versions were not aligned in their files; the core needs them to be.
        return samples if samples.flags.aligned else samples.copy()
    return _as_now(samples)


def _mapped(file: IO[bytes], archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> npt.NDArray[np.uint8]:
    """The bytes of a member that is not compressed; who writes to them changes his own copy."""
    with archive.open(info) as member:
        while member.read(_READ_BYTES):  # at its end the archive's checksum is checked
            pass
    file.seek(info.header_offset)
    _, name_size, extra_size = _LOCAL_HEADER.unpack(file.read(_LOCAL_HEADER.size))
    at = info.header_offset + _LOCAL_HEADER.size + name_size + extra_size
    begin = at - at % mmap.ALLOCATIONGRANULARITY
    flags = mmap.MAP_PRIVATE | _MAP_NORESERVE
    protection = mmap.PROT_READ | mmap.PROT_WRITE
    mapped = mmap.mmap(file.fileno(), at - begin + info.file_size, flags, protection, offset=begin)
    return np.frombuffer(mapped, np.uint8, info.file_size, at - begin)


def _as_now(samples: Samples) -> Samples:
    """Records with the fields of this version, of those of another. Raises ValueError where one is missing."""
    missing = [name for name in SAMPLE_DTYPE.names or () if name not in (samples.dtype.names or ())]
    if missing:
        raise ValueError(f"its samples have no {', '.join(missing)}")
    with np.errstate(invalid="ignore"):
        found: Samples = require_fields(samples, SAMPLE_DTYPE)
    return found


def _read_events(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> Iterator[dict[str, Any]]:
    """In stretches: one long mark widens all rows."""
    with archive.open(info) as member:
        shape, dtype = _read_head(member, info)
        if len(shape) != 1:
            raise ValueError(f"{info.filename} holds no events")
        most = max(1, ROWS_BYTES // max(1, dtype.itemsize))
        for first in range(0, shape[0], most):
            count = min(most, shape[0] - first)
            yield from events_of_rows(np.frombuffer(member.read(count * dtype.itemsize), dtype, count))
        member.read(1)  # at its end the archive's checksum is checked


def _read_text(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> str:
    with archive.open(info) as member:
        shape, dtype = _read_head(member, info)
        if shape != () or dtype.kind != "U":
            raise ValueError(f"{info.filename} is no text")
        # Not by numpy, which makes strings of whatever numbers stand there.
        return member.read().decode("utf-32-be" if dtype.str[0] == ">" else "utf-32-le").rstrip("\0")
