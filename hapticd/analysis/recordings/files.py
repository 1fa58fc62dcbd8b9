"""Read a recording's file as columns of numbers: .csv by pandas, .npz by numpy, .wav by scipy.

No content of a file is ever executed. Faults raise ValueError with one line, to which the caller adds the file's name.
"""

from __future__ import annotations

import io
import os
import re
import stat
import struct
import warnings
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from hapticd.analysis.statistics import Floats, require_scipy
from hapticd.base.csv_table import CsvTable, csv_table_of
from hapticd.base.errors import HapticdError, known_names, quoted, short_name, shown_name
from hapticd.base.units import Quantity, StatedUnit, stated_unit
from hapticd.base.yaml_source import printable, read_file
from hapticd.system.extras import install_command

MAX_RECORDING_BYTES: Final = 2**29
"""Largest file of a recording, as the file is read into memory."""
MAX_UNPACKED_BYTES: Final = 2**31
"""Largest total size of the arrays in an .npz, as a small archive may unpack to more than the memory."""
MAX_CHANNELS: Final = 64
"""Largest number of channels of a .wav, or of columns of an array of two dimensions."""
_UNCLOSED_QUOTE_TEXT: Final = "is not a table of numbers: is a quotation mark not closed?"
"""Fault of a .csv if the faulty line cannot be found."""


@dataclass(frozen=True, slots=True)
class Table:
    """The columns of a recording's file. Their numbers are read on demand."""

    names: Sequence[str]
    """Names of the columns, in their order."""
    read: Callable[[Sequence[int]], list[Floats]]
    """Function that reads the columns with these indices as numbers."""
    units: Mapping[int, str]
    """Units that the file itself gives, by the index of the column."""
    rate_hz: float | None = None
    others: Mapping[str, str] = field(default_factory=dict)
    """Content that is not a column, by its name: the reason, as a predicate for an error text."""
    rounded: Callable[[int, Floats], float] = lambda which, values: 0.0
    """Rounding step of the data type (such as float32) of the column with this index and these values; 0 if unknown."""
    note: str = ""
    """What the user should know about how the file was read."""

    def stated_unit(self, index: int, quantity: Quantity) -> StatedUnit | None:
        """Return the unit that the file states for a column. Raises ValueError for a contradiction."""
        return stated_unit(self.names[index], quantity, self.units.get(index, ""))

    def index_of(self, column: str | int) -> int:
        """Return the index of the column with this name or number (from 1). Raises ValueError unless it is unique."""
        if isinstance(column, str) and column in self.names:
            if (count := self.names.count(column)) > 1:
                raise ValueError(f"has {count} columns {quoted(column)}: set the column's number in the YAML file")
            return self.names.index(column)
        # The line of names of an oscilloscope may look like one of units, such as Second,Volt.
        if len(found := [index for index, unit in self.units.items() if unit == column]) == 1:
            return found[0]
        number = str(column)
        if number in self.others:
            raise ValueError(f"{shown_name(number)} {self.others[number]}")
        if number.isascii() and number.isdigit() and len(number) < 6 and 1 <= int(number) <= len(self.names):
            return int(number) - 1
        raise ValueError(f"has no column {shown_name(number)}; {known_names(number, map(short_name, self.names))}")


def ending_of(name: str) -> str:
    """Return the extension of a file's name in lower case, such as ".csv"."""
    return os.path.splitext(name)[1].lower()


def file_bytes(name: str, max_bytes: int) -> bytes:
    """Return the bytes of a regular file. Raises ValueError for a file that is too large or unreadable.

    Pipes and devices are refused, too: a pipe may block, a device may be endless.
    """
    try:
        found = os.stat(name)
    except OSError as error:
        raise ValueError(f"cannot be read: {error.strerror}") from None
    if stat.S_ISDIR(found.st_mode):
        raise ValueError("cannot be read: is a folder")
    if not stat.S_ISREG(found.st_mode):
        raise ValueError("cannot be read: is a pipe or a device, not a file")
    # The size is checked first: reading a sparse file would fill the memory.
    if found.st_size > max_bytes or len(content := read_file(name, max_bytes)) > max_bytes:
        raise ValueError(f"is larger than {max_bytes} bytes: split it into several files")
    return content


# ---- .csv -----------------------------------------------------------------------------------------------------------


def csv_table(content: bytes, skipped: int = 0, advice: str = "remove the other lines") -> Table:
    """Return the columns of a .csv, as `base/csv_table` finds them, without its first `skipped` lines."""
    table = csv_table_of(content, skipped, advice)
    return Table(table.names, lambda indices: _csv_columns(table, indices), table.units)


def _csv_columns(table: CsvTable, indices: Sequence[int]) -> list[Floats]:
    """Return the columns with these indices as numbers."""
    try:
        import pandas
    except ImportError:
        raise HapticdError(f"reading a .csv needs pandas: {install_command('fit')}") from None

    body = re.sub(r"(?m)^[ ,;\t]*(#.*)?$\n?", "", table.text.split("\n", table.first - 1)[-1])
    try:
        frame = pandas.read_csv(
            io.StringIO(body if table.delimiter == "," else body.replace(",", ".")),
            sep=table.delimiter or r"\s+",
            header=None,
            names=range(table.width),
            index_col=False,
            dtype=dict.fromkeys(indices, np.float64),
            skipinitialspace=True,
            low_memory=False,
        )
    except ValueError:
        raise ValueError(_csv_fault(table, indices) or _UNCLOSED_QUOTE_TEXT) from None
    columns: list[Floats] = [frame[index].to_numpy(np.float64) for index in indices]
    if len(frame) != body.strip("\n").count("\n") + 1:
        raise ValueError(_csv_fault(table, indices) or _UNCLOSED_QUOTE_TEXT)
    # In a line with a cell too few the values are in the wrong columns, and the last cell is missing.
    if frame[table.width - 1].isna().any() or not all(np.isfinite(column).all() for column in columns):
        fault = _csv_fault(table, indices)
        if fault is not None:
            raise ValueError(fault)
    return columns


def _csv_fault(table: CsvTable, indices: Sequence[int]) -> str | None:
    """Return the fault of the first line in which these columns are unreadable; None without such a line."""
    faults = ((number, table.fault(cells, indices)) for number, cells in table.lines())
    return next((f"line {number} {fault}" for number, fault in faults if fault is not None), None)


# ---- .npz -----------------------------------------------------------------------------------------------------------


def npz_table(content: bytes) -> Table:
    """Return the columns of an .npz: arrays of one dimension, and `name[1]`, `name[2]` ... of an array of two.

    Arrays of Python objects are not loaded.
    """
    if not zipfile.is_zipfile(io.BytesIO(content)):
        raise ValueError("is not an archive written by numpy.savez")
    columns: dict[str, npt.NDArray[Any]] = {}
    others: dict[str, str] = {}
    for name, array in _arrays(content).items():
        if isinstance(array, str):
            others[name] = array
        elif array.dtype.kind not in "iuf":
            others[name] = f"must hold numbers, holds {array.dtype.name}"
        elif array.ndim > 2:
            others[name] = f"must have 1 or 2 dimensions, has {array.ndim}"
        elif array.ndim == 2 and 1 not in array.shape:
            rows = array.T if array.shape[0] >= array.shape[1] else array
            others[name] = f"holds {len(rows)} columns, {short_name(name)}[1] and so on"
            if len(rows) > MAX_CHANNELS:
                others[name] = f"must have at most {MAX_CHANNELS} columns, has {len(rows)}"
                continue
            columns |= {f"{name}[{index + 1}]": row for index, row in enumerate(rows)}
        else:
            columns[name] = array.reshape(-1)
    rate_hz = columns.pop("rate_hz", None)
    if rate_hz is not None and rate_hz.size != 1:
        raise ValueError("rate_hz must be one number")
    arrays = list(columns.values())

    def rounded(index: int, values: Floats) -> float:
        kind = arrays[index].dtype
        return float(np.spacing(np.abs(values).max(initial=0.0).astype(kind))) if kind.kind == "f" else 1.0

    return Table(
        list(columns),
        lambda indices: [np.array(arrays[index], dtype=np.float64) for index in indices],
        {},
        None if rate_hz is None else float(rate_hz[0]),
        others,
        rounded,
    )


def _arrays(content: bytes) -> dict[str, npt.NDArray[Any] | str]:
    """Return the arrays of an archive by name; an array that cannot be read is replaced by the reason."""
    found: dict[str, npt.NDArray[Any] | str] = {}
    # zipfile, its decompressors and numpy raise a dozen kinds of exceptions for damaged bytes.
    try:
        archive = np.load(io.BytesIO(content), allow_pickle=False)
        unpacked = sum(entry.file_size for entry in archive.zip.infolist())
    except Exception as error:
        raise ValueError(f"is damaged: {_reason(error)}") from None
    if unpacked > MAX_UNPACKED_BYTES:
        raise ValueError(
            f"unpacks to {unpacked} bytes, at most {MAX_UNPACKED_BYTES} are allowed: split it into several files"
        )
    for name in archive.files:
        try:
            found[name] = archive[name] if f"{name}.npy" in archive.zip.namelist() else "is not an array"
        except Exception as error:
            found[name] = f"cannot be read: {_reason(error)}"
    return found


def _reason(error: BaseException) -> str:
    return printable(str(error)[:200]) or type(error).__name__


# ---- .wav -----------------------------------------------------------------------------------------------------------


def wav_table(content: bytes) -> Table:
    """Return the channels of a .wav, named "1", "2" ..., as fractions of full scale."""
    require_scipy()
    from scipy.io import wavfile

    content, note = _with_sizes(content)
    try:
        with warnings.catch_warnings():
            # Unknown chunks are skipped, missing samples are an error.
            warnings.simplefilter("ignore", wavfile.WavFileWarning)
            warnings.filterwarnings("error", "Reached EOF", wavfile.WavFileWarning)
            rate_hz, samples = wavfile.read(io.BytesIO(content))
    except Exception as error:
        raise ValueError(f"is damaged, or not a .wav of 8 to 32 bits or of floats: {_reason(error)}") from None
    channels = np.atleast_2d(samples.T)
    if len(channels) > MAX_CHANNELS:
        raise ValueError(f"must have at most {MAX_CHANNELS} channels, has {len(channels)}")

    def read(indices: Sequence[int]) -> list[Floats]:
        parts = [channels[index].astype(np.float64) for index in indices]
        if samples.dtype.kind == "f":
            return parts
        # Samples of 8 bits are unsigned, with 128 for silence; scipy shifts 24 bits to the upper ones of 32.
        silent = 128.0 if samples.dtype.kind == "u" else 0.0
        return [(part - silent) / 2.0 ** (8 * samples.itemsize - 1) for part in parts]

    return Table([str(index + 1) for index in range(len(channels))], read, {}, float(rate_hz), note=note)


def _with_sizes(content: bytes) -> tuple[bytes, str]:
    """Return a .wav with the true sizes of the file and of its samples, and a note for the user.

    A program that writes to a pipe does not know the sizes, and writes 0 or a number near 2 or 4 GiB instead. RF64 and
    BW64 hold the sizes in a chunk `ds64`, and are returned as RIFF. Raises ValueError if samples are missing.
    """
    if content[:4] not in (b"RIFF", b"RIFX", b"RF64", b"BW64"):
        raise ValueError("is not a .wav: it begins with neither RIFF nor RIFX, RF64 or BW64")
    order = ">" if content[:4] == b"RIFX" else "<"
    place, frame_bytes, ds64_size = 12, 1, 2**32 - 1
    while content[place : place + 4] != b"data":
        if place + 8 > len(content):
            raise ValueError("is damaged: a chunk `data`, which has the samples, was not found")
        (size,) = struct.unpack_from(f"{order}I", content, place + 4)
        body = content[place + 8 : place + 24]
        if content[place : place + 4] == b"ds64":
            ds64_size = int.from_bytes(body[8:16], "little")
        elif content[place : place + 4] == b"fmt " and len(body) >= 14:
            frame_bytes = max(1, *struct.unpack_from(f"{order}H", body, 12))
        place += 8 + size + size % 2
    begin = place + 8
    if begin > len(content):
        return content, ""
    riff_size, size = (struct.unpack_from(f"{order}I", content, at)[0] for at in (4, place + 4))
    if size == 2**32 - 1:
        size = ds64_size
    there = len(content) - begin
    # sox writes 0x7ffff000 without a part of a frame, arecord up to 0x80000000, ffmpeg 0xffffffff.
    is_unknown = 2**31 - 8192 <= size <= 2**31 or 2**32 - 8192 <= size < 2**32 or size == 2**64 - 1
    note = ""
    if is_unknown or (size == 0 and not _are_chunks(content[begin:], order)):
        size = there - there % frame_bytes
        note = (
            "the header does not give the number of samples, as if written to a pipe: all bytes to the end of the file "
            "are read as samples"
        )
    elif size > there:
        raise ValueError(f"is cut off: {there} of {size} bytes of its samples are there")
    if not note and content[:4] in (b"RIFF", b"RIFX") and begin + size <= riff_size + 8 <= len(content):
        return content, ""
    form = b"RIFX" if order == ">" else b"RIFF"
    riff, data = (struct.pack(f"{order}I", each) for each in (begin + size - 8, size))
    return b"".join((form, riff, content[8 : begin - 4], data, content[begin : begin + size], b"\0" * (size % 2))), note


def _are_chunks(content: bytes, order: str) -> bool:
    """Return whether chunks fill these bytes, which may be none, to the end."""
    place = 0
    while place + 8 <= len(content) and content[place : place + 4].strip().isalnum():
        size = struct.unpack_from(f"{order}I", content, place + 4)[0]
        place += 8 + size + size % 2
    return place in (len(content), len(content) + 1)


TABLE_READERS: Final[Mapping[str, Callable[[bytes], Table]]] = {".csv": csv_table, ".npz": npz_table, ".wav": wav_table}
"""Functions that read the bytes of a file as a Table, by the ending of its name."""
