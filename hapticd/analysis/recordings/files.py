"""A recording's file as columns of numbers: .csv by pandas, .npz by numpy, .wav by scipy.

Nothing of what is in a file is ever executed. Faults are ValueErrors of one line, without the file's name.
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
from hapticd.base.yaml_source import one_line, read_file

MAX_BYTES: Final = 2**29
MAX_UNPACKED_BYTES: Final = 2**31
MAX_CHANNELS: Final = 64
"""Of a .wav, or of an array of two dimensions."""
_UNCLOSED: Final = "is no table of numbers: a quotation mark that is not closed?"


@dataclass(frozen=True, slots=True)
class Table:
    """What a file holds, before it is read."""

    names: Sequence[str]
    """Of the columns, in their order."""
    read: Callable[[Sequence[int]], list[Floats]]
    """These columns as numbers."""
    units: Mapping[int, str]
    """What the file itself says of the units of its columns; nothing for most."""
    rate_hz: float | None = None
    others: Mapping[str, str] = field(default_factory=dict)
    """What else is in it, and why that is no column."""
    rounded: Callable[[int, Floats], float] = lambda which, values: 0.0
    """To how much a column's numbers are rounded, beyond what they show by themselves."""

    def place(self, column: str | int) -> int:
        """Of the column with this name, or this number from 1. Raises ValueError."""
        if isinstance(column, str) and column in self.names:
            if self.names.count(column) > 1:
                raise ValueError(f"has {self.names.count(column)} columns {quoted(column)}: say its number in the YAML")
            return self.names.index(column)
        number = str(column)
        if number in self.others:
            raise ValueError(f"{shown_name(number)} {self.others[number]}")
        if number.isascii() and number.isdigit() and len(number) < 6 and 1 <= int(number) <= len(self.names):
            return int(number) - 1
        raise ValueError(f"has no column {shown_name(number)}, {known_names(number, map(short_name, self.names))}")


def shown_name(text: str) -> str:
    return f"'{text}'" if short_name(text) == text else quoted(text)


def short_name(name: str) -> str:
    return name if name.isprintable() and len(name) <= 60 else quoted(name)


def ending_of(name: str) -> str:
    """Of a file's name, in small letters."""
    return os.path.splitext(name)[1].lower()


def file_bytes(name: str, most: int) -> bytes:
    """The bytes of a regular file; a pipe would be waited for, a device has no end. Raises ValueError."""
    try:
        found = os.stat(name)
    except OSError as error:
        raise ValueError(f"cannot be read: {error.strerror}") from None
    if stat.S_ISDIR(found.st_mode):
        raise ValueError("cannot be read: is a folder")
    if not stat.S_ISREG(found.st_mode):
        raise ValueError("cannot be read: is a pipe or a device, not a file")
    # Before it is read: what a sparse file says of its size costs nothing.
    if found.st_size > most or len(content := read_file(name, most)) > most:
        raise ValueError(f"is larger than {most} bytes: cut it into several files")
    return content


# ---- .csv -----------------------------------------------------------------------------------------------------------


def csv_table(content: bytes) -> Table:
    """Columns, named in the first line; separated by commas, semicolons, tabs or blanks. Units may stand in the second
    line, and names in a comment, as numpy.savetxt writes them."""
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
                f"lines {heads[0][0]} to {first} hold no numbers: names in one line, perhaps units in the next, and # "
                "before everything else"
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
        raise ValueError(f"line {first} has not {len(names)} columns, but {len(cells)}")
    width = max(len(names), len(cells))
    while names and not names[-1] and heads:
        names.pop()
    return Table(
        [name or str(index + 1) for index, name in enumerate(names)],
        lambda places: _csv_columns(text, first, delimiter, width, places),
        {index: unit for index, unit in enumerate(units) if unit},
    )


def _csv_columns(text: str, first: int, delimiter: str, width: int, places: Sequence[int]) -> list[Floats]:
    """The columns at these places of the lines from `first` on."""
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
            dtype=dict.fromkeys(places, np.float64),
            skipinitialspace=True,
            low_memory=False,
        )
    except ValueError:
        raise ValueError(_csv_fault(text, first, delimiter, width, places) or _UNCLOSED) from None
    columns: list[Floats] = [frame[place].to_numpy(np.float64) for place in places]
    if len(frame) != body.strip("\n").count("\n") + 1:
        raise ValueError(_csv_fault(text, first, delimiter, width, places) or _UNCLOSED)
    # A line that lost a cell has its other values in the wrong columns, and none in the last.
    if frame[width - 1].isna().any() or not all(np.isfinite(column).all() for column in columns):
        fault = _csv_fault(text, first, delimiter, width, places)
        if fault is not None:
            raise ValueError(fault)
    return columns


def _csv_fault(text: str, first: int, delimiter: str, width: int, places: Sequence[int]) -> str | None:
    """What is wrong with the first line from which these columns cannot be read; None if nothing is."""
    for number, line in _lines(text):
        if number < first or line.lstrip().startswith("#"):
            continue
        cells = _cells(line, delimiter)
        if len(cells) != width:
            return f"line {number} has not {width} columns, but {len(cells)}"
        for place in places:
            value = _number(cells[place], delimiter)
            if value is None or not np.isfinite(value):
                told = f"line {number} holds something else than numbers, {quoted(cells[place])}"
                return f"{told} (a sample that is missing?)"
    return None


def _text(content: bytes) -> str:
    """As a spreadsheet or a logger writes it: UTF-8, UTF-16 with a mark, or Latin-1; lines end in a line feed."""
    encodings = ["utf-16"] if content.startswith((b"\xff\xfe", b"\xfe\xff")) else ["utf-8-sig", "latin-1"]
    for encoding in encodings:
        try:
            text = content.decode(encoding)
        except UnicodeDecodeError:
            continue
        if "\0" not in text:
            return text.replace("\r\n", "\n").replace("\r", "\n")
    raise ValueError("is no text")


def _lines(text: str) -> Iterator[tuple[int, str]]:
    """Lines that are not empty, with their numbers from 1."""
    found = re.finditer(r".+|\n", text)
    number = 1
    for match in found:
        line = match[0]
        if line == "\n":
            number += 1
        elif line.strip(" ,;\t"):
            yield number, line


def _delimiter(line: str) -> str:
    """What separates the cells of this line, nothing for blanks; a comma between semicolons or tabs is a decimal
    one."""
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
        raise ValueError(f"is no table: {error}") from None


def _number(cell: str, delimiter: str) -> float | None:
    """None where it is none."""
    try:
        return float(cell if delimiter == "," else cell.replace(",", "."))
    except ValueError:
        return None


# ---- .npz -----------------------------------------------------------------------------------------------------------


def npz_table(content: bytes) -> Table:
    """Columns are arrays of one dimension, and `name[1]`, `name[2]` of those with two. Objects are left alone."""
    if not zipfile.is_zipfile(io.BytesIO(content)):
        raise ValueError("is not an archive as numpy.savez writes it")
    columns: dict[str, npt.NDArray[Any]] = {}
    others: dict[str, str] = {}
    for name, array in _arrays(content).items():
        if isinstance(array, str):
            others[name] = array
        elif array.dtype.kind not in "iuf":
            others[name] = f"holds no numbers in rows or columns, but {array.dtype.name}"
        elif array.ndim > 2:
            others[name] = f"holds no rows or columns, but {array.ndim} dimensions"
        elif array.ndim == 2 and 1 not in array.shape:
            rows = array.T if array.shape[0] >= array.shape[1] else array
            others[name] = f"holds {len(rows)} columns, {short_name(name)}[1] and so on"
            if len(rows) > MAX_CHANNELS:
                others[name] = f"holds {len(rows)} columns, and {MAX_CHANNELS} are the most"
                continue
            columns |= {f"{name}[{index + 1}]": row for index, row in enumerate(rows)}
        else:
            columns[name] = array.reshape(-1)
    rate_hz = columns.pop("rate_hz", None)
    if rate_hz is not None and rate_hz.size != 1:
        raise ValueError("rate_hz must be one number")
    arrays = list(columns.values())

    def rounded(place: int, values: Floats) -> float:
        kind = arrays[place].dtype
        return float(np.spacing(np.abs(values).max(initial=0.0).astype(kind))) if kind.kind == "f" else 1.0

    return Table(
        list(columns),
        lambda places: [np.array(arrays[place], dtype=np.float64) for place in places],
        {},
        None if rate_hz is None else float(rate_hz[0]),
        others,
        rounded,
    )


def _arrays(content: bytes) -> dict[str, npt.NDArray[Any] | str]:
    """The arrays, and why others are none."""
    found: dict[str, npt.NDArray[Any] | str] = {}
    # zipfile, its decompressors and numpy raise a dozen kinds for damaged bytes.
    try:
        archive = np.load(io.BytesIO(content), allow_pickle=False)
        unpacked = sum(entry.file_size for entry in archive.zip.infolist())
    except Exception as error:
        raise ValueError(f"is damaged: {_reason(error)}") from None
    if unpacked > MAX_UNPACKED_BYTES:
        raise ValueError(f"unpacks to {unpacked} bytes, {MAX_UNPACKED_BYTES} are the most: cut it into several files")
    for name in archive.files:
        try:
            found[name] = archive[name] if f"{name}.npy" in archive.zip.namelist() else "is no array"
        except Exception as error:
            found[name] = f"cannot be read: {_reason(error)}"
    return found


def _reason(error: BaseException) -> str:
    return one_line(str(error)[:200]) or type(error).__name__


# ---- .wav -----------------------------------------------------------------------------------------------------------


def wav_table(content: bytes) -> Table:
    """Channels, named 1, 2 and so on, in parts of full scale."""
    require_scipy()
    from scipy.io import wavfile

    try:
        with warnings.catch_warnings():
            # Chunks that are not samples are skipped; samples that are missing are not.
            warnings.simplefilter("ignore", wavfile.WavFileWarning)
            warnings.filterwarnings("error", "Reached EOF", wavfile.WavFileWarning)
            rate_hz, samples = wavfile.read(io.BytesIO(content))
    except Exception as error:
        raise ValueError(f"is damaged, or no .wav with 8 to 32 bits or floats: {_reason(error)}") from None
    channels = np.atleast_2d(samples.T)
    if len(channels) > MAX_CHANNELS:
        raise ValueError(f"holds {len(channels)} channels, and {MAX_CHANNELS} are the most")

    def read(places: Sequence[int]) -> list[Floats]:
        parts = [channels[place].astype(np.float64) for place in places]
        if samples.dtype.kind == "f":
            return parts
        # 8 bits are unsigned, with 128 for silence; 24 bits come as the upper ones of 32.
        silent = 128.0 if samples.dtype.kind == "u" else 0.0
        return [(part - silent) / 2.0 ** (8 * samples.itemsize - 1) for part in parts]

    return Table([str(index + 1) for index in range(len(channels))], read, {}, float(rate_hz))


TABLE_READERS: Final[Mapping[str, Callable[[bytes], Table]]] = {".csv": csv_table, ".npz": npz_table, ".wav": wav_table}
