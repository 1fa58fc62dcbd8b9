"""Read a recording's file as columns of numbers: .csv by pandas, .npz by numpy, .wav by scipy.

No content of a file is ever executed. Faults raise ValueError with one line, to which the caller adds the file's name.
"""

from __future__ import annotations

import csv
import io
import os
import re
import stat
import warnings
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from hapticd.analysis.statistics import Floats, require_scipy
from hapticd.base.errors import HapticdError, known_names, quoted
from hapticd.base.yaml_source import printable, read_file

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

    def index_of(self, column: str | int) -> int:
        """Return the index of the column with this name or number (from 1). Raises ValueError unless it is unique."""
        if isinstance(column, str) and column in self.names:
            if (count := self.names.count(column)) > 1:
                raise ValueError(f"has {count} columns {quoted(column)}: set the column's number in the YAML file")
            return self.names.index(column)
        number = str(column)
        if number in self.others:
            raise ValueError(f"{shown_name(number)} {self.others[number]}")
        if number.isascii() and number.isdigit() and len(number) < 6 and 1 <= int(number) <= len(self.names):
            return int(number) - 1
        raise ValueError(f"has no column {shown_name(number)}; {known_names(number, map(short_name, self.names))}")


def shown_name(text: str) -> str:
    """Return a name in quotation marks, shortened to one line."""
    return f"'{text}'" if short_name(text) == text else quoted(text)


def short_name(name: str) -> str:
    """Return a name; a long or unprintable one is shortened and quoted."""
    return name if name.isprintable() and len(name) <= 60 else quoted(name)


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


def csv_table(content: bytes) -> Table:
    """Return the columns of a .csv, separated by commas, semicolons, tabs or blanks.

    The first line holds the names, the second may hold units. Names may also be in a comment, as numpy.savetxt writes
    them, or missing: columns are then numbered from 1.
    """
    text = _text(content)
    heads: list[tuple[int, str]] = []
    comment = ""
    for first, line in _lines(text):
        if line.lstrip().startswith("#"):
            comment = line.lstrip()[1:]
            continue
        delimiter = _delimiter(line)
        cells = _cells(line, delimiter)
        full = [cell for cell in cells if cell]
        if 2 * sum(_number(cell, delimiter) is not None for cell in full) > len(full):
            break
        heads.append((first, line))
        if len(heads) > 2:
            raise ValueError(
                f"lines {heads[0][0]} to {first} hold no numbers: only names in one line and units in the next may "
                "precede them; begin other lines with #"
            )
    else:
        raise ValueError("is empty" if not heads else "holds no line of numbers")
    names, units = [""] * len(cells), []
    if heads:
        names = _cells(heads[0][1], delimiter)
        units = _cells(heads[1][1], delimiter) if len(heads) > 1 else []
    elif len(above := _cells(comment, delimiter)) == len(cells):
        names = above
    if any(cells[len(names) :]):
        raise ValueError(f"line {first} must have {len(names)} columns, has {len(cells)}")
    width = max(len(names), len(cells))
    while names and not names[-1] and heads:
        names.pop()
    return Table(
        [name or str(index + 1) for index, name in enumerate(names)],
        lambda indices: _csv_columns(text, first, delimiter, width, indices),
        {index: unit for index, unit in enumerate(units) if unit},
    )


def _csv_columns(text: str, first: int, delimiter: str, width: int, indices: Sequence[int]) -> list[Floats]:
    """Return the columns with these indices as numbers, from the lines beginning with number `first`."""
    try:
        import pandas
    except ImportError:
        raise HapticdError("reading a .csv needs pandas: pip install 'hapticd[fit]'") from None

    body = re.sub(r"(?m)^[ ,;\t]*(#.*)?$\n?", "", text.split("\n", first - 1)[-1])
    try:
        frame = pandas.read_csv(
            io.StringIO(body if delimiter == "," else body.replace(",", ".")),
            sep=delimiter or r"\s+",
            header=None,
            names=range(width),
            index_col=False,
            dtype=dict.fromkeys(indices, np.float64),
            skipinitialspace=True,
            low_memory=False,
        )
    except ValueError:
        raise ValueError(_csv_fault(text, first, delimiter, width, indices) or _UNCLOSED_QUOTE_TEXT) from None
    columns: list[Floats] = [frame[index].to_numpy(np.float64) for index in indices]
    if len(frame) != body.strip("\n").count("\n") + 1:
        raise ValueError(_csv_fault(text, first, delimiter, width, indices) or _UNCLOSED_QUOTE_TEXT)
    # In a line with a cell too few the values are in the wrong columns, and the last cell is missing.
    if frame[width - 1].isna().any() or not all(np.isfinite(column).all() for column in columns):
        fault = _csv_fault(text, first, delimiter, width, indices)
        if fault is not None:
            raise ValueError(fault)
    return columns


def _csv_fault(text: str, first: int, delimiter: str, width: int, indices: Sequence[int]) -> str | None:
    """Return the fault of the first line in which these columns are unreadable; None without such a line."""
    for number, line in _lines(text):
        if number < first or line.lstrip().startswith("#"):
            continue
        cells = _cells(line, delimiter)
        if len(cells) != width:
            return f"line {number} must have {width} columns, has {len(cells)}"
        for index in indices:
            value = _number(cells[index], delimiter)
            if value is None or not np.isfinite(value):
                return f"line {number} must hold numbers, holds {quoted(cells[index])} (a missing sample?)"
    return None


def _text(content: bytes) -> str:
    """Decode UTF-8, UTF-16 with a byte order mark, or Latin-1, and normalize line ends to line feeds."""
    encodings = ["utf-16"] if content.startswith((b"\xff\xfe", b"\xfe\xff")) else ["utf-8-sig", "latin-1"]
    for encoding in encodings:
        try:
            text = content.decode(encoding)
        except UnicodeDecodeError:
            continue
        if "\0" not in text:
            return text.replace("\r\n", "\n").replace("\r", "\n")
    raise ValueError("is not a text file")


def _lines(text: str) -> Iterator[tuple[int, str]]:
    """Yield the lines that are not empty, with their numbers from 1."""
    found = re.finditer(r".+|\n", text)
    number = 1
    for match in found:
        line = match[0]
        if line == "\n":
            number += 1
        elif line.strip(" ,;\t"):
            yield number, line


def _delimiter(line: str) -> str:
    """Return the delimiter of the cells of a line: semicolon, tab or comma; "" for blanks.

    In a line with semicolons or tabs, a comma is a decimal comma.
    """
    bare = re.sub(r'"[^"]*"', '""', line)
    for delimiter in ";\t,":
        if delimiter in bare:
            return delimiter
    return "" if len(bare.split()) > 1 else ","


def _cells(line: str, delimiter: str) -> list[str]:
    if not delimiter:
        return [cell.strip('"') for cell in line.split()]
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])]
    except csv.Error as error:
        raise ValueError(f"is not a table: {error}") from None


def _number(cell: str, delimiter: str) -> float | None:
    """Return the number in a cell; None if the cell does not hold a number."""
    try:
        return float(cell if delimiter == "," else cell.replace(",", "."))
    except ValueError:
        return None


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

    return Table([str(index + 1) for index in range(len(channels))], read, {}, float(rate_hz))


TABLE_READERS: Final[Mapping[str, Callable[[bytes], Table]]] = {".csv": csv_table, ".npz": npz_table, ".wav": wav_table}
"""Functions that read the bytes of a file as a Table, by the ending of its name."""
