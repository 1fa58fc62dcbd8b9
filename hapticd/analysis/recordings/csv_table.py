"""Columns of a .csv: named in the first line; separated by commas, semicolons, tabs or blanks."""

from __future__ import annotations

import csv
import io
import re
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hapticd.analysis.recordings.table import MAX_SAMPLES, Table
from hapticd.analysis.statistics import Floats
from hapticd.base.errors import quoted

MAX_LINE: Final = 100_000


def csv_table(content: bytes) -> Table:
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        encoding = "utf-16"
    else:
        encoding = "utf-8-sig" if content.isascii() or _is_utf8(content) else "latin-1"
    if encoding != "utf-16" and b"\0" in content:
        raise ValueError("is no text")
    layout = _Layout.of(_lines(content, encoding))

    return Table(layout.names, lambda places: layout.columns(_lines(content, encoding), places), layout.units)


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
                raise _LineError(f"line {number} is longer than {MAX_LINE} characters")
            if line.strip(" ,;\t\r\n"):
                yield number, line.strip("\r\n")
    except UnicodeError:
        raise _LineError("is no text") from None


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

    def columns(self, lines: Iterator[tuple[int, str]], places: Sequence[int]) -> list[Floats]:
        """Those at these places. Raises ValueError, with the line where it is wrong."""
        numbers = array("I")
        """Of the lines that were read."""
        last = ""

        def rows() -> Iterator[str]:
            nonlocal last
            for number, line in lines:
                if number < self.first or line.lstrip().startswith("#"):
                    continue
                self._check_width(number, line)
                numbers.append(number)
                last = line
                yield line if self.delimiter == "," else line.replace(",", ".")

        try:
            table = np.loadtxt(
                rows(), delimiter=self.delimiter or None, usecols=places, ndmin=2, comments=None, quotechar='"',
                max_rows=MAX_SAMPLES + 1,
            )  # fmt: skip
        except _LineError:
            raise
        except ValueError:
            cells = _cells(last, self.delimiter)
            cell = next((cells[place] for place in places if not _is_number(cells[place], self.delimiter)), last)
            raise ValueError(
                f"line {numbers[-1]} holds something else than numbers, {quoted(cell)} (a sample that is missing?)"
            ) from None
        if len(table) > MAX_SAMPLES:
            raise ValueError(f"has more than {MAX_SAMPLES} samples: cut it into several files")
        broken = np.flatnonzero(~np.isfinite(table).all(axis=1))
        if len(broken):
            raise ValueError(
                f"{len(broken)} rows hold NaN or infinity, the first in line {numbers[broken[0]]}: cut them off, or "
                "record anew"
            )
        return [np.array(column, dtype=np.float64) for column in table.T]

    def _check_width(self, number: int, line: str) -> None:
        """Raises _LineError for a line with fewer cells than there are names, or with more that hold anything."""
        count = len(self.names)
        quick = line.count(self.delimiter) + 1 if self.delimiter else len(line.split())
        if quick == count and '"' not in line:
            return
        cells = _cells(line, self.delimiter)
        if len(cells) < count or any(cell.strip() for cell in cells[count:]):
            raise _LineError(f"line {number} has not {count} columns, but {len(cells)}")


class _LineError(ValueError):
    """A line that says itself what is wrong with it."""


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
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])]
    except csv.Error as error:
        raise _LineError(str(error)) from None


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
