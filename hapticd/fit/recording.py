"""Recordings of an instrumented stylus: read, put into SI units and onto a uniform clock, checked.

.csv  columns, named in the first line; separated by commas, semicolons, tabs or blanks
.npz  arrays by name, as numpy.savez writes them; `rate_hz` and `speed_m_per_s` may be single numbers
.wav  channels, named 1, 2 and so on; full scale is 1

`FILE.yaml` beside a recording (`tap1.csv.yaml`) says what its columns are, in which units, and at which rate. Without
it columns are known by the names of NAMES, which are in SI units. Of a file only the columns that are used are read,
and nothing of what is in it is ever executed.
"""

from __future__ import annotations

import csv
import hashlib
import io
import lzma
import math
import os
import re
import stat
import struct
import zipfile
import zlib
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import IO, Annotated, Any, Final, Literal, TypeAlias

import numpy as np
import numpy.typing as npt
from pydantic import Field, ValidationError

from hapticd.document_kinds import refuse_documents
from hapticd.errors import HapticdError, InvalidError, Problem, known_names, quoted
from hapticd.fit.regression import Floats, require_scipy
from hapticd.fit.sensor import Sensor
from hapticd.model import Model, faults_of
from hapticd.yaml_source import MAX_BYTES as MAX_YAML_BYTES
from hapticd.yaml_source import load_bytes, one_line, read_file

Quantity: TypeAlias = Literal["time", "acceleration", "force", "position", "tangential_position", "speed"]

NAMES: Final[dict[Quantity, str]] = {
    "time": "time_s",
    "acceleration": "acceleration_m_per_s2",
    "force": "force_n",
    "position": "position_m",
    "tangential_position": "tangential_position_m",
    "speed": "speed_m_per_s",
}
UNITS: Final[dict[Quantity, dict[str, float]]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "acceleration": {"m/s^2": 1.0, "mm/s^2": 1e-3, "g": 9.80665},
    "force": {"N": 1.0, "mN": 1e-3, "kN": 1e3},
    "position": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6},
    "tangential_position": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6},
    "speed": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3},
}
MAX_BYTES: Final = 2**29
MAX_SAMPLES: Final = 20_000_000
MAX_LINE: Final = 100_000
MAX_CHANNELS: Final = 64
LARGEST: Final[dict[Quantity, float]] = {
    "time": 1e12,
    "acceleration": 1e9,
    "force": 1e9,
    "position": 1e9,
    "tangential_position": 1e9,
    "speed": 1e9,
}
"""In SI units; far beyond what can be, so that nothing overflows before a fit says what is wrong."""
LEAST_SAMPLES: Final = 16
UNIFORM: Final = 1e-3
"""A clock whose samples are no more than this part of a period from where they should be is taken as uniform."""
JITTER: Final = 0.5
"""Samples farther than this from where they should be, in periods, are missing or doubled ones."""
RATES_ALIKE: Final = 0.02
WANDER: Final = 0.01
PARTS: Final = 20
"""A clock that runs away from a uniform one is taken where each of so many parts of the recording has the mean rate
within so much; what is no clock at all, a position for one, changes more."""
OUTSTANDING: Final = 6.0
"""A distance between samples that is so many times the scatter of all of them off the usual one is a gap."""
LOWEST_HZ: Final = 100.0
HIGHEST_HZ: Final = 1e6

Rate: TypeAlias = Annotated[float, Field(ge=LOWEST_HZ, le=HIGHEST_HZ)]


class RecordingError(HapticdError):
    """A recording that cannot be read, or not be taken as it is; one line that says which and why."""


class RecordedColumn(Model):
    """Where a quantity stands in the file, and in which unit."""

    column: str | int = Field(description="Its name; of a file without names its number, from 1.")
    unit: str | None = Field(default=None, description="Its unit; the SI unit without it.")
    scale: float = Field(default=1.0, description="What its numbers are multiplied by, before the unit.")


class RecordingSidecar(Model):
    """The YAML beside a recording."""

    rate_hz: Rate | None = Field(default=None, description="Sampling rate; without it there is a column of times.")
    columns: dict[Quantity, RecordedColumn] = Field(
        default_factory=dict, description="Which columns there are; without it, those with the usual names."
    )
    speed_m_per_s: float | list[float] | None = Field(
        default=None, description="Speed of the whole recording, or of each tap in it."
    )
    sensor: Sensor | None = Field(default=None, description="The accelerometer; taps are corrected for it.")


@dataclass(frozen=True, slots=True)
class Source:
    """The file that a recording was read from, or what else it came from, with an empty hash."""

    path: str
    sha256: str


@dataclass(frozen=True, slots=True)
class Recording:
    """Arrays (n,), sampled uniformly and together, without NaN; None is what was not recorded."""

    name: str
    rate_hz: float
    acceleration_m_per_s2: Floats | None
    force_n: Floats | None
    position_m: Floats | None
    """Along the surface's normal."""
    tangential_position_m: Floats | None
    speed_m_per_s: float | Floats | None
    """One for all, one a tap, or (n,)."""
    source: Source
    sensor: Sensor | None = None
    """The accelerometer, where it is known."""


def load(path: str | os.PathLike[str]) -> Recording:
    """Reads a recording. Raises RecordingError (one line), or InvalidError for faults in the YAML beside it
    and for a YAML file that is for another command."""
    name = os.fspath(path)
    shown = one_line(name)
    refuse_documents(name)
    try:
        content = _content(name, MAX_BYTES)
        beside = _beside(name)
        table = _table(name, content, bool(beside.columns))
        found, rounding_s, rate_hz = _quantities(table, beside, f"{shown}.yaml")
        if rate_hz is not None and beside.rate_hz is not None and abs(rate_hz / beside.rate_hz - 1) > RATES_ALIKE:
            raise ValueError(f"the file says {rate_hz:g} Hz, the YAML says {beside.rate_hz:g} Hz: which is right?")
        uniform, rate_hz = _uniform(found, rate_hz if beside.rate_hz is None else beside.rate_hz, rounding_s)
    except (ValueError, csv.Error) as error:
        raise RecordingError(f"{shown}: {error}") from None
    except MemoryError:
        raise RecordingError(f"{shown}: there is not enough memory for it: cut it into several files") from None
    speed: float | Floats | None = uniform.get("speed")
    if isinstance(speed, np.ndarray) and speed.size == 1:
        speed = float(speed[0])
    given = beside.speed_m_per_s
    if given is not None:
        speed = np.array(given, dtype=np.float64) if isinstance(given, list) else float(given)
    return Recording(
        name=shown,
        rate_hz=rate_hz,
        acceleration_m_per_s2=uniform.get("acceleration"),
        force_n=uniform.get("force"),
        position_m=uniform.get("position"),
        tangential_position_m=uniform.get("tangential_position"),
        speed_m_per_s=speed,
        source=Source(name, hashlib.sha256(content).hexdigest()),
        sensor=beside.sensor,
    )


def npz_of(recording: Recording) -> bytes:
    """A recording as a .npz, which `load` reads without a YAML."""
    arrays: dict[str, Floats] = {"rate_hz": np.array(recording.rate_hz)}
    for name in NAMES.values():
        values = getattr(recording, name, None)
        if values is not None:
            arrays[name] = np.asarray(values, dtype=np.float64)
    content = io.BytesIO()
    np.savez(content, **arrays)  # type: ignore[arg-type]
    return content.getvalue()


def save(recording: Recording, path: str | os.PathLike[str]) -> None:
    """Writes a recording as .npz, in place of a file that is there. Raises HapticdError where it cannot."""
    name = os.fspath(path)
    try:
        with open(name, "wb") as stream:
            stream.write(npz_of(recording))
    except OSError as error:
        raise HapticdError(f"{one_line(name)}: cannot be written: {error.strerror}") from None


# ---- The YAML beside it ---------------------------------------------------------------------------------------------


def _content(name: str, most: int) -> bytes:
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


def _beside(name: str) -> RecordingSidecar:
    path = f"{name}.yaml"
    # A link that leads nowhere is a YAML that cannot be read, and not none.
    if not os.path.lexists(path):
        return RecordingSidecar()
    try:
        content = _content(path, MAX_YAML_BYTES)
    except ValueError as error:
        raise HapticdError(f"{one_line(path)}: {error}") from None
    document = load_bytes(content, path)
    if document.data is None:
        return RecordingSidecar()
    try:
        beside = RecordingSidecar.parsed(document.data)
    except ValidationError as error:
        raise InvalidError(Problem(document.where(where), text) for where, text in faults_of(error)) from None
    problems = [
        Problem(
            document.where(("columns", quantity, "unit")),
            f"unknown unit of {quantity}, {known_names(unit, UNITS[quantity])}",
        )
        for quantity, column in beside.columns.items()
        if (unit := column.unit) is not None and _spelt(unit) not in UNITS[quantity]
    ]
    problems += [
        Problem(document.where(("columns", quantity, "scale")), "is 0, which leaves nothing")
        for quantity, column in beside.columns.items()
        if column.scale == 0
    ]
    if beside.speed_m_per_s is not None and "speed" in beside.columns:
        problems.append(Problem(document.where(("speed_m_per_s",)), "is given as a column, too: leave one out"))
    if problems:
        raise InvalidError(problems)
    return beside


def _spelt(unit: str) -> str:
    """A unit as UNITS spells it; in brackets or not, with an exponent or a mu of any kind."""
    bare = unit.strip().strip("[]()").strip()
    return (
        bare.replace("\u00b5", "u")
        .replace("\u03bc", "u")
        .replace("\u00b2", "^2")
        .replace("s2", "s^2")
        .replace("**", "^")
    )


# ---- The files -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Table:
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
            raise ValueError(f"{_told(number)} {self.others[number]}")
        if number.isascii() and number.isdigit() and len(number) < 6 and 1 <= int(number) <= len(self.names):
            return int(number) - 1
        raise ValueError(f"has no column {_told(number)}, {known_names(number, map(_short, self.names))}")


def _told(text: str) -> str:
    return f"'{text}'" if text.isprintable() and len(text) <= 60 else quoted(text)


def _short(name: str) -> str:
    return name if name.isprintable() and len(name) <= 60 else quoted(name)


def _table(name: str, content: bytes, named: bool) -> _Table:
    ending = os.path.splitext(name)[1].lower()
    if ending == ".csv":
        return _csv_table(content)
    if ending == ".npz":
        return _npz_table(content)
    if ending == ".wav":
        if not named:
            raise ValueError(f"a .wav needs {one_line(name)}.yaml, with its columns and their scale")
        return _wav_table(content)
    raise ValueError("a recording ends in .csv, .npz or .wav")


def _quantities(
    table: _Table, beside: RecordingSidecar, where: str
) -> tuple[dict[Quantity, Floats], float, float | None]:
    """The quantities in SI units, to how much the times are rounded, and the rate that the file says."""
    wanted = beside.columns or {
        quantity: RecordedColumn(column=name) for quantity, name in NAMES.items() if name in table.names
    }
    unfit = [name for name in NAMES.values() if name in table.others] if not beside.columns else []
    if unfit:
        raise ValueError(f"{unfit[0]} {table.others[unfit[0]]}: name other columns in {where}")
    if not set(wanted) & {"acceleration", "force", "position", "tangential_position"}:
        if beside.columns:
            raise ValueError(f"{where} names neither acceleration nor force nor position")
        known = ", ".join(NAMES.values())
        has = known_names("", map(_short, [*table.names, *table.others])).removeprefix("known: ")
        raise ValueError(f"has none of {known}; it has {has}: name them in {where}")
    places = {quantity: table.place(column.column) for quantity, column in wanted.items()}
    # What is too large or no number here is told by `_uniform`.
    with np.errstate(all="ignore"):
        read = dict(zip(places, table.read(list(places.values())), strict=True))
    found: dict[Quantity, Floats] = {}
    rounding = 0.0
    for quantity, column in wanted.items():
        unit = column.unit if column.unit is not None else table.units.get(places[quantity], "")
        if unit and _spelt(unit) not in UNITS[quantity]:
            raise ValueError(
                f"says that {quantity} is in {_told(unit)}, which is none of {', '.join(UNITS[quantity])}: say its "
                f"unit in {where}"
            )
        factor = column.scale * (UNITS[quantity][_spelt(unit)] if unit else 1.0)
        with np.errstate(all="ignore"):
            found[quantity] = read[quantity] * factor
            if quantity == "time":
                rounding = abs(factor) * table.rounded(places[quantity], read[quantity])
    return found, rounding, table.rate_hz


# ---- CSV -----------------------------------------------------------------------------------------------------------


def _csv_table(content: bytes) -> _Table:
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        encoding = "utf-16"
    else:
        encoding = "utf-8-sig" if content.isascii() or _is_utf8(content) else "latin-1"
    if encoding != "utf-16" and b"\0" in content:
        raise ValueError("is no text")
    layout = _Layout.of(_lines(content, encoding))

    def read(places: Sequence[int]) -> list[Floats]:
        quick = layout.quickly(_lines(content, encoding), places)
        return layout.numbers(_lines(content, encoding), places) if quick is None else quick

    return _Table(layout.names, read, layout.units)


def _is_utf8(content: bytes) -> bool:
    try:
        content.decode("utf-8")
    except UnicodeDecodeError:
        return False
    return True


def _lines(content: bytes, encoding: str) -> Iterator[tuple[int, str]]:
    """Lines that are not empty, with their numbers from 1. Raises ValueError."""
    stream = io.TextIOWrapper(io.BytesIO(content), encoding=encoding)
    number = 0
    try:
        while line := stream.readline(MAX_LINE + 1):
            number += 1
            if len(line) > MAX_LINE:
                raise ValueError(f"line {number} is longer than {MAX_LINE} characters")
            if line.strip(" ,;\t\r\n"):
                yield number, line.strip("\r\n")
    except UnicodeError:
        raise ValueError("is no text") from None


@dataclass(frozen=True, slots=True)
class _Layout:
    """How a CSV is written: what separates its cells, and what stands above its numbers."""

    delimiter: str
    """Empty where blanks do."""
    names: list[str]
    units: dict[int, str]
    first: int
    """The line where the numbers begin."""

    @staticmethod
    def of(lines: Iterator[tuple[int, str]]) -> _Layout:
        heads: list[tuple[int, str]] = []
        comment = ""
        for number, line in lines:
            if line.lstrip().startswith("#"):
                comment = line.lstrip()[1:]
                continue
            delimiter = _delimiter(line)
            cells = _cells(line, delimiter)
            if _are_numbers(cells, delimiter):
                break
            heads.append((number, line))
            if len(heads) > 2:
                raise ValueError(
                    f"lines {heads[0][0]} to {number} hold no numbers: names in one line, perhaps units in the next, "
                    "and # before everything else"
                )
        else:
            raise ValueError("is empty" if not heads else "holds no line of numbers")
        while cells and not cells[-1]:
            cells.pop()
        names, units = [""] * len(cells), [""] * len(cells)
        if heads:
            names = _cells(heads[0][1], delimiter)
            units = _cells(heads[1][1], delimiter) if len(heads) > 1 else []
            while names and not names[-1] and len(names) > len(cells):
                names.pop()
        elif len(above := _cells(comment, delimiter)) == len(cells):
            # As numpy.savetxt writes them.
            names = above
        return _Layout(
            delimiter,
            [name or str(index + 1) for index, name in enumerate(names)],
            {index: unit for index, unit in enumerate(units) if unit},
            number,
        )

    def quickly(self, lines: Iterator[tuple[int, str]], places: Sequence[int]) -> list[Floats] | None:
        """As `numbers`, in a fifth of the time; None where something is not quite as it should be."""
        separators = len(self.names) - 1

        def plain() -> Iterator[str]:
            for number, line in lines:
                if number < self.first or line.lstrip().startswith("#"):
                    continue
                found = line.count(self.delimiter) if self.delimiter else len(line.split()) - 1
                if found != separators or '"' in line:
                    raise ValueError
                yield line if self.delimiter == "," else line.replace(",", ".")

        try:
            table = np.loadtxt(
                plain(), delimiter=self.delimiter or None, usecols=places, ndmin=2, comments=None,
                max_rows=MAX_SAMPLES + 1,
            )  # fmt: skip
        except ValueError:
            return None
        if len(table) > MAX_SAMPLES or not np.isfinite(table).all():
            return None
        return [np.array(column, dtype=np.float64) for column in table.T]

    def numbers(self, lines: Iterator[tuple[int, str]], places: Sequence[int]) -> list[Floats]:
        """The columns at these places. Raises ValueError, with the line where it is wrong."""
        count = len(self.names)
        found = array("d")
        broken, first = 0, 0
        for number, line in lines:
            if number < self.first or line.lstrip().startswith("#"):
                continue
            cells = line.split(self.delimiter) if self.delimiter and '"' not in line else _cells(line, self.delimiter)
            if len(cells) != count and (len(cells) < count or any(cell.strip() for cell in cells[count:])):
                raise ValueError(f"line {number} has not {count} columns, but {len(cells)}")
            try:
                row = [_number(cells[place], self.delimiter) for place in places]
            except ValueError:
                cell = next(cells[place] for place in places if not _is_number(cells[place], self.delimiter))
                raise ValueError(
                    f"line {number} holds something else than numbers, {quoted(cell)} (a sample that is missing?)"
                ) from None
            if not math.isfinite(sum(row)) and not all(map(math.isfinite, row)):
                broken, first = broken + 1, first or number
            found.extend(row)
            if len(found) > MAX_SAMPLES * len(places):
                raise ValueError(f"has more than {MAX_SAMPLES} samples: cut it into several files")
        if broken:
            raise ValueError(
                f"{broken} rows hold NaN or infinity, the first in line {first}: cut them off, or record anew"
            )
        table = np.frombuffer(found, dtype=np.float64).reshape(-1, len(places))
        return [table[:, index].copy() for index in range(len(places))]


def _delimiter(line: str) -> str:
    """What separates the cells of this line; a comma between semicolons or tabs is a decimal one."""
    bare = re.sub(r'"[^"]*"', '""', line)
    for delimiter in ";\t,":
        if delimiter in bare:
            return delimiter
    return "" if len(bare.split()) > 1 else ","


def _cells(line: str, delimiter: str) -> list[str]:
    if not delimiter:
        return [cell.strip('"') for cell in line.split()]
    return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])]


def _number(cell: str, delimiter: str) -> float:
    """Raises ValueError where it is none."""
    return float(cell if delimiter == "," else cell.replace(",", "."))


def _is_number(cell: str, delimiter: str) -> bool:
    try:
        _number(cell, delimiter)
    except ValueError:
        return False
    return True


def _are_numbers(cells: Sequence[str], delimiter: str) -> bool:
    """Whether most of the cells that hold anything hold numbers."""
    full = [cell for cell in cells if cell.strip()]
    return 2 * sum(_is_number(cell, delimiter) for cell in full) > len(full)


# ---- npz -----------------------------------------------------------------------------------------------------------

_BROKEN: Final = (
    ValueError, EOFError, OSError, RuntimeError, KeyError, IndexError, TypeError, SyntaxError, OverflowError,
    struct.error, zlib.error, lzma.LZMAError, zipfile.BadZipFile,
)  # fmt: skip
"""What a damaged archive makes zipfile and numpy raise."""


def _npz_table(content: bytes) -> _Table:
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
                raise ValueError(f"is damaged: {_told(name)}: {_reason(error)}") from None
        return arrays[name]

    for name, shape in shapes.items():
        if shape is None:
            others[name] = "holds no numbers in rows or columns"
        elif len(shape) == 2 and 1 not in shape:
            count = min(shape)
            others[name] = f"holds {count} columns, {_short(name)}[1] and so on"
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
    if shapes.get("rate_hz") is not None:
        single = whole("rate_hz")
        if single.size != 1:
            raise ValueError("rate_hz must be one number")
        rate_hz = float(single.reshape(-1)[0])
    return _Table(names, read, {}, rate_hz, others, rounded)


def _npy_header(stream: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    version = np.lib.format.read_magic(stream)
    if version == (1, 0):
        return np.lib.format.read_array_header_1_0(stream)
    if version == (2, 0):
        return np.lib.format.read_array_header_2_0(stream)
    raise ValueError(f"an array of version {version[0]}.{version[1]}")


def _npy_shape(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> tuple[int, ...] | None:
    """Of an array of at most two dimensions of numbers; None for everything else."""
    if not entry.filename.endswith(".npy"):
        return None
    with archive.open(entry) as stream:
        shape, _, kind = _npy_header(stream)
    return shape if kind.kind in "iuf" and len(shape) <= 2 else None


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


# ---- WAV -----------------------------------------------------------------------------------------------------------

_PCM, _FLOAT, _EXTENSIBLE = 1, 3, 0xFFFE
_KINDS: Final = {
    (_PCM, 8): "u1", (_PCM, 16): "<i2", (_PCM, 24): "u1", (_PCM, 32): "<i4", (_FLOAT, 32): "<f4", (_FLOAT, 64): "<f8",
}  # fmt: skip


def _wav_table(content: bytes) -> _Table:
    """Channels, in parts of full scale: RIFF, WAVE of whole numbers or floats (Microsoft and IBM, 1991, and its
    WAVE_FORMAT_EXTENSIBLE)."""
    if content[:4] != b"RIFF" or content[8:12] != b"WAVE":
        raise ValueError("is no .wav: it has no RIFF and WAVE at its beginning")
    at, form, data = 12, b"", b""
    while at + 8 <= len(content):
        name, size = content[at : at + 4], int.from_bytes(content[at + 4 : at + 8], "little")
        begin, end = at + 8, at + 8 + size
        if name == b"data":
            if end > len(content):
                raise ValueError(f"is cut off: {len(content) - begin} of {size} bytes of its samples are there")
            data = content[begin:end]
            break
        if name == b"fmt ":
            form = content[begin:end]
        at = end + size % 2
    if len(form) < 16:
        raise ValueError("is no .wav that can be read: nothing says how its samples are stored")
    code, channels, rate_hz, _, frame, bits = struct.unpack("<HHIIHH", form[:16])
    if code == _EXTENSIBLE and len(form) >= 26:
        code = int.from_bytes(form[24:26], "little")
    kind = _KINDS.get((code, bits))
    if kind is None:
        raise ValueError(f"holds samples of kind {code} with {bits} bits: it needs 8, 16, 24 or 32 bits, or floats")
    if not 1 <= channels <= MAX_CHANNELS or frame != channels * bits // 8:
        raise ValueError(f"says {channels} channels in {frame} bytes, which cannot be with {bits} bits")
    if len(data) % frame:
        raise ValueError(f"is cut off in the middle of a sample: {len(data)} bytes of samples, {frame} each")

    def read(places: Sequence[int]) -> list[Floats]:
        return [_channel(data, kind, bits, channels, place) for place in places]

    return _Table([str(index + 1) for index in range(channels)], read, {}, float(rate_hz))


def _channel(data: bytes, kind: str, bits: int, channels: int, place: int) -> Floats:
    if bits == 24:
        parts = np.frombuffer(data, dtype=np.uint8).reshape(-1, channels, 3)[:, place].astype(np.int32)
        # The sign is in the upper one of three bytes.
        signed = ((parts[:, 2] ^ 128) - 128) * 65536 + parts[:, 1] * 256 + parts[:, 0]
        return np.asarray(signed / 2.0**23, dtype=np.float64)
    numbers: Floats = np.frombuffer(data, dtype=kind).reshape(-1, channels)[:, place].astype(np.float64)
    if kind == "u1":
        numbers -= 128.0
    if "f" not in kind:
        numbers /= 2.0 ** (bits - 1)
    return numbers


# ---- The clock -----------------------------------------------------------------------------------------------------


def _uniform(
    found: dict[Quantity, Floats], rate_hz: float | None, rounding_s: float
) -> tuple[dict[Quantity, Floats], float]:
    """The columns at equal distances, and the rate; times are rounded to `rounding_s`, or more than that."""
    # Of taps the speeds may be fewer than samples.
    lengths = {NAMES[quantity]: len(values) for quantity, values in found.items() if quantity != "speed"}
    if len(set(lengths.values())) != 1:
        told = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise ValueError(f"the columns are of different length: {told}")
    samples = next(iter(lengths.values()))
    if not LEAST_SAMPLES <= samples <= MAX_SAMPLES:
        raise ValueError(f"{samples} samples are no recording: it has {LEAST_SAMPLES} to {MAX_SAMPLES}")
    for quantity, values in found.items():
        broken = np.flatnonzero(~np.isfinite(values))
        if len(broken):
            raise ValueError(
                f"{NAMES[quantity]} is NaN or infinite in {len(broken)} samples, first in number {broken[0] + 1}"
            )
        large = float(np.abs(values).max(initial=0.0))
        if large > LARGEST[quantity]:
            raise ValueError(
                f"{NAMES[quantity]} reaches {large:.3g}, and nothing that a stylus records is over "
                f"{LARGEST[quantity]:g}: is it in another unit, or another column?"
            )
    columns: dict[Quantity, Floats] = {quantity: values for quantity, values in found.items() if quantity != "time"}
    if rate_hz is not None and not LOWEST_HZ <= rate_hz <= HIGHEST_HZ:
        raise ValueError(f"a rate of {rate_hz:g} Hz is none of a recording: it has {LOWEST_HZ:g} Hz to 1 MHz")
    if "time" not in found:
        if rate_hz is None:
            raise ValueError("has neither a column time_s nor a rate: say rate_hz in the YAML beside it")
        return columns, rate_hz
    since_s = found["time"] - found["time"][0]
    at = np.arange(samples) - (samples - 1) / 2
    period_s = float(at @ since_s / (at @ at))
    rounding_s = max(rounding_s, 2 * float(np.spacing(np.abs(found["time"]).max())), _decimals(found["time"]))
    if 1.01 * period_s < rounding_s <= float(since_s[-1]) and np.all(np.diff(since_s) >= 0):
        raise ValueError(
            f"the times are rounded to {rounding_s:.3g} s, which is more than from one sample to the next "
            f"({period_s:.3g} s): leave them out and say rate_hz, in the YAML beside it"
        )
    _refuse_gaps(found["time"], period_s, rounding_s)
    if rate_hz is not None and abs(rate_hz * period_s - 1) > RATES_ALIKE:
        raise ValueError(
            f"the times say {1 / period_s:.6g} Hz, rate_hz says {rate_hz:g} Hz: is the time in another unit?"
        )
    even_s: Floats = np.asarray(np.mean(since_s) + period_s * at, dtype=np.float64)
    late = np.abs(since_s - even_s) / period_s
    # Times that are rounded say a rate only so well, and a clock is made for a whole one.
    rate = 1.0 / period_s
    if abs(round(rate) / rate - 1) <= (rounding_s + UNIFORM * period_s) / float(since_s[-1]):
        rate = float(round(rate))
    if late.max() <= max(UNIFORM, 0.5 * rounding_s / period_s * 1.001 + UNIFORM):
        return columns, rate
    if late.max() > JITTER and not _wanders(since_s, period_s):
        worst = int(np.argmax(late))
        raise ValueError(
            f"the clock is {late[worst]:.2f} periods off a uniform one at sample {worst + 1} "
            f"({found['time'][worst]:.9g} s), {JITTER:g} is the most that is put right: were samples lost, or doubled?"
        )
    return {
        quantity: _resampled(since_s, values, even_s) if len(values) == samples else values
        for quantity, values in columns.items()
    }, 1.0 / period_s


def _refuse_gaps(time_s: Floats, mean_s: float, rounding_s: float) -> None:
    """Raises ValueError for times that do not rise, that have gaps, or that are none of a recording."""
    steps = np.diff(time_s)
    back = np.flatnonzero(steps <= 0)
    if len(back):
        raise ValueError(
            f"the time does not rise from sample {back[0] + 1} to {back[0] + 2} ({time_s[back[0]]:.9g} s, then "
            f"{time_s[back[0] + 1]:.9g} s): is it the right column? Times are not needed where the YAML has columns "
            "without them, and rate_hz"
        )
    usual = float(np.median(steps))
    spread = 1.4826 * float(np.median(np.abs(steps - usual)))
    jumps = np.flatnonzero(steps > usual + max(JITTER * usual, OUTSTANDING * spread) + rounding_s)
    if len(jumps):
        raise ValueError(
            f"samples are missing: between {time_s[jumps[0]]:.9g} s and {time_s[jumps[0] + 1]:.9g} s pass "
            f"{steps[jumps[0]] / usual:.1f} periods, in {len(jumps)} places like this"
        )
    if not 1 / HIGHEST_HZ <= 1.001 * mean_s <= 1.002 / LOWEST_HZ:
        raise ValueError(
            f"the times say {1 / mean_s:.6g} Hz: a recording has {LOWEST_HZ:g} Hz to 1 MHz; which unit is the time in?"
        )


def _wanders(since_s: Floats, period_s: float) -> bool:
    """Whether a clock goes evenly from each sample to the next and at one rate throughout, though not for ever."""
    steps = np.diff(since_s) / period_s
    edges = np.linspace(0, len(since_s) - 1, min(PARTS, len(steps) // 50 + 1) + 1).round().astype(int)
    rates = np.diff(since_s[edges]) / np.diff(edges) / period_s
    return bool(np.abs(steps - 1).max() < JITTER and np.abs(rates - 1).max() < WANDER)


def _decimals(time_s: Floats) -> float:
    """The decimal place to which times are rounded; 0 where they have all the places that there are.

    The later half decides: with so many digits a number, the largest have the fewest places.
    """
    later = time_s[len(time_s) // 2 :]
    for place in range(1, 10):
        scaled = later * 10.0**place
        if np.all(np.abs(scaled - np.round(scaled)) <= 1e-6 + 4 * np.spacing(np.abs(scaled))):
            return 10.0**-place
    return 0.0


def _resampled(time_s: Floats, values: Floats, even_s: Floats) -> Floats:
    """By a cubic spline; what stands still at an end of the range, as clipped samples do, goes on to do so."""
    require_scipy()
    from scipy.interpolate import CubicSpline

    found = np.asarray(CubicSpline(time_s, values)(even_s), dtype=np.float64)
    left = np.clip(np.searchsorted(time_s, even_s, side="right") - 1, 0, len(values) - 2)
    for extreme in (values.max(), values.min()):
        held = (values[left] == extreme) & (values[left + 1] == extreme)
        found[held] = extreme
    return found
