"""Tables of numbers as text: separator, preamble, names, units, and where the numbers begin.

A file may begin with `sep=;`, which names the separator, and with a preamble: lines of a logger or an oscilloscope. The
numbers begin with the first block of lines that have numbers in the same cells. The line before them holds the names,
or the units if the line above it holds names. Lines that begin with # are comments.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Final

from hapticd.base.errors import quoted
from hapticd.base.units import has_unit_in_brackets, is_unit

_BLOCK_LINES: Final = 8
"""Number of successive lines with numbers in the same cells that begin the numbers. In a short file the numbers begin
with fewer, but more than the lines of numbers before them."""
_MAX_PREAMBLE_LINES: Final = 1000
"""The numbers must begin within this number of lines."""
_SEPARATOR_PATTERN: Final = re.compile(r'\s*"?sep=(\\t|[^"\n])?"?[\s,;]*(?:\n|$)', re.IGNORECASE)
_VALUE_PATTERN: Final = re.compile(r"(.*\D[:=])?\s*[-+\u00b1]?\d[\d.,]*(?:[eE][-+]?\d+)?\s*(\D*)")
"""A value with its unit, such as `Sample rate: 2000 Hz`: a cell of a preamble, not a name."""


class CsvTableError(ValueError):
    """A text is not a table of numbers, or its names are unclear."""

    def __init__(self, reason: str, line: int = 1) -> None:
        super().__init__(reason)
        self.line = line
        """Number of the line with the fault, from 1."""


@dataclass(frozen=True, slots=True)
class _Line:
    """A line of the head of a file."""

    number: int
    text: str
    cells: list[str]
    delimiter: str
    numeric: frozenset[int]
    """Indices of the cells that hold numbers."""

    @property
    def width(self) -> int:
        """Number of cells without the empty ones at the end."""
        return max((index + 1 for index, cell in enumerate(self.cells) if cell), default=0)

    @property
    def dates(self) -> set[tuple[int, str]]:
        """Indices and forms of the cells that hold a date or a time of day, such as 0000-00-00 00:00."""
        forms = enumerate(re.sub(r"\d", "0", cell) for cell in self.cells)
        return {(index, form) for index, form in forms if re.match(r"0+[-/.:]0+[-/.:]0", form)}

    @property
    def form(self) -> tuple[str, int, frozenset[int]]:
        """What the lines of a block have in common."""
        return self.delimiter, self.width, self.numeric

    @property
    def is_of_numbers(self) -> bool:
        """Whether more than half of the cells that are not empty hold numbers."""
        return 2 * len(self.numeric) > sum(map(bool, self.cells))


@dataclass(frozen=True, slots=True)
class CsvTable:
    """The columns of a text, and where their numbers begin."""

    text: str
    first: int
    """Number of the first line of numbers, from 1."""
    delimiter: str
    """Separator of the cells; "" for blanks."""
    width: int
    """Number of cells in a line of numbers."""
    names: Sequence[str]
    """Names of the columns, in their order; columns without a name are numbered from 1."""
    units: Mapping[int, str]
    """Cells of the line of units, by the index of the column."""
    is_named: bool
    """Whether the file names the columns."""

    def lines(self) -> Iterator[tuple[int, list[str]]]:
        """Yield the number of each line of numbers, and its cells. Raises ValueError for a cell that is too long."""
        for number, line in _lines(self.text):
            if number >= self.first and not line.lstrip().startswith("#"):
                yield number, _cells(line, self.delimiter)

    def fault(self, cells: Sequence[str], indices: Sequence[int]) -> str | None:
        """Return the fault of a line of numbers of which these columns are used, as a predicate; None without one."""
        if len(cells) != self.width:
            return f"must have {self.width} columns, has {len(cells)}"
        for index in indices:
            value = number_of(cells[index], self.delimiter)
            if value is None or not math.isfinite(value):
                return f"must hold numbers, holds {quoted(cells[index])}"
        return None


def csv_table_of(content: bytes, skipped: int = 0, advice: str = "remove the other lines") -> CsvTable:
    """Find the columns of a text without its first `skipped` lines.

    Raises CsvTableError (one line) for a text without numbers, and, with `advice`, if lines before the numbers are
    neither a preamble, nor names, nor units.
    """
    text = _text(content)
    begin = 0
    for _ in range(skipped):
        begin = text.find("\n", begin) + 1 or len(text)
    named = _SEPARATOR_PATTERN.match(text, begin)
    separator = None
    if named is not None:
        separator = {"\\t": "\t", " ": ""}.get(named[1], named[1])
        skipped += named[0].count("\n")
    head: list[_Line] = []
    comments: list[_Line] = []
    number = 0
    for number, line in islice(_lines(text), skipped + _MAX_PREAMBLE_LINES):
        if number <= skipped:
            continue
        bare = re.sub(r"^\s*#", "", line)
        delimiter = _delimiter(bare) if separator is None else separator
        cells = _cells(bare, delimiter)
        numeric = frozenset(index for index, cell in enumerate(cells) if number_of(cell, delimiter) is not None)
        (head if bare == line else comments).append(_Line(number, bare, cells, delimiter, numeric))
    block = _first_of_block(head)
    if block is None:
        if not head:
            raise CsvTableError("is empty" if skipped == 0 else f"has no line after the {skipped} that are skipped")
        raise CsvTableError(f"holds no line of numbers in lines {skipped + 1} to {number}")
    usual = head[block]
    dates = usual.dates
    # A line with a number or a date between the last line of text and the block is a sample with a fault, and reported
    # as such.
    texts = [
        not line.is_of_numbers and not line.dates & dates and (index == 0 or not line.numeric & usual.numeric)
        for index, line in enumerate(head[:block])
    ]
    start = block - texts[::-1].index(True) if any(texts) else 0
    for above in head[:start]:
        if min(usual.numeric) in above.numeric:
            raise CsvTableError(
                f"line {above.number} holds a number, but the lines of numbers begin only after line "
                f"{head[start - 1].number}, which holds text: {advice}",
                above.number,
            )
    found = _names_and_units(head[:start], usual)
    if found is None:
        raise CsvTableError(
            f"lines {head[0].number} to {head[start - 1].number}, above the numbers, end in neither names nor units: "
            f"{advice}",
            head[0].number,
        )
    if not any(found):
        # The names may stand in a comment with as many cells as the lines of numbers.
        above_numbers = [line for line in comments if line.number < head[start].number]
        rows = [(line, _cells_above(line, usual)) for line in above_numbers]
        fitting = [line for line, cells in rows if len(cells) == len(usual.cells) and not _are_values(cells)]
        found = _names_and_units(fitting, usual)
    names, units = found or ([], [])
    if names and (len(names) > len(usual.cells) or any(usual.cells[len(names) :])):
        raise CsvTableError(
            f"line {usual.number} must have {len(names)} columns, as many as there are names, has {len(usual.cells)}; "
            f"if the line above holds no names, {advice}",
            usual.number,
        )
    names = names[: usual.width]
    is_named = any(names)
    return CsvTable(
        text,
        head[start].number,
        usual.delimiter,
        len(usual.cells),
        [name or str(index + 1) for index, name in enumerate(names or [""] * usual.width)],
        {index: unit for index, unit in enumerate(units) if unit},
        is_named,
    )


def number_of(cell: str, delimiter: str) -> float | None:
    """Return the number in a cell, with a decimal comma if the delimiter is not a comma; None if it is not a number."""
    try:
        return None if "_" in cell else float(cell if delimiter == "," else cell.replace(",", "."))
    except ValueError:
        return None


def _first_of_block(head: Sequence[_Line]) -> int | None:
    """Return the index of the first line of a block of numbers; without a block, of the first line of numbers."""
    of_numbers = [index for index, line in enumerate(head) if line.is_of_numbers] or [
        index for index, line in enumerate(head) if line.numeric
    ]
    for before, index in enumerate(of_numbers):
        lines = head[index : index + _BLOCK_LINES]
        if len(lines) > min(before, _BLOCK_LINES - 1) and len({each.form for each in lines}) == 1:
            return index
    return of_numbers[0] if of_numbers else None


def _names_and_units(above: Sequence[_Line], usual: _Line) -> tuple[list[str], list[str]] | None:
    """Return names and units from the lines, the last ones `above` lines like `usual`; None if unknown."""
    rows = [_cells_above(line, usual) for line in above[-2:]]
    if not rows:
        return [], []
    names, last = rows[0], rows[-1]
    filled = [cell for cell in last[: usual.width] if cell]
    is_title = len(filled) == 1 < usual.width and last[0] != "" and (len(rows) == 1 or len(names) < usual.width)
    if above[-1].text.count('"') % 2 or (is_title and has_unit_in_brackets(filled[0])):
        return None
    if is_title or _are_values(last):
        return [], []
    if len(rows) == 1:
        return last, []
    could_be_names = len(names) >= usual.width and not above[-2].numeric & usual.numeric
    units, units_above = _units_in(last[: usual.width]), _units_in(names)
    if could_be_names and len(last) >= usual.width and units == 0 and units_above == sum(map(bool, names)):
        return last, names
    are_named = any(map(has_unit_in_brackets, names)) and not any(map(has_unit_in_brackets, last))
    if could_be_names and (are_named or 2 * units >= len(filled)):
        return names, last[: usual.width]
    return (last, []) if len(last) >= usual.width and (units == 0 or not could_be_names) else None


def _units_in(cells: Sequence[str]) -> int:
    return sum(is_unit(cell, "time") or is_unit(cell) or cell[0] in "([{-" for cell in filter(None, cells))


def _cells_above(line: _Line, usual: _Line) -> list[str]:
    """Return the cells of a line above the numbers, which may have another separator than they have."""
    cells = _cells(line.text, usual.delimiter)
    if sum(map(bool, cells)) == 1 and line.delimiter and len(line.cells) == line.width == usual.width:
        return line.cells
    if not usual.delimiter and len(cells) > len(usual.cells):
        cells = re.split(r"\s+(?![(\[])", line.text.strip())
    # These columns of LabVIEW and Rigol have cells only above the numbers.
    while len(cells) > len(usual.cells) and cells[-1] in ("Comment", "Start", "Increment", ""):
        cells.pop()
    return cells


def _are_values(cells: Sequence[str]) -> bool:
    """Return whether cells above the numbers hold values of a preamble, and not names."""
    return any(map(_is_value, cells)) and not any(map(has_unit_in_brackets, cells))


def _is_value(cell: str) -> bool:
    """Return whether a cell is a value of a preamble, such as `Sample rate: 2000 Hz` or `16 g`, and not a name."""
    found = _VALUE_PATTERN.fullmatch(cell)
    return found is not None and bool((found[1] and not found[2]) or is_unit(found[2]))


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
