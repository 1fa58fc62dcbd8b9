"""Events of the rows of a .csv, made column by column: 48 MB of rows may hold eight million events or 24 million cells.

What a cell of each member holds, event_columns.py says.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from itertools import compress
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from hapticd.recording.event_columns import MAY_BE_NONE, MEMBERS, Kind, members_of_kind
from hapticd.recording.reading_limits import JSON_TIMES, size_of

if TYPE_CHECKING:
    from hapticd.base.core import EventKind

Cells: TypeAlias = Sequence[str]
Read: TypeAlias = Callable[[Cells], Sequence[object]]

_EVENT_BYTES: Final = 240
_MEMBER_BYTES: Final = 56
_TEXT_BYTES: Final = 56
"""What an event takes, and in it each member, and what a text takes beside its letters."""
_SHORT: Final = 64
"""Letters of JSON up to which what it takes is not counted: counting takes longer than reading."""

_ABSENT: Final = object()
_decode: Final = json.JSONDecoder().raw_decode


class FromCells:
    """Makes events of the rows of a .csv."""

    def __init__(self, names: Sequence[str]) -> None:
        """`names`: of the columns, `event` among them; of columns of the same name the last one counts."""
        from hapticd.base.core import EventKind

        self._kinds = dict(EventKind.__members__)
        self._at = {name: at for at, name in enumerate(names)}
        self._event = self._at["event"]
        self._reads: dict[str, Read] = {name: _READERS.get(name) or _UnknownCells() for name in self._at}

    def events(self, rows: Sequence[Cells]) -> tuple[list[dict[str, Any]], int]:
        """The events in rows that have a cell for each name, and bytes that they take.

        Raises ValueError, RecursionError.
        """
        happened = [row[self._event] for row in rows]
        kinds = {name: self._kinds.get(name.upper()) for name in set(happened)}
        if len(set(kinds.values())) == 1:
            return self._alike(kinds[happened[0]], rows)
        places: dict[EventKind | None, list[int]] = {}
        for place, name in enumerate(happened):
            places.setdefault(kinds[name], []).append(place)
        found: list[dict[str, Any]] = [{} for _ in rows]
        taken = 0
        for kind, of_kind in places.items():
            events, size = self._alike(kind, [rows[place] for place in of_kind])
            taken += size
            for place, event in zip(of_kind, events, strict=True):
                found[place] = event
        return found, taken

    def _alike(self, kind: EventKind | None, rows: Sequence[Cells]) -> tuple[list[dict[str, Any]], int]:
        """Events of one kind, or of those that this version does not know: they have the cells that are not empty."""
        members = None if kind is None else members_of_kind(kind)
        cells = list(zip(*rows, strict=True))
        names = [name for name in self._at if members is None or name in members]
        columns, some_absent, taken = [], False, _EVENT_BYTES * len(rows)
        for name in names:
            column = cells[self._at[name]]
            there = list(compress(column, column)) if members is None and "" in column else column
            values = self._reads[name](there)
            taken += _bytes(there, values)
            if there is not column:
                found = iter(values)
                values = [next(found) if cell else _ABSENT for cell in column]
                some_absent = True
            columns.append(values)
        events = [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True)]
        if some_absent:
            events = [{name: value for name, value in event.items() if value is not _ABSENT} for event in events]
        return events, taken


def _bytes(cells: Cells, values: Sequence[object]) -> int:
    """What a member takes, in all the events that have it."""
    types = set(map(type, values))
    taken = _MEMBER_BYTES * len(cells)
    if str in types:
        text = "".join(cells)
        taken += _TEXT_BYTES * len(cells)
        taken += len(text) if text.isascii() else sum(len(cell) if cell.isascii() else 4 * len(cell) for cell in cells)
    if list in types or dict in types:
        for cell, value in zip(cells, values, strict=True):
            if type(value) is list or type(value) is dict:
                taken += JSON_TIMES * len(cell) if len(cell) <= _SHORT else size_of(value)
    return taken


# ---- What a cell holds ---------------------------------------------------------------------------------------------


_SPACES: Final = " \t\n\r"


def _at_once(cells: Cells) -> list[object] | None:
    """Values of cells of JSON, read at once; None where one is none, or has a comma in it."""
    text = ",".join(cells)
    if text.count(",") != len(cells) - 1:
        return None
    try:
        found: list[object] = json.loads(f"[{text}]")
    except ValueError:
        return None
    return found if len(found) == len(cells) else None


def _json(cells: Cells) -> list[object]:
    found = _at_once(cells)
    return [_value(cell) for cell in cells] if found is None else found


def _value(cell: str) -> object:
    """As json.loads, and sooner. Raises ValueError, RecursionError."""
    try:
        value: object
        value, end = _decode(cell)
        if end == len(cell):
            return value
    except ValueError:
        pass
    return json.loads(cell)


def _reader(name: str, kind: Kind) -> Read:
    """Reads cells of a member."""
    reads: dict[Kind, Read] = {
        Kind.TEXT: lambda cells: cells,
        Kind.INTEGER: lambda cells: list(map(int, cells)),
        Kind.NUMBER: lambda cells: list(map(float, cells)),
    }
    read = reads.get(kind, _json)
    if name not in MAY_BE_NONE:
        return read

    def or_none(cells: Cells) -> Sequence[object]:
        if "null" not in cells:
            return read(cells)
        values = iter(read([cell for cell in cells if cell != "null"]))
        return [None if cell == "null" else next(values) for cell in cells]

    return or_none


_READERS: Final = {name: _reader(name, kind) for name, kind in MEMBERS.items()}


class _UnknownCells:
    """Reads cells of a column that this version does not know: JSON, or else text.

    A column of which MOST_TEXTS cells look like JSON and are none holds text. To find out takes long.
    """

    MOST_TEXTS: Final = 1000
    _BEGIN_JSON: Final = frozenset('-0123456789tfnNI["{ \t\n\r')

    def __init__(self) -> None:
        self._texts = 0

    def __call__(self, cells: Cells) -> Sequence[object]:
        """Of cells that are not empty."""
        if self._texts == self.MOST_TEXTS or self._BEGIN_JSON.isdisjoint(cell[0] for cell in cells):
            return cells
        found = _at_once(cells)
        return [self._json_or_text(cell) for cell in cells] if found is None else found

    def _json_or_text(self, cell: str) -> object:
        if cell[0] not in self._BEGIN_JSON or self._texts == self.MOST_TEXTS:
            return cell
        try:
            value: object
            value, end = _decode(cell)
            if end == len(cell) or not cell[end:].strip(_SPACES):
                return value
        except ValueError:
            text = cell.strip(_SPACES)
            if text and cell[0] in _SPACES:
                value = self._json_or_text(text)
                return cell if value is text else value
        self._texts += 1
        return cell
