"""Events of the rows of a .csv. What a cell of each member holds, event_columns.py says."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from hapticd.recording.event_columns import MAY_BE_NONE, MEMBERS, Kind, members_of_kind

if TYPE_CHECKING:
    from hapticd.base.core import EventKind

_Read: TypeAlias = Callable[[str], object]

_SPACES: Final = " \t\n\r"
_decode: Final = json.JSONDecoder().raw_decode


class FromCells:
    """Makes events of the rows of a .csv."""

    def __init__(self, names: Sequence[str]) -> None:
        """`names`: of the columns, `event` among them; of columns of the same name the last one counts."""
        from hapticd.base.core import EventKind

        self._kinds = dict(EventKind.__members__)
        self._at = {name: at for at, name in enumerate(names)}
        self._event = self._at["event"]
        self._reads: dict[str, _Read] = {name: _READERS.get(name) or _UnknownCells() for name in self._at}
        self._members: dict[EventKind | None, list[tuple[int, str, _Read]]] = {}

    def event(self, row: Sequence[str]) -> dict[str, Any]:
        """The event in a row that has a cell for each name. One of a kind that this version does not know has the cells
        that are not empty. Raises ValueError, RecursionError."""
        kind = self._kinds.get(row[self._event].upper())
        members = self._members.get(kind)
        if members is None:
            known = self._at if kind is None else members_of_kind(kind)
            members = [(at, name, self._reads[name]) for name, at in self._at.items() if name in known]
            self._members[kind] = members
        if kind is None:
            return {name: read(row[at]) for at, name, read in members if row[at]}
        return {name: read(row[at]) for at, name, read in members}


def _json(cell: str) -> object:
    """As json.loads, and sooner. Raises ValueError, RecursionError."""
    try:
        value: object
        value, end = _decode(cell)
        if end == len(cell):
            return value
    except ValueError:
        pass
    return json.loads(cell)


def _reader(name: str, kind: Kind) -> _Read:
    """Reads the cells of a member."""
    reads: dict[Kind, _Read] = {Kind.TEXT: str, Kind.INTEGER: int, Kind.NUMBER: float}
    read = reads.get(kind, _json)
    if name not in MAY_BE_NONE:
        return read
    return lambda cell: None if cell == "null" else read(cell)


_READERS: Final = {name: _reader(name, kind) for name, kind in MEMBERS.items()}


class _UnknownCells:
    """Reads cells of a column that this version does not know: JSON, or else text.

    A column of which MOST_TEXTS cells look like JSON and are none holds text. To find out takes long.
    """

    MOST_TEXTS: Final = 1000
    _BEGIN_JSON: Final = frozenset('-0123456789tfnNI["{ \t\n\r')

    def __init__(self) -> None:
        self._texts = 0

    def __call__(self, cell: str) -> object:
        """Of a cell that is not empty."""
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
                value = self(text)
                return cell if value is text else value
        self._texts += 1
        return cell
